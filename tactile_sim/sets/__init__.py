"""Data sets of simulated touches, and training sets of learned rendering."""
