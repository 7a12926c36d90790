"""From Parquet through Arrow to numpy, lazily, and the data sets of records that users hold."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
