"""Shapes as solids, each of which is checked once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import manifold3d
import numpy as np

from starstruck_gen.shapes import PUBLISHED_RADIUS_M, Shape, outline
from tactile_toolkit import mesh
from tactile_toolkit.array_types import Float64, Int32, Int64
from tactile_toolkit.errors import InputError

MAX_KEPT = 1_024
"""Largest number of solids of shapes in memory."""


@dataclass(frozen=True, slots=True, eq=False)
class Prism:
    """The solid of a shape without its size; lengths in units of the circumscribed radius.

    Vertex 2i of the solid is corner i on the plate, vertex 2i + 1 the one above it. Arrays are read-only.
    """

    corners: Float64  # (n, 2): all rings of the outline one after another
    cap: Int32  # (T, 3): triangles over all corners, counter-clockwise, none on another's edge
    faces: Int32  # (F, 3): triangles of the solid, outward
    area: float  # of the outline
    thinnest: float  # least height of a triangle of the cap; moves below half of it invert no triangle

    def vertices(self, height: float) -> Float64:
        """Return the vertices of an unturned prism of radius 1, shape (V, 3)."""
        standing = np.zeros((2 * len(self.corners), 3))
        standing[:, :2] = np.repeat(self.corners, 2, axis=0)
        standing[1::2, 2] = height
        return standing


@lru_cache(MAX_KEPT)
def prism(key: str) -> Prism:
    """Return the solid of the shape that a key names, made and checked on first use.

    Raises InputError for an unknown shape, and for proportions whose outline bounds no area.
    """
    rings = outline(key)
    corners = np.concatenate(rings)
    cap = np.asarray(manifold3d.triangulate(list(rings)), dtype=np.int32)
    a, b, c = (corners[cap[:, index]] for index in range(3))
    doubled_areas = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    # The least height of a triangle is twice its area over its longest side.
    sides = np.linalg.norm(corners[cap] - corners[np.roll(cap, 1, axis=1)], axis=2)
    made = Prism(
        corners,
        cap,
        _faces([len(ring) for ring in rings], cap),
        area=float(doubled_areas.sum() / 2),
        thinnest=float((doubled_areas / sides.max(axis=1)).min()),
    )
    for array in (made.corners, made.cap, made.faces):
        array.setflags(write=False)
    verdict = mesh.check_manifold(mesh.Mesh(made.vertices(0.5) * PUBLISHED_RADIUS_M, made.faces))
    problem = verdict.problem
    if problem is None and verdict.bodies != 1:
        problem = "in pieces"
    # A figure of eight can pass for a solid, but triangles of its cap are inverted.
    if problem is None and (doubled_areas <= 0).any():
        problem = "crossing itself"
    if problem is not None:
        raise InputError(
            f"the outline of shape {key!r} bounds no area ({problem}); expected one outer ring "
            "counter-clockwise, then holes clockwise, none touching another"
        )
    return made


@dataclass(frozen=True, slots=True, eq=False)
class Prisms:
    """The solids of several shapes one after another, before they are placed; read-only arrays."""

    corners: Float64  # (n, 2), of all prisms
    corner_counts: Int64  # of each prism
    faces: Int32  # (F, 3), numbered through all prisms


@lru_cache(MAX_KEPT)
def prisms(keys: tuple[str, ...]) -> Prisms:
    """Return the solids of the shapes that keys name, in their order.

    Results are cached, as scenes have few shapes in few orders; the published specification has 189 orders.
    """
    each = [prism(key) for key in keys]
    # Begins with empty arrays, since a layout may be empty.
    corners, faces, vertices = [np.zeros((0, 2))], [np.zeros((0, 3), np.int32)], 0
    for one in each:
        corners.append(one.corners)
        faces.append(one.faces + np.int32(vertices))
        vertices += 2 * len(one.corners)
    counts = np.array([len(one.corners) for one in each], dtype=np.int64)
    made = Prisms(np.concatenate(corners), counts, np.concatenate(faces))
    for array in (made.corners, made.corner_counts, made.faces):
        array.setflags(write=False)
    return made


def _faces(ring_sizes: list[int], cap: Int32) -> Int32:
    """Join the two caps by walls along each ring; holes are clockwise, so their walls face inwards."""
    starts = np.cumsum([0, *ring_sizes])
    here = np.arange(starts[-1])
    following = np.concatenate([np.roll(here[a:b], -1) for a, b in pairwise(starts)])
    walls = [
        np.stack([2 * here, 2 * following, 2 * following + 1], axis=1),
        np.stack([2 * here, 2 * following + 1, 2 * here + 1], axis=1),
    ]
    return np.concatenate([2 * cap + 1, 2 * cap[:, ::-1], *walls]).astype(np.int32)


def require_fine_steps(
    shapes: Sequence[Shape], half_area_m: tuple[float, float], cell_m: tuple[float, float]
) -> None:
    """Refuse shapes so small, in a cell so large, that float32 coordinates could invert a triangle.

    Three corners that each move by up to e keep their orientation if the triangle is thicker than 2 e.
    """
    for shape in shapes:
        thinnest_m = prism(shape.key).thinnest * shape.radius_m
        farthest_m = np.array(half_area_m) + shape.radius_m
        # Rounding moves a corner by half a step along x and half a step along y.
        moved_m = math.hypot(*np.spacing(farthest_m.astype(np.float32)).tolist()) / 2
        if thinnest_m <= 2 * moved_m:
            raise InputError(
                f"cell_m of the scene specification is {cell_m!r}; expected a smaller cell for shape "
                f"{shape.key!r} of radius_m {shape.radius_m!r}: the thinnest triangle of the shape is "
                f"{thinnest_m:.2g} m high, and float32 moves its corners by up to {moved_m:.2g} m",
                next="lower cell_m (--cell-mm) or the corners of the shape (segments, points), or raise "
                "radius_m (--radius-mm)",
            )
