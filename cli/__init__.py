"""Command lines of the toolkit: parse, call, print."""
