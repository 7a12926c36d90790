from __future__ import annotations

import math
from dataclasses import replace

import pytest

from starstruck_gen.sampling import (
    SamplingExhausted,
    is_hopeless,
    most_objects_that_fit,
    require_feasible,
    sample_scene,
    sample_scenes,
)
from starstruck_gen.shapes import Disc, Shape
from starstruck_gen.spec import SceneSpec
from starstruck_gen.streams import scene_rng


def test_bound_is_not_below_the_densest_packing():
    """Rows of touching circles, each row in the gaps of the one before: k by 7 centres in their own area."""
    radius_m = 0.005
    for rows in (1, 2, 5, 9):
        columns = 7
        area_m = ((2 * columns - 1) * radius_m, (rows - 1) * math.sqrt(3) * radius_m)
        spec = SceneSpec(
            cell_m=(area_m[0] + (2 + 1e-6) * radius_m, area_m[1] + (2 + 1e-6) * radius_m),
            padding_m=(0, 0),
            stars=(1,),
            distractors=(0, 0),
            distractor_shapes=(),
            star=Shape("star", radius_m),
        )
        assert most_objects_that_fit(spec) >= columns * rows


def test_scene_that_was_made_is_within_the_bound():
    for collision in ("circles", "exact"):
        spec = SceneSpec(stars=(10,), distractors=(0, 0), collision=collision)
        assert len(sample_scene(spec, scene_rng(1)).placements) <= most_objects_that_fit(spec)


@pytest.mark.parametrize(
    ("values", "most"),
    [
        ({"distractors": (0, 30)}, 27),
        ({"distractors": (0, 200), "collision": "exact"}, 67),
        ({"stars": (2,), "distractors": (0, 3), "clearance_m": 0.2}, 1),
    ],
)
def test_more_objects_than_have_room_anywhere_are_refused_without_a_trial(values, most):
    failures = []
    with pytest.raises(SamplingExhausted, match=f"room for at most {most} of that size") as caught:
        require_feasible(SceneSpec(**values), 0, lambda failed, _: failures.append(failed))
    assert (failures, caught.value.most, caught.value.number) == ([], most, most + 1)
    assert "attempts or restarts" not in str(caught.value)


def test_layouts_that_never_come_near_are_few_and_told():
    failures = []
    spec = SceneSpec(distractors=(0, 18))
    with pytest.raises(SamplingExhausted, match="no layout came near") as caught:
        require_feasible(spec, 0, lambda *told: failures.append(told))
    assert failures == [(number, spec.restarts + 1) for number in range(1, len(failures) + 1)]
    assert 10 <= len(failures) < 100
    assert caught.value.objects == 21
    assert "raise attempts" not in str(caught.value)


def test_numbers_that_would_help_are_named_where_little_was_missing():
    nearly = SceneSpec(stars=(8,), distractors=(0, 0), attempts=2, restarts=2)
    with pytest.raises(SamplingExhausted, match="raise attempts or restarts of SceneSpec") as caught:
        sample_scenes(nearly, "train", 0, 0, 50)
    assert "--cell-mm (cell_m)" in str(caught.value)


@pytest.mark.parametrize(
    ("reached", "objects", "verdict"),
    [([5] * 9, 40, False), ([5] * 10, 14, True), ([5] * 10, 13, False), ([3, 7] * 5, 21, False)],
)
def test_verdict_follows_from_the_spread_of_the_layouts(reached, objects, verdict):
    assert is_hopeless(reached, objects) is verdict


def test_crowded_scene_that_can_be_made_is_still_made():
    crowded = SceneSpec(stars=(9,), distractors=(0, 0), attempts=6)
    scenes = [sample_scene(crowded, scene_rng(seed)) for seed in range(40)]
    assert max(scene.restarts for scene in scenes) > 10


def test_smallest_shape_decides_the_bound():
    small = Shape("disc", 0.001, Disc(8))
    spec = SceneSpec(distractors=(0, 30), distractor_shapes=(Shape("box"), small))
    assert most_objects_that_fit(spec) > most_objects_that_fit(
        replace(spec, distractor_shapes=(Shape("box"),))
    )
