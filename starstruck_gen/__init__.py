"""Starstruck: scenes of stars among distractors, made by rejection sampling.

``starstruck_gen.load`` opens a data set, ``starstruck_gen.generate`` makes one,
``starstruck_gen.SceneDataset`` gives the same records without any files, and ``starstruck_gen.sample_scene``
makes a single scene. Names are imported on first use, so that ``import starstruck_gen`` costs nothing.
"""

from lazy_loader import attach_stub

from tactile_toolkit import __version__ as __version__

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
