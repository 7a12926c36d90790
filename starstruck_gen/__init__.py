"""Starstruck: scenes of stars among distractors, made by rejection sampling.

``starstruck_gen.load`` opens a data set, ``starstruck_gen.generate`` makes one,
``starstruck_gen.SceneDataset`` gives the same records without any files, and ``starstruck_gen.sample_scene``
makes a single scene. Names are imported on first use, so that ``import starstruck_gen`` costs nothing.
"""

from tactile_toolkit import on_first_use

__getattr__, __dir__, __all__ = on_first_use(__name__, __file__)
