from __future__ import annotations

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given

from starstruck_gen.sampling import SceneSpec
from starstruck_gen.scene_checks import check_content
from starstruck_gen.scene_dataset import SceneRow, make_rows, scene_schema
from starstruck_gen.shapes import Disc, Shape
from tactile_toolkit.errors import InputError
from tests.starstruck_gen.strategies import specs


def test_defaults_are_the_published_numbers():
    spec = SceneSpec()
    assert spec.padding_m == pytest.approx((0.003 + 0.016 + 0.0025, 0.003 + 0.014 + 0.0025))
    assert spec.half_area_m == pytest.approx((0.0785 / 2, 0.0805 / 2))
    assert spec.class_names == ("1", "2", "3")
    assert spec.most_objects == 8
    assert {spec.star.radius_m, *(shape.radius_m for shape in spec.distractor_shapes)} == {0.010}


@given(specs())
def test_json_and_back(spec):
    values = json.loads(json.dumps(spec.to_dict()))
    assert values == spec.to_dict()
    assert SceneSpec.from_dict(values) == spec


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"cell_m": (0.03, 0.12)}, r"cell_m .* \(0.03, 0.12\); expected room for the padding and one object"),
        ({"cell_m": (0.12,)}, "cell_m .* expected 2 numbers"),
        ({"padding_m": (-0.1, 0.0)}, r"padding_m .* \(-0.1, 0.0\)"),
        ({"stars": ()}, "stars .* expected integers from 0"),
        ({"stars": (3, 1)}, "stars .* larger than the one before"),
        ({"stars": (0, 1)}, "stars .* 1 to 1000 objects in a scene"),
        ({"stars": (5_000,)}, "stars .* 1 to 1000 objects"),
        ({"distractors": (3, 1)}, r"distractors .* \(3, 1\); expected the minimum and the maximum"),
        ({"distractors": 5}, "distractors .* .5,."),
        ({"star": Shape("box")}, "star .* expected a Shape named 'star'"),
        ({"distractor_shapes": (Shape("star"),)}, "distractor_shapes .* that are not stars"),
        ({"distractor_shapes": ("box", "disc")}, "distractor_shapes .* expected Shape objects"),
        ({"star": "star"}, "star .* expected a Shape"),
        ({"distractor_shapes": ()}, "distractor_shapes .* expected Shape objects"),
        ({"heights_m": ()}, "heights_m .* one or more heights"),
        ({"heights_m": (0.005, 0.0)}, "heights_m .* 0.0"),
        ({"rotation_rad": 7.0}, "rotation_rad .* 7.0; expected a number from 0 to 6.28"),
        ({"collision": "boxes"}, "collision .* 'boxes'; expected one of circles, exact"),
        ({"clearance_m": -0.001}, "clearance_m .* -0.001"),
        ({"attempts": 0}, "attempts .* at least 1"),
        ({"restarts": -1}, "restarts .* -1"),
    ],
)
def test_invalid_values_are_named_with_the_expected_ones(values, message):
    with pytest.raises(InputError, match=message):
        SceneSpec(**values)


def test_scenes_without_distractors_need_no_shapes():
    assert SceneSpec(distractors=(0, 0), distractor_shapes=()).most_objects == 3


@pytest.mark.parametrize("values", [{"colour": 1}, {"star": {"nme": "star"}}, {"star": 3}])
def test_wrong_json_is_refused(values):
    with pytest.raises(InputError, match="scene specification"):
        SceneSpec.from_dict(values)


def test_lists_ranges_and_numbers_of_numpy_are_the_same_specification():
    given = SceneSpec(
        cell_m=np.array([0.12, 0.12]),
        stars=range(1, 4),
        distractors=[np.int64(0), np.int64(5)],
        distractor_shapes=[Shape("box", np.float64(0.01)), Shape("disc")],
        heights_m=[0.005],
        clearance_m=0,
        attempts=np.int32(100),
    )
    assert given == SceneSpec()
    assert hash(given) == hash(SceneSpec())
    assert json.dumps(given.to_dict()) == json.dumps(SceneSpec().to_dict())


TINY = (Shape("disc", 1e-4, Disc(segments=256)),)


def test_shapes_too_fine_for_stored_coordinates_are_refused_with_a_next_step():
    with pytest.raises(InputError) as caught:
        SceneSpec(cell_m=(2, 2), star=Shape("star", 1e-4), distractor_shapes=TINY)
    for part in ("cell_m", "(2.0, 2.0)", "disc(segments=256)", "radius_m 0.0001", "segments"):
        assert part in str(caught.value)


@pytest.mark.thorough
@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("side_m", [0.24, 0.16, 0.4])
def test_shapes_as_fine_as_the_cell_allows_are_sound(side_m, tmp_path):
    """Up to a cell whose coordinates reach a power of two, the thinnest triangles are thick enough."""
    spec = SceneSpec(cell_m=(side_m, side_m), star=Shape("star", 1e-4), distractor_shapes=TINY)
    path = tmp_path / "train-00000-of-00001.parquet"
    pq.write_table(SceneRow.table(make_rows(spec, "train", 0, 0, 3), scene_schema()), path)
    assert check_content(path).failed == 0
