"""When two objects stand far enough apart."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from starstruck_gen.placement import Placement
from starstruck_gen.solid import prism_solid

__all__ = ["CLEAR", "STORAGE_MARGIN_M", "Clear", "circles_clear", "outlines_clear"]

STORAGE_MARGIN_M = 1e-7
"""Kept beyond the clearance asked for: storing coordinates as float32 moves them by up to a third of it."""

_MM_PER_M = 1000.0

Clear = Callable[[Placement, Placement, float], bool]
"""Whether two objects keep a clearance in metres."""


def circles_clear(one: Placement, other: Placement, clearance_m: float) -> bool:
    """Tell whether circumscribed circles keep a clearance: the published rule (package tactile-mnist 0.13.0).

    Parameters
    ----------
    one, other : Placement
        Two objects.
    clearance_m : float
        Least distance between the circles, metres.
    """
    least_m = one.radius_m + other.radius_m + clearance_m + STORAGE_MARGIN_M
    return (one.x_m - other.x_m) ** 2 + (one.y_m - other.y_m) ** 2 > least_m * least_m


def outlines_clear(one: Placement, other: Placement, clearance_m: float) -> bool:
    """Tell whether the outlines themselves keep a clearance; measured by manifold3d.

    Parameters
    ----------
    one, other : Placement
        Two objects.
    clearance_m : float
        Least distance between the outlines, metres. An object inside another's hole is clear of it, one
        inside its solid is not.
    """
    if circles_clear(one, other, clearance_m):
        return True
    first, second = _standing(one), _standing(other)
    least_mm = (clearance_m + STORAGE_MARGIN_M) * _MM_PER_M
    # The gap alone would not tell an object inside another one, whose surfaces can be far apart; and of two
    # that overlap it takes several times as long to find.
    return bool((first ^ second).is_empty() and first.min_gap(second, 2 * least_mm) > least_mm)


CLEAR: Mapping[str, Clear] = MappingProxyType({"circles": circles_clear, "exact": outlines_clear})
"""Collision rules by their name in the specification."""


def _standing(placement: Placement) -> Any:
    """Return the solid of an object where it stands, millimetres, 1 mm high."""
    import numpy as np

    c, s = math.cos(placement.angle_rad), math.sin(placement.angle_rad)
    x_mm, y_mm = placement.x_m * _MM_PER_M, placement.y_m * _MM_PER_M
    matrix = np.array([[c, -s, 0.0, x_mm], [s, c, 0.0, y_mm], [0.0, 0.0, 1.0, 0.0]])
    return prism_solid(placement.shape, placement.radius_m).transform(matrix)
