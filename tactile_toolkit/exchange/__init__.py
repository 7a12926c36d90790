"""Data sets on their way: to the Hub, from it, and into other formats."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
