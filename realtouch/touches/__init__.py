"""Touches of real sensors: stored rounds, their records, and data sets of them."""
