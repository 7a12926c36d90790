"""Damage done at random, and what becomes of it."""
