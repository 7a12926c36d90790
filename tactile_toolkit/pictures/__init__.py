"""Pictures without a screen: sheets, lettering, plots, shaded and oblique views, written whole."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
