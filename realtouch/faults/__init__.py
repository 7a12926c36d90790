"""Faults of recordings: rules for pictures, poses and times, and their findings."""
