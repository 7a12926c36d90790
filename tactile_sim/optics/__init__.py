"""Images of the camera behind the gel, from depth."""
