"""Conversions of data sets of touches: selections, other pictures, files of pictures."""
