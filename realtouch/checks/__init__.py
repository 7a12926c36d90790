"""Checks of data sets of touches: damage, and faults of recordings."""
