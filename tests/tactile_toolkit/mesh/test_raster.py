"""The rasteriser: coverage of pixels, and the highest surface at each."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from tactile_toolkit.mesh import highest_values
from tactile_toolkit.mesh.raster import highest_faces


@given(st.integers(0, 2**32 - 1))
def test_the_highest_triangle_agrees_with_a_search_at_each_pixel(seed):
    random = np.random.default_rng(seed)
    points = random.uniform(-4, 20, (9, 3)) + np.array((0, 0, random.uniform(-50, 50)))
    faces = random.integers(0, 9, (7, 3))
    seen = highest_faces(points.T, faces, (12, 16), both_sides=True)
    for row, column in random.integers(0, (12, 16), (25, 2)):
        depths = {
            number: depth
            for number, face in enumerate(faces)
            if (depth := _depth_at(points[face], column, row)) is not None
        }
        if seen[row, column] < 0:
            assert not depths
        else:
            closest = max(depths.values())
            assert depths[int(seen[row, column])] == pytest.approx(closest, abs=1e-6)


def _depth_at(corners: np.ndarray, x: float, y: float) -> float | None:
    matrix = np.vstack([corners[:, :2].T, np.ones(3)])
    if abs(np.linalg.det(matrix)) < 1e-12:
        return None
    shares = np.linalg.solve(matrix, [x, y, 1.0])
    return float(shares @ corners[:, 2]) if (shares >= 0).all() else None


def test_triangles_that_face_away_are_drawn_only_on_request():
    points = np.array([(0, 8, 0), (0, 0, 8), (1, 1, 1)], float)
    for faces, seen in (([[0, 1, 2]], True), ([[0, 2, 1]], False)):
        assert (highest_faces(points, np.array(faces), (4, 4)) == 0).all() == seen
        assert (highest_faces(points, np.array(faces), (4, 4), both_sides=True) == 0).all()
        assert np.isfinite(highest_values(points, np.array(faces), (4, 4))).all() == seen


def test_of_equally_high_triangles_the_later_is_seen():
    points = np.array([(0, 8, 0), (0, 0, 8), (1, 1, 1)], float)
    assert (highest_faces(points, np.array([[0, 1, 2], [0, 1, 2]]), (4, 4)) == 1).all()


def test_no_triangles_cover_no_pixels():
    assert (highest_faces(np.zeros((3, 0)), np.zeros((0, 3), int), (2, 3)) == -1).all()
    assert np.isneginf(highest_values(np.zeros((3, 0)), np.zeros((0, 3), int), (2, 3))).all()
