"""Scenes of environments: meshes under a sensor, recorded touches, an object between two fingers."""
