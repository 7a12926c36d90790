"""Resolves names of data sets: location, kind, and files of the splits."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
