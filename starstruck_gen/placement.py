"""Placements of objects, and tests whether they are far enough apart."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from starstruck_gen import shapes
from tactile_toolkit import mesh
from tactile_toolkit.arithmetic import cosine_sine

if TYPE_CHECKING:
    import manifold3d

STORAGE_MARGIN_M = 1e-7
"""Margin beyond the clearance: float32 storage moves coordinates by up to a third of it."""


class Placement(NamedTuple):
    """One object of a scene.

    Frame: origin at the cell's centre, x right, y away from the robot, z up from the plate.

    Attributes
    ----------
    shape : str
        The ``key`` of a :class:`starstruck_gen.Shape`: its name, with proportions that differ from those of
        its kind in brackets, such as ``star`` or ``star(points=6)``.
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
        """Whether the object is a star, which is counted."""
        return self.shape.partition("(")[0] == shapes.STAR


def circles_clear(one: Placement, others: Sequence[Placement], clearance_m: float) -> bool:
    """Return whether circumscribed circles keep a clearance: the rule of package tactile-mnist 0.13.0."""
    _, x_m, y_m, _, radius_m, _ = one
    # A loop of products, without calls or roots: each pair of objects is tested up to 100 times.
    for _, other_x_m, other_y_m, _, other_radius_m, _ in others:
        along_m, across_m = x_m - other_x_m, y_m - other_y_m
        least_m = radius_m + other_radius_m + clearance_m + STORAGE_MARGIN_M
        if not along_m * along_m + across_m * across_m > least_m * least_m:  # NaN is not clear
            return False
    return True


def outlines_clear(one: Placement, others: Sequence[Placement], clearance_m: float) -> bool:
    """Return whether outlines keep a clearance, as measured by manifold3d.

    An object inside a hole of another one is clear of it; an object inside its solid is not.
    """
    least_mm = (clearance_m + STORAGE_MARGIN_M) * mesh.MM_PER_M
    near = (other for other in others if not circles_clear(one, [other], clearance_m))
    pairs = ((_standing(one), _standing(other)) for other in near)
    # The gap does not reveal an object inside another one, and is slow to compute if objects overlap.
    return all((a ^ b).is_empty() and a.min_gap(b, 2 * least_mm) > least_mm for a, b in pairs)


COLLISION_TESTS = {"circles": circles_clear, "exact": outlines_clear}
"""Collision rules by name: whether an object keeps a clearance, in metres, to others."""


def _standing(placement: Placement) -> manifold3d.Manifold:
    """Return the solid of an object in its place, millimetres, 1 mm high."""
    c, s = cosine_sine(placement.angle_rad)
    x_mm, y_mm = placement.x_m * mesh.MM_PER_M, placement.y_m * mesh.MM_PER_M
    matrix = np.array([[c, -s, 0.0, x_mm], [s, c, 0.0, y_mm], [0.0, 0.0, 1.0, 0.0]])
    return prism_solid(placement.shape, placement.radius_m).transform(matrix)


@lru_cache(shapes.MAX_KEPT)
def prism_solid(key: str, radius_m: float) -> manifold3d.Manifold:
    """Return the solid of a shape for manifold3d: millimetres, 1 mm high, centred, not turned."""
    made = shapes.prism(key)
    vertices_m = made.vertices(0.0) * radius_m
    vertices_m[1::2, 2] = 1e-3
    return mesh.Mesh(vertices_m, made.faces).to_manifold()
