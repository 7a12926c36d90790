"""Digits as torch tensors (extra ``torch``): see :class:`tactile_toolkit.mesh.SolidTensors`."""

from __future__ import annotations

from tactile_toolkit.mesh import SolidTensors


class DigitTensors(SolidTensors):
    """A map-style data set of digits; its grids cover the 10 x 10 cm of a digit and 1 cm of height."""

    extent_m = (0.1, 0.1, 0.01)
