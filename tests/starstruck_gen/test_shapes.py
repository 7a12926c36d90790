from __future__ import annotations

import math

import numpy as np
import pytest

from starstruck_gen.shapes import OUTLINES, Shape, outline
from starstruck_gen.solid import prism
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.mesh import Mesh
from tactile_toolkit.mesh.solid_check import check_manifold

AREAS = {
    "star": 5 * 0.5 * math.sin(math.pi / 5),
    "box": 2.0,
    "disc": 16 * math.sin(math.tau / 32),
    "triangle": 1.5 * math.sin(math.tau / 3),
    "hexagon": 3 * math.sin(math.tau / 6),
    "ring": 0.75 * 16 * math.sin(math.tau / 32),
    "cross": 4 * 0.3 * (2 * math.sqrt(1 - 0.3**2) - 0.3),
}


@pytest.mark.parametrize("name", OUTLINES)
def test_outline_reaches_its_circumscribed_circle_and_not_beyond(name):
    corners = np.concatenate(outline(name))
    assert np.linalg.norm(corners, axis=1).max() == pytest.approx(1.0, abs=1e-12)
    assert not any(ring.flags.writeable for ring in outline(name))


@pytest.mark.parametrize("name", AREAS)
def test_area_is_that_of_the_ideal_shape(name):
    assert prism(name).area == pytest.approx(AREAS[name], rel=1e-12)


def test_published_star_has_its_first_tip_on_x_and_notches_at_half_radius():
    (ring,) = outline("star")
    assert ring[0].tolist() == [1.0, 0.0]
    assert np.linalg.norm(ring, axis=1) == pytest.approx([1.0, 0.5] * 5)
    angles = np.unwrap(np.arctan2(ring[:, 1], ring[:, 0]))
    assert np.diff(angles) == pytest.approx([math.pi / 5] * 9)


def test_published_box_is_parallel_to_the_axes_with_side_root_two():
    (ring,) = outline("box")
    assert sorted(map(tuple, np.round(ring * math.sqrt(2), 9).tolist())) == [
        (-1, -1),
        (-1, 1),
        (1, -1),
        (1, 1),
    ]


def test_published_disc_has_32_corners():
    assert len(outline("disc")[0]) == 32


@pytest.mark.parametrize("name", OUTLINES)
def test_prism_is_one_closed_outward_solid_with_every_corner_used(name):
    made = prism(name)
    mesh = Mesh(made.vertices(0.5), made.faces)
    verdict = check_manifold(mesh)
    assert verdict.problem is None
    assert verdict.bodies == 1
    assert verdict.genus == (1 if name == "ring" else 0)
    assert mesh.volume_m3 == pytest.approx(0.5 * made.area, rel=1e-12)
    assert set(made.cap.ravel().tolist()) == set(range(len(made.corners)))


@pytest.mark.parametrize("name", OUTLINES)
def test_caps_have_no_t_junctions(name):
    """No corner lies on an edge of a cap triangle other than at its ends."""
    made = prism(name)
    a = made.corners[made.cap]
    b = np.roll(a, -1, axis=1)
    edge = b - a
    for corner in made.corners:
        along = ((corner - a) * edge).sum(-1) / (edge**2).sum(-1)
        off = np.linalg.norm(corner - (a + along[..., None] * edge), axis=-1)
        assert not ((off < 1e-9) & (along > 1e-9) & (along < 1 - 1e-9)).any()


def test_unknown_shape_is_refused_by_name():
    with pytest.raises(InputError, match=r"unknown shape 'stat'; expected one of star, box, disc"):
        Shape("stat")


@pytest.mark.parametrize("radius_m", [0.0, -0.01, 5.0, math.nan])
def test_unusable_radius_is_refused(radius_m):
    with pytest.raises(InputError, match="radius_m of shape 'box' is"):
        Shape("box", radius_m)


@pytest.mark.parametrize(
    ("ring", "reason"),
    [
        ([(1, 0), (-0.5, -0.8), (-0.5, 0.8)], "inside-out|crossing"),
        ([(1, 1), (-1, -1), (1, -1), (-1, 1)], "bounds no area"),
    ],
)
def test_outline_that_bounds_no_area_is_refused(monkeypatch, ring, reason):
    from starstruck_gen import solid

    monkeypatch.setattr(solid, "outline", lambda _: (np.array(ring, dtype=float),))
    with pytest.raises(InputError, match=reason):
        prism.__wrapped__("wrong")
