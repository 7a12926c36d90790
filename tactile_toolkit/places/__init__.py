"""What a name stands for: where the data set lies, its kind, and the files of its splits."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
