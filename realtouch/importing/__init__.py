"""Import of the recordings of others: touches are found, cut, given their fields, and stored."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
