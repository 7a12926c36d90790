from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from starstruck_gen.sampling import SceneSpec, sample_scenes
from starstruck_gen.scene import Placement, Scene, build_meshes
from starstruck_gen.shapes import prism
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import check_manifold
from tests.starstruck_gen.strategies import placements, specs


@given(specs(), st.integers(0, 1_000))
def test_mesh_is_one_solid_per_object_and_none_overlap(spec, index):
    scene = sample_scenes(spec, "train", 3, index, 1)[0]
    mesh = scene.mesh()
    assert mesh.vertices_m.dtype == np.float32
    assert mesh.faces.dtype == np.int32
    verdict = check_manifold(mesh)
    assert verdict.problem is None
    assert verdict.bodies == len(scene.placements)
    expected_m3 = sum(prism(p.shape).area * p.radius_m**2 * p.height_m for p in scene.placements)
    assert mesh.volume_m3 == pytest.approx(expected_m3, rel=1e-4)
    assert mesh.bounds_m[0, 2] == 0.0
    assert mesh.bounds_m[1, 2] == pytest.approx(max(p.height_m for p in scene.placements))


@given(placements())
def test_single_object_is_a_solid_wherever_it_stands(placement):
    """Up to a metre from the origin, where float32 has steps of 60 nm."""
    verdict = check_manifold(build_meshes([[placement]])[0])
    assert verdict.problem is None
    assert verdict.bodies == 1


@given(st.lists(st.lists(placements(), max_size=4), max_size=4))
def test_mesh_does_not_depend_on_its_batch(layouts):
    batch = build_meshes(layouts)
    assert len(batch) == len(layouts)
    for index, layout in enumerate(layouts):
        alone, among = build_meshes([layout])[0], batch[index]
        assert alone.vertices_m.tobytes() == among.vertices_m.tobytes()
        assert np.array_equal(alone.faces, among.faces)


@given(placements())
def test_vertices_are_the_turned_scaled_moved_outline(placement):
    vertices = build_meshes([[placement]])[0].vertices_m
    turn = np.exp(1j * placement.angle_rad)
    corners = prism(placement.shape).corners @ [1, 1j] * turn * placement.radius_m
    expected = corners + placement.x_m + 1j * placement.y_m
    assert np.allclose(vertices[::2, :2] @ [1, 1j], expected, atol=1e-7)
    assert np.array_equal(vertices[::2, :2], vertices[1::2, :2])
    assert not vertices[::2, 2].any()
    assert (vertices[1::2, 2] == np.float32(placement.height_m)).all()


def test_picture_shows_every_object_where_it_stands():
    scene = sample_scenes(SceneSpec(), "train", 0, 2, 1)[0]
    picture = scene.draw(px_per_mm=4.0)
    assert picture.size == (480, 480)
    pixels = np.asarray(picture)
    for placement in scene.placements:
        column = round(240 + 4_000 * placement.x_m)
        row = round(240 - 4_000 * placement.y_m)
        red, _, blue = pixels[row, column].tolist()
        assert (red > blue) == placement.is_star
    assert pixels[0, 0].tolist() == pixels[-1, -1].tolist()


def test_object_inside_a_hole_stays_visible():
    placements = (Placement("disc", 0, 0, 0, 0.003, 0.005), Placement("ring", 0, 0, 0, 0.01, 0.005))
    scene = Scene(0, placements, (1, 1), 0)
    pixels = np.asarray(scene.draw(cell_m=(0.03, 0.03), px_per_mm=6.0))
    plate, disc, hole = (pixels[place].tolist() for place in ((0, 0), (90, 90), (90, 90 + 24)))
    assert disc != plate == hole


@pytest.mark.parametrize("px_per_mm", [0.0, 1e3, math.nan, math.inf])
def test_picture_of_impossible_size_is_refused(px_per_mm):
    with pytest.raises(InputError, match="the picture would have"):
        sample_scenes(SceneSpec(), "train", 0, 0, 1)[0].draw(px_per_mm=px_per_mm)
