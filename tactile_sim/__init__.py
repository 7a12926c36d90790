"""Synthetic touches: any solid, pressed by a simulated GelSight Mini.

``tactile_sim.render_touch`` gives depth, ``tactile_sim.generate`` writes a data set, which
``realtouch.load`` opens. Names are imported on first use, so that ``import tactile_sim`` costs nothing.
"""

from lazy_loader import attach_stub

from tactile_toolkit import __version__ as __version__

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
