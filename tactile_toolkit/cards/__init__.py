"""Data cards: the README of a data set folder, filled from the data and compared with them."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
