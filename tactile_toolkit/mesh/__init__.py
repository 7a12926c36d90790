"""Solids: columns and records of meshes, mesh files, checks, height maps."""
