"""Whether two objects stand far enough apart."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from starstruck_gen.placement import Placement
from starstruck_gen.prisms import _MOST_KEPT, prism
from tactile_toolkit import mesh
from tactile_toolkit.arithmetic import cosine_sine

STORAGE_MARGIN_M = 1e-7
"""Kept beyond the clearance asked for: storing coordinates as float32 moves them by up to a third of it."""


def circles_clear(one: Placement, others: Sequence[Placement], clearance_m: float) -> bool:
    """Return whether circumscribed circles keep a clearance: the rule of package tactile-mnist 0.13.0."""
    _, x_m, y_m, _, radius_m, _ = one
    # Loop and products, no call or root: this is asked up to 100 times for each pair of objects.
    for _, other_x_m, other_y_m, _, other_radius_m, _ in others:
        along_m, across_m = x_m - other_x_m, y_m - other_y_m
        least_m = radius_m + other_radius_m + clearance_m + STORAGE_MARGIN_M
        if not along_m * along_m + across_m * across_m > least_m * least_m:  # no place that is NaN is clear
            return False
    return True


def outlines_clear(one: Placement, others: Sequence[Placement], clearance_m: float) -> bool:
    """Return whether the outlines themselves keep a clearance; measured by manifold3d.

    An object inside another's hole is clear of it, one inside its solid is not.
    """
    least_mm = (clearance_m + STORAGE_MARGIN_M) * mesh.MM_PER_M
    near = (other for other in others if not circles_clear(one, [other], clearance_m))
    pairs = ((_standing(one), _standing(other)) for other in near)
    # The gap alone would not reveal an object inside another one, whose surfaces can be far apart; and of two
    # that overlap it takes several times as long to find.
    return all((a ^ b).is_empty() and a.min_gap(b, 2 * least_mm) > least_mm for a, b in pairs)


COLLISION_TESTS = {"circles": circles_clear, "exact": outlines_clear}
"""Collision rules by name: does an object keep a clearance, in metres, to some others?"""


def _standing(placement: Placement) -> Any:
    """Return the solid of an object where it stands, millimetres, 1 mm high."""
    c, s = cosine_sine(placement.angle_rad)
    x_mm, y_mm = placement.x_m * mesh.MM_PER_M, placement.y_m * mesh.MM_PER_M
    matrix = np.array([[c, -s, 0.0, x_mm], [s, c, 0.0, y_mm], [0.0, 0.0, 1.0, 0.0]])
    return prism_solid(placement.shape, placement.radius_m).transform(matrix)


@lru_cache(_MOST_KEPT)
def prism_solid(key: str, radius_m: float) -> Any:
    """Return the solid of a shape for manifold3d: millimetres, 1 mm high, unturned, centre at the origin."""
    made = prism(key)
    vertices_m = made.vertices(0.0) * radius_m
    vertices_m[1::2, 2] = 1e-3
    return mesh.Mesh(vertices_m, made.faces).to_manifold()
