"""Where one object of a scene stands, and when two stand far enough apart."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from starstruck_gen.shapes import STAR
from starstruck_gen.solid import prism_solid
from tactile_toolkit.mesh.mesh import MM_PER_M

__all__ = ["CLEAR", "STORAGE_MARGIN_M", "Clear", "Placement", "Rejected", "circles_clear", "outlines_clear"]

STORAGE_MARGIN_M = 1e-7
"""Kept beyond the clearance asked for: storing coordinates as float32 moves them by up to a third of it."""


class Placement(NamedTuple):
    """One object of a scene.

    Frame: origin at the cell's centre, x right, y away from the robot, z up from the plate.

    Attributes
    ----------
    shape : str
        Name of the shape, with the proportions that are not its kind's own in brackets: ``star``,
        ``star(points=6)``; the ``key`` of a :class:`starstruck_gen.Shape`.
    x_m, y_m : float
        Centre of its circumscribed circle, metres.
    angle_rad : float
        Rotation about z, counter-clockwise, radians.
    radius_m : float
        Circumscribed radius, metres.
    height_m : float
        Height over the plate, metres.
    """

    shape: str
    x_m: float
    y_m: float
    angle_rad: float
    radius_m: float
    height_m: float

    @property
    def is_star(self) -> bool:
        """Whether the object counts."""
        return self.shape.partition("(")[0] == STAR


@dataclass(frozen=True, slots=True)
class Rejected:
    """A position that was drawn and not taken.

    ``blocker`` is the object, the first found, that ``candidate`` would have come too close to; in a layout
    that was given up it is not part of the scene.
    """

    candidate: Placement
    blocker: Placement
    given_up: bool


Clear = Callable[[Placement, Placement, float], bool]
"""Whether two objects keep a clearance in metres."""


def circles_clear(one: Placement, other: Placement, clearance_m: float) -> bool:
    """Tell whether circumscribed circles keep a clearance: the rule of package tactile-mnist 0.13.0."""
    least_m = one.radius_m + other.radius_m + clearance_m + STORAGE_MARGIN_M
    return (one.x_m - other.x_m) ** 2 + (one.y_m - other.y_m) ** 2 > least_m * least_m


def outlines_clear(one: Placement, other: Placement, clearance_m: float) -> bool:
    """Tell whether the outlines themselves keep a clearance; measured by manifold3d.

    An object inside another's hole is clear of it, one inside its solid is not.
    """
    if circles_clear(one, other, clearance_m):
        return True
    first, second = _standing(one), _standing(other)
    least_mm = (clearance_m + STORAGE_MARGIN_M) * MM_PER_M
    # The gap alone would not tell an object inside another one, whose surfaces can be far apart; and of two
    # that overlap it takes several times as long to find.
    return bool((first ^ second).is_empty() and first.min_gap(second, 2 * least_mm) > least_mm)


CLEAR: Mapping[str, Clear] = MappingProxyType({"circles": circles_clear, "exact": outlines_clear})
"""Collision rules by their name in the specification."""


def _standing(placement: Placement) -> Any:
    """Return the solid of an object where it stands, millimetres, 1 mm high."""
    c, s = math.cos(placement.angle_rad), math.sin(placement.angle_rad)
    x_mm, y_mm = placement.x_m * MM_PER_M, placement.y_m * MM_PER_M
    matrix = np.array([[c, -s, 0.0, x_mm], [s, c, 0.0, y_mm], [0.0, 0.0, 1.0, 0.0]])
    return prism_solid(placement.shape, placement.radius_m).transform(matrix)
