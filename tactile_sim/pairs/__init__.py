"""Training sets of learned rendering: depth images and real touches that do not belong together."""
