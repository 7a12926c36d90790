"""Shapes as solids: prisms whose caps are triangulated once and proved once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starstruck_gen.shapes import PUBLISHED_RADIUS_M, outline
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.mesh import Mesh
from tactile_toolkit.mesh.solid_check import judge

__all__ = ["Prism", "prism", "prism_solid"]

_MOST_KEPT = 1_024


@dataclass(frozen=True, slots=True, eq=False)
class Prism:
    """The solid of a shape, up to its size.

    Attributes
    ----------
    corners : ndarray of float64, shape (n, 2)
        All rings of the outline one after another; unit: the circumscribed radius.
    cap : ndarray of int32, shape (T, 3)
        Triangles over ``corners``, counter-clockwise; every corner is used, none lies on another's edge.
    faces : ndarray of int32, shape (F, 3)
        Triangles of the solid, outward. Vertex 2i is corner i on the plate, vertex 2i + 1 the one above it.
    area : float
        Area of the outline; unit: squared circumscribed radius.
    thinnest : float
        Least height of a triangle of the cap: corners that move by less than half of it turn no triangle
        over. Unit: the circumscribed radius.
    """

    corners: NDArray[np.float64]
    cap: NDArray[np.int32]
    faces: NDArray[np.int32]
    area: float
    thinnest: float

    @property
    def vertex_count(self) -> int:
        """Vertices of the solid."""
        return 2 * len(self.corners)

    def vertices(self, height: float) -> NDArray[np.float64]:
        """Return the vertices of an unturned prism of radius 1, shape (V, 3)."""
        standing = np.zeros((self.vertex_count, 3))
        standing[:, :2] = np.repeat(self.corners, 2, axis=0)
        standing[1::2, 2] = height
        return standing


@lru_cache(_MOST_KEPT)
def prism(key: str) -> Prism:
    """Return the solid of a shape; made and proved on first use.

    Parameters
    ----------
    key : str
        What names its outline; see :func:`starstruck_gen.shapes.shape_key`.

    Raises
    ------
    InputError
        Unknown shape, or an outline that bounds no area (turned the wrong way, or crossing itself).
    """
    import manifold3d

    rings = outline(key)
    corners = np.concatenate(rings)
    cap = np.asarray(manifold3d.triangulate(list(rings)), dtype=np.int32)
    made = Prism(
        corners,
        cap,
        _faces([len(ring) for ring in rings], cap),
        float(_doubled_areas(corners, cap).sum() / 2),
        _thinnest(corners, cap),
    )
    for array in (made.corners, made.cap, made.faces):
        array.setflags(write=False)
    _require_sound(key, made)
    return made


@lru_cache(_MOST_KEPT)
def prism_solid(key: str, radius_m: float) -> Any:
    """Return the solid of a shape for manifold3d: millimetres, 1 mm high, unturned, centre at the origin."""
    made = prism(key)
    vertices_m = made.vertices(0.0) * radius_m
    vertices_m[1::2, 2] = 1e-3
    return Mesh(vertices_m, made.faces).to_manifold()


def _faces(ring_sizes: list[int], cap: NDArray[np.int32]) -> NDArray[np.int32]:
    """Join the two caps by walls that follow each ring; a hole runs clockwise, so its walls face inwards."""
    starts = np.cumsum([0, *ring_sizes])
    here = np.arange(starts[-1])
    following = np.concatenate([np.roll(here[a:b], -1) for a, b in pairwise(starts)])
    walls = [
        np.stack([2 * here, 2 * following, 2 * following + 1], axis=1),
        np.stack([2 * here, 2 * following + 1, 2 * here + 1], axis=1),
    ]
    return np.concatenate([2 * cap + 1, 2 * cap[:, ::-1], *walls]).astype(np.int32)


def _doubled_areas(corners: NDArray[np.float64], cap: NDArray[np.int32]) -> NDArray[np.float64]:
    a, b, c = (corners[cap[:, place]] for place in range(3))
    doubled = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    return np.asarray(doubled)


def _thinnest(corners: NDArray[np.float64], cap: NDArray[np.int32]) -> float:
    sides = np.linalg.norm(corners[cap] - corners[np.roll(cap, 1, axis=1)], axis=2)
    return float((_doubled_areas(corners, cap) / sides.max(axis=1)).min())


def _require_sound(key: str, made: Prism) -> None:
    mesh = Mesh(made.vertices(0.5) * PUBLISHED_RADIUS_M, made.faces)
    verdict = judge(mesh)
    wrong = verdict.problem or ("in pieces" if verdict.bodies != 1 else None)
    if wrong is None and (_doubled_areas(made.corners, made.cap) <= 0).any():
        wrong = "crossing itself"
    if wrong is not None:
        message = (
            f"the outline of shape {key!r} bounds no area ({wrong}); expected one outer ring "
            "counter-clockwise, then holes clockwise, none touching another"
        )
        raise InputError(message)
