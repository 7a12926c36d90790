"""Real touches: typed, lazy, fast loaders, and functions to select, convert and export them.

``realtouch.load`` opens a data set; ``dataset[0]`` is a round of touches, ``dataset.touches()`` the flat view
of single touches with its filters. ``clips_to_images``, ``resize``, ``select`` and ``frames`` write new ones.
Names are imported on first use, so that ``import realtouch`` costs nothing.
"""

from lazy_loader import attach_stub

from tactile_toolkit import __version__ as __version__

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
