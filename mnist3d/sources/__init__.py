"""Digit images and where they come from: one protocol, one file for each source."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
