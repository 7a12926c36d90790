"""Pressing a gel onto solids: sensors, solids, poses, and heights under a sensor."""
