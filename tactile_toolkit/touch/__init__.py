"""Touches as they are stored: schema, JPEG, AVI."""
