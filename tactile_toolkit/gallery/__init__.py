"""Galleries: static pages that show a data set and open from a plain file system."""
