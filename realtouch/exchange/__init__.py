"""Formats of other libraries, read and written: a module or two for each."""
