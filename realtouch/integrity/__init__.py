"""Damage: found, listed, left out."""
