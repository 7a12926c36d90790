"""A gel in a moving world: what it feels of bodies in their poses, with the history of friction."""
