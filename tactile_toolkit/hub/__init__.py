"""To the Hugging Face Hub and back: reading, downloads, uploads, and the published data sets by name."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
