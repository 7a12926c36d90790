"""Starstruck: scenes of stars among distractors, made by rejection sampling."""
