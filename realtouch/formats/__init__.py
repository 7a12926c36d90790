"""Formats of other libraries, read and written; one or more modules for each format."""
