"""Synthetic touches: any solid, pressed by a simulated GelSight Mini.

``tactile_sim.render_touch`` gives depth, ``tactile_sim.generate`` writes a data set, which
``realtouch.load`` opens. Names are imported on first use, so that ``import tactile_sim`` costs nothing.
"""

from tactile_toolkit import on_first_use

__getattr__, __dir__, __all__ = on_first_use(__name__, __file__)
