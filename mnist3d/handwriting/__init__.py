"""Procedural handwriting: writers, the shapes of their digits, and ink on a page."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
