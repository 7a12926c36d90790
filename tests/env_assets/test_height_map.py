from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, strategies as st

import tactile_toolkit.mesh.raster
from env_assets.mesh_view import top_surface
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh
from tactile_toolkit.mesh.raster import MAX_PIXELS
from tests.env_assets.shapes import box, cylinder, joined, surfaces


def exact_height(mesh: Mesh, x: float, y: float) -> Fraction | None:
    """The definition, in rational numbers: the highest closed upward triangle above a point."""
    heights = []
    point = (Fraction(x), Fraction(y))
    for face in mesh.faces:
        a, b, c = ([Fraction(value) for value in mesh.vertices_m[corner].tolist()] for corner in face)
        area = cross(a, b, c)
        if area <= 0:
            continue
        shares = [cross(b, c, point), cross(c, a, point), cross(a, b, point)]
        if min(shares) >= 0:
            weighted = zip(shares, (a, b, c), strict=True)
            heights.append(sum(share * corner[2] for share, corner in weighted) / area)
    return max(heights, default=None)


def cross(a, b, c) -> Fraction:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


@given(mesh=surfaces())
def test_every_pixel_is_exact_on_edges_and_corners_too(mesh):
    found = top_surface(mesh, 1.0)
    for row, y in enumerate(found.y_m):
        for column, x in enumerate(found.x_m):
            expected = exact_height(mesh, x, y)
            height = found.heights_m[row, column]
            assert np.isnan(height) if expected is None else abs(height - float(expected)) < 1e-6


@given(mesh=surfaces(), columns=st.integers(-40, 40), rows=st.integers(-40, 40))
def test_moving_by_whole_pixels_moves_the_map_and_changes_no_number(mesh, columns, rows):
    moved = Mesh(mesh.vertices_m + np.array([columns, rows, 0]), mesh.faces)
    here, there = top_surface(mesh, 1.0), top_surface(moved, 1.0)
    assert there.first_column == here.first_column + columns
    assert there.first_row == here.first_row + rows
    np.testing.assert_array_equal(there.heights_m, here.heights_m)
    lifted = top_surface(Mesh(mesh.vertices_m + np.array([0, 0, 0.25]), mesh.faces), 1.0)
    np.testing.assert_allclose(lifted.heights_m, here.heights_m + 0.25, rtol=0, atol=1e-6)


@given(one=surfaces(3), other=surfaces(3))
def test_the_map_of_several_is_the_highest_of_their_maps(one, other):
    both = top_surface(joined(one, other), 1.0)
    expected = np.full(both.heights_m.shape, np.nan, np.float32)
    for part in (top_surface(one, 1.0), top_surface(other, 1.0)):
        row = part.first_row - both.first_row
        column = part.first_column - both.first_column
        place = expected[row : row + part.heights_m.shape[0], column : column + part.heights_m.shape[1]]
        np.fmax(place, part.heights_m, out=place)
    np.testing.assert_array_equal(both.heights_m, expected)


@given(data=st.data(), pitch=st.sampled_from([0.0002, 0.1, 1 / 3, 1.0]))
def test_neighbours_leave_no_hole_between_them(data, pitch):
    """A bumpy sheet of squares, each cut along its diagonal: every centre inside is covered."""
    size = 5
    heights = data.draw(st.lists(st.floats(0, 1), min_size=size**2, max_size=size**2))
    shift = data.draw(st.tuples(st.floats(0, 1), st.floats(0, 1)))
    grid = np.stack(np.meshgrid(np.arange(size), np.arange(size)), axis=-1).reshape(-1, 2) + shift
    vertices = np.column_stack([grid, heights]) * pitch * 1.5
    corner = (np.arange(size - 1)[:, None] * size + np.arange(size - 1)).reshape(-1)
    lower = np.stack([corner, corner + 1, corner + size + 1], axis=1)
    upper = np.stack([corner, corner + size + 1, corner + size], axis=1)
    found = top_surface(Mesh(vertices, np.concatenate([lower, upper]).astype(np.int32)), pitch)
    low, high = vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0)
    inside_x = (found.x_m > low[0]) & (found.x_m < high[0])
    inside_y = (found.y_m > low[1]) & (found.y_m < high[1])
    assert found.covered[np.ix_(inside_y, inside_x)].all()
    assert np.nanmin(found.heights_m) >= np.float32(vertices[:, 2].min())
    assert np.nanmax(found.heights_m) <= np.float32(vertices[:, 2].max())


def test_a_box_is_flat_and_its_border_counts():
    found = top_surface(box((0.25, 0.5, 1), (2.5, 3.5, 4)), 1.0)
    assert found.heights_m.shape == (4, 3)
    # The sides at y = 0.5, y = 3.5 and x = 2.5 pass through pixel centres, which are covered.
    np.testing.assert_array_equal(found.heights_m, np.full((4, 3), 4, np.float32))
    assert found.x_m.tolist() == [0.5, 1.5, 2.5]
    assert found.y_m.tolist() == [0.5, 1.5, 2.5, 3.5]


def test_a_cylinder_covers_its_polygon_and_nothing_else():
    sides, radius = 64, 10.0
    found = top_surface(cylinder(radius, 5.0, sides), 0.25)
    x, y = np.meshgrid(found.x_m, found.y_m)
    normals = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    beyond = np.max(np.multiply.outer(x, np.cos(normals)) + np.multiply.outer(y, np.sin(normals)), axis=2)
    beyond -= radius * np.cos(np.pi / sides)  # the distance from the polygon, negative inside
    np.testing.assert_array_equal(found.covered[np.abs(beyond) > 1e-9], beyond[np.abs(beyond) > 1e-9] < 0)
    assert set(found.heights_m[found.covered].tolist()) == {5.0}


def test_a_digit_agrees_with_a_search_over_all_triangles(assets):
    import mnist3d

    record = mnist3d.load(str(assets / "mnist3d"), "test")[3]
    found = top_surface(record, 0.0002)
    rng = np.random.default_rng(0)
    rows, columns = (rng.integers(0, size, 60) for size in found.heights_m.shape)
    corners = record.vertices_m.astype(np.float64)[record.faces]
    low, high = corners[..., :2].min(axis=1) - 1e-9, corners[..., :2].max(axis=1) + 1e-9
    expected = []
    for x, y in zip(found.x_m[columns], found.y_m[rows], strict=True):
        around = (low[:, 0] <= x) & (x <= high[:, 0]) & (low[:, 1] <= y) & (y <= high[:, 1])
        expected.append(searched_height(corners[around], x, y))
    np.testing.assert_allclose(found.heights_m[rows, columns], expected, rtol=0, atol=1e-8)
    assert 6 < np.isfinite(expected).sum() < 54


def searched_height(corners, x: float, y: float) -> float:
    """Solve for the barycentric coordinates in every triangle, whether it faces up or down."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        v = ((x - a[:, 0]) * (c - a)[:, 1] - (y - a[:, 1]) * (c - a)[:, 0]) / area
        w = ((b - a)[:, 0] * (y - a[:, 1]) - (b - a)[:, 1] * (x - a[:, 0])) / area
        inside = (v >= -1e-9) & (w >= -1e-9) & (v + w <= 1 + 1e-9)
    heights = a[:, 2] + v * (b - a)[:, 2] + w * (c - a)[:, 2]
    return heights[inside].max() if inside.any() else np.nan


def test_a_digit_covers_the_area_of_its_projection(assets):
    """The area under the map against manifold3d's projection of the solid."""
    import mnist3d

    record = mnist3d.load(str(assets / "mnist3d"), "test")[0]
    found = top_surface(record, 0.0001)
    shadow_m2 = Mesh(record.vertices_m, record.faces).to_manifold().project().area() * 1e-6
    assert found.covered.sum() * 0.0001**2 == pytest.approx(shadow_m2, rel=2e-3)


def test_working_in_parts_changes_nothing(assets, monkeypatch):
    import mnist3d

    record = mnist3d.load(str(assets / "mnist3d"), "test")[0]
    whole = top_surface(record, 0.0005)
    monkeypatch.setattr(tactile_toolkit.mesh.raster, "_AT_ONCE", 50)
    np.testing.assert_array_equal(top_surface(record, 0.0005).heights_m, whole.heights_m)


def test_filled_stands_on_the_plate_and_does_not_change_the_map():
    found = top_surface(cylinder(2.0, 1.0, 6), 0.5)
    filled = found.filled()
    assert filled.dtype == np.float32
    assert np.array_equal(filled == 0, ~found.covered)
    assert found.filled(-1.0).min() == -1
    with pytest.raises(ValueError, match="read-only"):
        found.heights_m[0, 0] = 0


@pytest.mark.parametrize("pitch", [0, -0.1, float("nan"), float("inf")])
def test_a_pitch_that_is_not_a_length_is_refused(pitch):
    with pytest.raises(InputError, match="expected a positive length"):
        top_surface(box((0, 0, 0), (1, 1, 1)), pitch)


def test_a_grid_that_would_fill_the_memory_is_refused():
    with pytest.raises(InputError, match=f"at most {MAX_PIXELS:,} are made; next: choose a larger pitch"):
        top_surface(box((0, 0, 0), (1, 1, 1)), 1e-5)


@pytest.mark.parametrize("vertices", [np.zeros((0, 3)), np.array([[0, 0, 0], [1, np.nan, 0], [0, 1, 0.0]])])
def test_a_mesh_without_a_surface_is_refused(vertices):
    with pytest.raises(InputError, match="has no height map"):
        top_surface(Mesh(vertices, np.zeros((0, 3), np.int32)), 1.0)
