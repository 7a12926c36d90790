from __future__ import annotations

import hashlib
import json
import math
import pickle
from functools import cache

import numpy as np
import pytest
from hypothesis import given

from starstruck_gen.sampling import SceneSpec
from starstruck_gen.scene_checks import check_scene
from starstruck_gen.scene_dataset import SceneRow, make_rows, scene_schema
from starstruck_gen.shapes import KINDS, Crescent, Cross, Disc, Ring, Shape, Star, outline, prism
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh, check_manifold
from tests.starstruck_gen.strategies import shapes

AREAS = {
    "star": 5 * 0.5 * math.sin(math.pi / 5),
    "box": 2.0,
    "disc": 16 * math.sin(math.tau / 32),
    "triangle": 1.5 * math.sin(math.tau / 3),
    "hexagon": 3 * math.sin(math.tau / 6),
    "ring": 0.75 * 16 * math.sin(math.tau / 32),
    "cross": 4 * 0.3 * (2 * math.sqrt(1 - 0.3**2) - 0.3),
    "star(points=7,inner_ratio=0.3)": 7 * 0.3 * math.sin(math.pi / 7),
    "disc(segments=100)": 50 * math.sin(math.tau / 100),
    "ring(hole_ratio=0.25,segments=64)": (1 - 0.25**2) * 32 * math.sin(math.tau / 64),
    "cross(arm_ratio=0.2)": 4 * 0.2 * (2 * math.sqrt(1 - 0.2**2) - 0.2),
}


@pytest.mark.parametrize("name", AREAS)
def test_area_is_that_of_the_ideal_shape(name):
    assert prism(name).area == pytest.approx(AREAS[name], rel=1e-12)


def test_published_star_has_its_first_tip_on_x_and_notches_at_half_radius():
    (ring,) = outline("star")
    assert ring[0].tolist() == [1.0, 0.0]
    assert np.linalg.norm(ring, axis=1) == pytest.approx([1.0, 0.5] * 5)
    angles = np.unwrap(np.arctan2(ring[:, 1], ring[:, 0]))
    assert np.diff(angles) == pytest.approx([math.pi / 5] * 9)


@given(shapes())
def test_every_shape_is_one_closed_outward_solid_of_radius_one_with_every_corner_used(shape):
    made = prism(shape.key)
    assert not any(ring.flags.writeable for ring in outline(shape.key))
    assert np.linalg.norm(made.corners, axis=1).max() == pytest.approx(1.0, abs=1e-12)
    mesh = Mesh(made.vertices(0.5) * 0.01, made.faces)
    verdict = check_manifold(mesh)
    assert (verdict.problem, verdict.bodies, verdict.genus) == (None, 1, int(shape.name == "ring"))
    assert mesh.volume_m3 == pytest.approx(0.5e-6 * made.area, rel=1e-12)
    assert set(made.cap.ravel().tolist()) == set(range(len(made.corners)))


@pytest.mark.parametrize("name", KINDS)
def test_caps_have_no_t_junctions(name):
    """Corners lie on edges of cap triangles only at their ends."""
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
    monkeypatch.setattr("starstruck_gen.shapes.outline", lambda _: (np.array(ring, dtype=float),))
    with pytest.raises(InputError, match=reason):
        prism.__wrapped__("wrong")


def test_defaults_are_the_published_numbers():
    assert Shape("star").proportions == Star(points=5, inner_ratio=0.5)
    assert Shape("disc").proportions == Disc(segments=32)
    for name in KINDS:
        assert Shape(name).key == name
        for ring, same in zip(outline(name), KINDS[name]().rings(), strict=True):
            assert np.array_equal(ring, same)


def test_published_outlines_never_change():
    """Outlines decide every byte of a data set; the sums are older than the parameters."""
    sums = {
        name: [hashlib.sha256(ring.tobytes()).hexdigest()[:16] for ring in outline(name)] for name in KINDS
    }
    assert sums == {
        "star": ["98dfa101a150bd59"],
        "box": ["952d6dc8e04a8502"],
        "disc": ["0ccee5bd1f7de465"],
        "triangle": ["adcf62a7da19f884"],
        "hexagon": ["8cb362b0404ebe07"],
        "ring": ["0ccee5bd1f7de465", "2a0dddf9e9d5e0e9"],
        "cross": ["bc653f7cba8d434d"],
        "crescent": ["3544ff6db354e431"],
    }


@given(shapes())
def test_key_names_the_outline_and_comes_back(shape):
    again = Shape.parse(shape.key, shape.radius_m)
    assert again == shape
    assert again.key == shape.key
    for ring, same in zip(outline(shape.key), shape.proportions.rings(), strict=True):
        assert np.array_equal(ring, same)
    assert Shape.from_dict(json.loads(json.dumps(shape.to_dict()))) == shape
    assert pickle.loads(pickle.dumps(shape)).key == shape.key


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Star(points=2), "points of shape 'star' is 2; expected an integer from 3 to 64"),
        (lambda: Star(inner_ratio=0.9), r"inner_ratio .* 0.9; expected at most 0.8009 with 5 points"),
        (lambda: Star(points=3), "inner_ratio .* 0.5; expected at most 0.495 with 3 points"),
        (lambda: Ring(hole_ratio=1.0), "hole_ratio of shape 'ring' is 1.0; expected 0.05 to 0.95"),
        (lambda: Ring(segments=3), "segments of shape 'ring' is 3; expected an integer from 8 to 256"),
        (lambda: Disc(10**9), "segments of shape 'disc' is 1000000000"),
        (lambda: Cross(math.nan), "arm_ratio of shape 'cross' is nan"),
        (lambda: Crescent(bite_ratio=None), "bite_ratio of shape 'crescent' is None"),
        (lambda: Shape("ring", 0.01, Star()), r"proportions of shape 'ring' are Star\(.*expected Ring"),
        (lambda: Shape.parse("ring(hole=0.3)"), "unknown proportion 'hole' of shape 'ring'; expected one of"),
        (lambda: Shape.parse("box(side=1)"), "unknown proportion 'side' of shape 'box'; expected none"),
        (
            lambda: Shape.parse("ring(0.3)"),
            "'0.3' in shape 'ring.0.3.' is not a proportion; expected each once",
        ),
        (
            lambda: Shape.parse("ring(hole_ratio=.3,hole_ratio=.4)"),
            "'hole_ratio=.4' .* each once as NAME=NUMB",
        ),
        (lambda: Shape("star", "10"), "radius_m of shape 'star' is '10'; expected 0.0001 to 1"),
        (lambda: Shape.parse("ring(hole_ratio=0.3"), "is not a shape; expected a name such as ring"),
        (lambda: outline("star(points=1e9)"), "points of shape 'star' is 1000000000.0"),
        (lambda: outline("moon"), "unknown shape 'moon'; expected one of star, box"),
    ],
)
def test_invalid_proportions_are_named_with_the_expected_ones(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_numbers_of_other_types_are_the_same_shape():
    shape = Shape("star", 0.01, Star(np.int64(6), np.float32(0.5)))
    assert shape == Shape("star", 0.01, Star(6, 0.5))
    assert shape.key == "star(points=6)"
    assert json.dumps(Shape("star", np.float32(0.5)).to_dict()["radius_m"]) == "0.5"
    assert json.dumps(shape.to_dict()["proportions"]) == '{"points": 6, "inner_ratio": 0.5}'


@cache
def fancy() -> SceneSpec:
    """A function, not a constant: its solids are checked by kernels that numba may have to compile."""
    return SceneSpec(
        star=Shape("star", 0.008, Star(points=7, inner_ratio=0.35)),
        distractor_shapes=(
            Shape("ring", 0.008, Ring(hole_ratio=0.8, segments=12)),
            Shape("ring", 0.006),
            Shape("crescent", 0.008, Crescent(bite_ratio=0.4)),
        ),
        distractors=(2, 4),
    )


@pytest.fixture(scope="module")
def fancy_file(tmp_path_factory):
    import pyarrow.parquet as pq

    rows = make_rows(fancy(), "train", 0, 0, 60)
    path = tmp_path_factory.mktemp("fancy") / "train-00000-of-00001.parquet"
    pq.write_table(SceneRow.table(rows, scene_schema(fancy().class_names)), path)
    return path


def test_scenes_of_other_proportions_are_proved_from_their_stored_rows_alone(fancy_file):
    import starstruck_gen

    scenes = starstruck_gen.load(str(fancy_file))
    assert [check_scene(record)[0] for record in scenes] == [None] * 60
    assert {p.shape for record in scenes for p in record.placements} == {
        "star(points=7,inner_ratio=0.35)",
        "ring(hole_ratio=0.8,segments=12)",
        "ring",
        "crescent(bite_ratio=0.4)",
    }
    assert all(p.is_star == p.shape.startswith("star") for record in scenes for p in record.placements)
    assert scenes[0].scene.draw(px_per_mm=1.0).size == (120, 120)


def test_specification_with_proportions_goes_through_json():
    values = json.loads(json.dumps(fancy().to_dict()))
    assert values["star"]["proportions"] == {"points": 7, "inner_ratio": 0.35}
    assert SceneSpec.from_dict(values) == fancy()


@pytest.mark.parametrize(
    "star", [{"name": "star", "proportions": {"tips": 6}}, {"name": "star", "proportions": 3}]
)
def test_wrong_proportions_in_json_are_refused(star):
    with pytest.raises(InputError, match=r"unknown proportion 'tips'|scene specification"):
        SceneSpec.from_dict({"star": star})
