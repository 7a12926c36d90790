"""How far two surfaces lie apart, for tests and benchmarks; trimesh measures this with rtree only."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from trimesh import triangles

from tactile_toolkit.mesh import MM_PER_M, Mesh

CANDIDATES = 8
SAMPLES_PER_FACE = 8
MOST_SAMPLES = 100_000


def symmetric_distances_mm(one: Mesh, other: Mesh, count: int = 10_000, seed: int = 0) -> NDArray[np.float64]:
    """Measure from `count` points of either surface to the other one, first from `one`; shape (2 count,)."""
    rng = np.random.default_rng(seed)
    there = _distances_to_surface_mm(_sample_surface_mm(one, count, rng)[0], other, rng)
    back = _distances_to_surface_mm(_sample_surface_mm(other, count, rng)[0], one, rng)
    return np.concatenate([there, back])


def _sample_surface_mm(
    mesh: Mesh, count: int, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Choose points on a surface, evenly over its area, and the triangle of each."""
    a, b, c = np.moveaxis(_corners_mm(mesh), 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    face_of = rng.choice(len(area), size=count, p=area / area.sum())
    u, v = rng.random((2, count, 1))
    beyond = u + v > 1
    u, v = np.where(beyond, 1 - u, u), np.where(beyond, 1 - v, v)
    return a[face_of] + u * (b - a)[face_of] + v * (c - a)[face_of], face_of


def _distances_to_surface_mm(
    points_mm: NDArray[np.float64], mesh: Mesh, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Measure from points to the nearest point of a surface.

    The exact distance to the nearest of a few triangles, which a dense sample of the surface proposes; it can
    only err upwards.
    """
    count = min(SAMPLES_PER_FACE * len(mesh.faces), MOST_SAMPLES)
    samples, face_of = _sample_surface_mm(mesh, count, rng)
    corners = _corners_mm(mesh)
    samples = np.concatenate([samples, corners.mean(axis=1)])
    face_of = np.concatenate([face_of, np.arange(len(corners))])
    _, nearest = cKDTree(samples).query(points_mm, k=CANDIDATES)
    faces = face_of[nearest.ravel()]
    targets = np.repeat(points_mm, CANDIDATES, axis=0)
    find_closest: Any = triangles.closest_point
    closest = find_closest(corners[faces], targets)
    return np.asarray(np.linalg.norm(closest - targets, axis=1).reshape(-1, CANDIDATES).min(axis=1))


def _corners_mm(mesh: Mesh) -> NDArray[np.float64]:
    return np.asarray(mesh.vertices_m, dtype=np.float64)[mesh.faces] * MM_PER_M
