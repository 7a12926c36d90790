"""Scenes as torch tensors (extra ``torch``): see :class:`tactile_toolkit.mesh.SolidTensors`."""

from __future__ import annotations

from tactile_toolkit.mesh import SolidTensors


class SceneTensors(SolidTensors):
    """A map-style data set of scenes, stored or on the fly; its grids cover the published cell of 12 cm."""

    extent_m = (0.12, 0.12, 0.01)
