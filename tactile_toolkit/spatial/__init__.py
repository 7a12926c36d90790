"""Rotations, hulls and search trees of scipy, imported on first use: they take a fifth of a second."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
