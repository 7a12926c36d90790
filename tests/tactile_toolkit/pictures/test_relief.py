"""Views of solids, from above and oblique: geometry, shading and colours."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from tactile_toolkit.mesh import Mesh
from tactile_toolkit.pictures import View
from tests.tactile_toolkit.mesh.solid_files import box

CLAY = (200, 120, 40)
angles = st.floats(-180, 180), st.floats(5, 90)
TOP = View(0.0, 90.0)


def lifted(mesh: Mesh, z_m: float) -> Mesh:
    return Mesh(mesh.vertices_m + np.array((0.0, 0.0, z_m)), mesh.faces)


@given(*angles)
def test_a_view_has_three_directions_at_right_angles(azimuth, elevation):
    axes = View(azimuth, elevation).axes
    assert np.allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert axes[0, 2] == 0.0, "the horizon is level"
    assert np.allclose(TOP.axes, np.eye(3), atol=1e-12)


def test_a_box_from_above_covers_its_area_to_the_pixel():
    picture = ((box(20, 10, 5), CLAY),), (260, 160), 10_000.0
    covered = (TOP.draw(*picture) < 250).any(axis=2)
    rows, columns = np.nonzero(covered)
    assert (np.ptp(columns) + 1, np.ptp(rows) + 1) == (200, 100)
    assert covered.sum() == 200 * 100
    assert (columns.min(), rows.min()) == (30, 30)


def test_closer_surfaces_hide_those_behind():
    high, low = box(4, 4, 4), box(10, 10, 1)
    red, green = (lifted(high, 0.01), (250, 0, 0)), (low, (0, 250, 0))
    for bodies in ((red, green), (green, red)):
        drawn = TOP.draw(bodies, (100, 100), 8_000.0)
        assert drawn[50, 50, 0] > 100
        assert drawn[50, 50, 1] == 0
        assert drawn[14, 50, 1] > 100


def colours_of(pixels: np.ndarray) -> np.ndarray:
    """Return the distinct colours of a picture, except those of smoothed edges."""
    colours, counts = np.unique(pixels.reshape(-1, 3), axis=0, return_counts=True)
    return colours[counts > 300]


def test_sides_of_a_box_are_flat_and_its_edges_sharp():
    bodies = ((box(20, 10, 8), CLAY),)
    drawn = View.OBLIQUE.draw(bodies, (240, 180), 9_000.0)
    assert len(colours_of(drawn)) == 3 + 1  # three sides are visible, and the paper


def test_round_surfaces_are_shaded_smoothly():
    """Shading is smooth across triangles, and independent of their arrangement."""
    import trimesh

    views = []
    for made in (trimesh.creation.icosphere(3, 0.01), trimesh.creation.uv_sphere(0.01, [36, 36])):
        body = (Mesh(np.asarray(made.vertices), np.asarray(made.faces, np.int32)), CLAY)
        views.append(View.OBLIQUE.draw((body,), (120, 120), 5_000.0).astype(int))
    inside = np.hypot(*(np.indices((120, 120)) - 59.5)) < 45
    assert np.abs(views[0] - views[1])[inside].max() <= 6
    steps = np.abs(np.diff(views[0], axis=1))[inside[:, 1:] & inside[:, :-1]]
    assert steps.max() <= 8


def test_a_mesh_that_is_inside_out_is_lit_all_the_same():
    right = box(20, 10, 5)
    wrong = Mesh(right.vertices_m, right.faces[:, ::-1])
    views = [View.OBLIQUE.draw(((mesh, CLAY),), (120, 90), 3_000.0) for mesh in (right, wrong)]
    assert np.array_equal(*views)
