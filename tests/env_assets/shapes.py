"""Solids whose height above any point is known in closed form, and random surfaces on a dyadic lattice.

Coordinates are small multiples of powers of two, so that the expected heights are exact.
"""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from tactile_toolkit.mesh import Mesh

__all__ = ["box", "cylinder", "joined", "ramp", "surfaces"]

_BOX_FACES = np.array(
    [
        *([0, 2, 1], [0, 3, 2]),  # bottom
        *([4, 5, 6], [4, 6, 7]),  # top
        *([0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]),
    ],
    np.int32,
)


def box(low, high) -> Mesh:
    """An upright box."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    corners = [[x0, y0, z0], [x1, y0, z0], [x1, y1, z0], [x0, y1, z0]]
    corners += [[x, y, z1] for x, y, _ in corners]
    return Mesh(np.array(corners, np.float64), _BOX_FACES)


def ramp(length: float, width: float, low: float, high: float) -> Mesh:
    """A box from x = 0 to ``length`` whose top rises evenly along x."""
    solid = box((0, 0, 0), (length, width, 1)).vertices_m.copy()
    solid[4:, 2] = np.where(solid[4:, 0] == 0, low, high)
    return Mesh(solid, _BOX_FACES)


def cylinder(radius: float, height: float, sides: int) -> Mesh:
    """A prism on a regular polygon about the origin."""
    angles = 2 * np.pi * np.arange(sides) / sides
    ring = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    vertices = np.concatenate(
        [
            np.column_stack([ring, np.zeros(sides)]),
            np.column_stack([ring, np.full(sides, height)]),
            [[0, 0, 0], [0, 0, height]],
        ]
    )
    here, after = np.arange(sides), np.roll(np.arange(sides), -1)
    faces = [
        np.stack([after, here, np.full(sides, 2 * sides)], axis=1),
        np.stack([here + sides, after + sides, np.full(sides, 2 * sides + 1)], axis=1),
        np.stack([here, after, after + sides], axis=1),
        np.stack([here, after + sides, here + sides], axis=1),
    ]
    return Mesh(vertices, np.concatenate(faces).astype(np.int32))


def joined(*meshes: Mesh) -> Mesh:
    """Several meshes as one."""
    starts = np.cumsum([0, *(len(mesh.vertices_m) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
    return Mesh(np.concatenate([mesh.vertices_m for mesh in meshes]), np.concatenate(faces).astype(np.int32))


@st.composite
def surfaces(draw, most_triangles: int = 6) -> Mesh:
    """Loose triangles, corners on quarters of a pixel of side 1: many edges meet pixel centres."""
    quarter = st.integers(-12, 12).map(lambda number: number / 4)
    corner = st.tuples(quarter, quarter, quarter)
    triangles = draw(st.lists(st.tuples(corner, corner, corner), min_size=1, max_size=most_triangles))
    vertices = np.array(triangles, np.float64).reshape(-1, 3)
    return Mesh(vertices, np.arange(len(vertices), dtype=np.int32).reshape(-1, 3))
