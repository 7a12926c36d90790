from __future__ import annotations

import math
import pickle
import re
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import stats

from starstruck_gen.sampling import (
    SPLITS,
    SamplingExhausted,
    SceneSpec,
    SceneStreams,
    is_infeasible,
    require_feasible,
    sample_scene,
    sample_scenes,
    scene_id,
    scene_rng,
    scene_seed,
)
from starstruck_gen.scene import Placement, circles_clear, outlines_clear
from starstruck_gen.shapes import KINDS, Shape
from tactile_toolkit.errors import InputError
from tests.starstruck_gen.strategies import specs


@given(specs(), st.integers(0, 2**40), st.sampled_from(SPLITS), st.integers(0, 10**6))
def test_scenes_satisfy_their_specification(spec, seed, split, start):
    for index, scene in enumerate(sample_scenes(spec, split, seed, start, 3), start):
        stars = [placement.is_star for placement in scene.placements]
        assert scene.star_count == sum(stars) == spec.stars[index % len(spec.stars)]
        assert all(stars[: scene.star_count])
        assert spec.distractors[0] <= scene.distractor_count <= spec.distractors[1]
        known = {(shape.key, shape.radius_m) for shape in (spec.star, *spec.distractor_shapes)}
        half_x_m, half_y_m = spec.half_area_m
        for placement in scene.placements:
            assert (placement.shape, placement.radius_m) in known
            assert placement.height_m in spec.heights_m
            assert abs(placement.x_m) <= half_x_m
            assert abs(placement.y_m) <= half_y_m
            assert 0 <= placement.angle_rad <= spec.rotation_rad
        assert len(scene.attempts) == len(scene.placements)
        assert min(scene.attempts) >= 1
        if spec.collision == "circles":
            for a, b in combinations(scene.placements, 2):
                gap_m = math.hypot(a.x_m - b.x_m, a.y_m - b.y_m) - a.radius_m - b.radius_m
                assert gap_m > spec.clearance_m


@given(
    specs(),
    st.integers(0, 2**40),
    st.sampled_from(SPLITS),
    st.integers(0, 10**6),
    st.lists(st.integers(0, 3), min_size=1, max_size=3),
)
def test_any_partition_gives_the_scenes_of_the_reference(spec, seed, split, start, sizes):
    parts, first = [], start
    for size in sizes:
        parts += sample_scenes(spec, split, seed, first, size)
        first += size
    assert parts == sample_scenes(spec, split, seed, start, sum(sizes))
    for index, scene in enumerate(parts, start):
        rng = scene_rng(scene_seed(seed, split, index))
        assert scene == sample_scene(spec, rng, spec.stars[index % len(spec.stars)])


@given(st.lists(st.tuples(st.integers(0, 2**63 - 1), st.integers(0, 130)), min_size=1, max_size=5))
def test_shared_generator_gives_the_numbers_of_each_scene(wanted):
    streams = SceneStreams()
    for seed, count in wanted:
        uniform = streams.uniform(seed)
        reference = scene_rng(seed)
        assert [uniform() for _ in range(count)] == [reference.random() for _ in range(count)]


def test_seeds_and_ids_differ_over_seeds_splits_and_scenes():
    seeds = [scene_seed(s, split, i) for s in (0, 1, 2**40) for split in SPLITS for i in range(20_000)]
    assert len(set(seeds)) == len(seeds)
    assert min(seeds) >= 0
    assert max(seeds) < 2**63
    assert stats.kstest(np.array(seeds) / 2**63, "uniform").pvalue > 0.01
    ids = {scene_id(split, i) for split in SPLITS for i in range(1_000)}
    assert len(ids) == 2_000


def test_seeds_never_change():
    """Existing data sets depend on these."""
    assert scene_seed(0, "train", 0) == 1588843498829269705
    assert scene_seed(7, "test", 123_456) == 1128125805858447187


def test_given_generator_may_be_any_and_stars_are_drawn_when_not_given():
    rng = np.random.default_rng(5)
    counts = [sample_scene(SceneSpec(), rng).star_count for _ in range(600)]
    assert stats.chisquare(np.bincount(counts, minlength=4)[1:]).pvalue > 0.01


def test_star_count_outside_the_specification_is_refused():
    with pytest.raises(InputError, match="star_count is 4; expected one of stars"):
        sample_scene(SceneSpec(), np.random.default_rng(0), star_count=4)


@pytest.mark.parametrize(("seed", "split"), [(-1, "train"), (10**45, "train"), (0, "validation")])
def test_unusable_seed_or_split_is_refused(seed, split):
    with pytest.raises(InputError, match=r"seed is (-1|10{45}); expected an int|unknown split 'validation'"):
        sample_scenes(SceneSpec(), split, seed, 0, 1)


@pytest.mark.thorough
def test_numbers_are_uniform():
    """Kolmogorov-Smirnov at 1 %, fixed seed: the first object of a scene meets no obstacle."""
    scenes = sample_scenes(SceneSpec(), "train", 11, 0, 4_000)
    first = [scene.placements[0] for scene in scenes]
    half_x_m, half_y_m = SceneSpec().half_area_m
    for values, half in (([p.x_m for p in first], half_x_m), ([p.y_m for p in first], half_y_m)):
        assert stats.kstest(values, stats.uniform(-half, 2 * half).cdf).pvalue > 0.01
    angles = [p.angle_rad for scene in scenes for p in scene.placements]
    assert stats.kstest(angles, stats.uniform(0, math.tau).cdf).pvalue > 0.01
    counts = np.bincount([scene.distractor_count for scene in scenes])
    assert stats.chisquare(counts).pvalue > 0.01
    discs = [p.shape == "disc" for scene in scenes for p in scene.placements if not p.is_star]
    assert stats.binomtest(sum(discs), len(discs)).pvalue > 0.01


def test_exact_rule_lets_objects_stand_closer_than_circles_do():
    shapes = tuple(Shape(name) for name in KINDS if name != "star")
    exact = SceneSpec(collision="exact", distractors=(5, 5), distractor_shapes=shapes)
    scenes = sample_scenes(exact, "train", 0, 0, 40)
    gaps = [
        math.hypot(a.x_m - b.x_m, a.y_m - b.y_m)
        for scene in scenes
        for a, b in combinations(scene.placements, 2)
    ]
    assert min(gaps) < 0.019


@pytest.mark.parametrize(
    ("one", "other", "clearance_m", "clear"),
    [
        # two boxes side by side: outlines 0.1 mm apart, circles overlap widely
        (("box", 0.0, math.pi / 4), ("box", 0.02 / math.sqrt(2) + 1e-4, math.pi / 4), 0.0, None),
        (("box", 0.0, 0.0), ("box", 0.02 / math.sqrt(2) + 1e-4, 0.0), 0.0, True),
        (("box", 0.0, 0.0), ("box", 0.02 / math.sqrt(2) + 1e-4, 0.0), 2e-4, False),
        (("box", 0.0, 0.0), ("box", 0.02 / math.sqrt(2) - 1e-4, 0.0), 0.0, False),
        (("box", 0.0, 0.0), ("box", 0.02 / math.sqrt(2), 0.0), 0.0, False),  # touching
        (("disc", 0.0, 0.0), ("disc", 0.0199, 0.0), 0.0, None),
    ],
)
def test_exact_rule_on_known_pairs(one, other, clearance_m, clear):
    a, b = (Placement(name, x, 0.0, angle, 0.01, 0.005) for name, x, angle in (one, other))
    found = outlines_clear(a, [b], clearance_m)
    assert found == outlines_clear(b, [a], clearance_m)
    # Both outlines are their own mirror images in the diagonal.
    mirrored = [each._replace(x_m=0.0, y_m=each.x_m) for each in (a, b)]
    assert found == outlines_clear(mirrored[0], mirrored[1:], clearance_m)
    assert not circles_clear(a, [b], clearance_m)
    # One object that is too near is enough, at any place in the list.
    far = Placement("disc", 1.0, 1.0, 0.0, 0.01, 0.005)
    for others in ([far, b], [b, far]):
        assert outlines_clear(a, others, clearance_m) == found
        assert not circles_clear(a, others, clearance_m)
    if clear is not None:
        assert found is clear


def test_object_inside_a_hole_is_clear_and_inside_a_solid_is_not():
    small = Placement("disc", 0.0, 0.0, 0.0, 0.002, 0.005)
    ring, disc = (Placement(shape, 0.0, 0.0, 0.0, 0.01, 0.005) for shape in ("ring", "disc"))
    assert outlines_clear(small, [ring], 0.001)
    assert not outlines_clear(small, [disc], 0.0)
    assert not outlines_clear(disc, [small], 0.0)


def test_impossible_specification_ends_with_the_reason_and_a_next_step():
    spec = replace(SceneSpec(), stars=(30,), restarts=3, attempts=20)
    with pytest.raises(SamplingExhausted) as caught:
        sample_scenes(spec, "train", 0, 0, 1)
    text = str(caught.value)
    assert isinstance(caught.value, InputError)
    found = re.search(
        r"object (\d+) of (\d+) \(a star\): 20 attempts .* 3 times .* ([\d.]+) x ([\d.]+) mm", text
    )
    assert found is not None
    assert 8 < int(found[1]) < 20
    assert 30 <= int(found[2]) <= 35
    free_m = np.subtract(spec.cell_m, spec.padding_m) - 2 * spec.star.radius_m
    assert [float(found[3]), float(found[4])] == pytest.approx((1e3 * free_m).tolist())
    assert "--cell-mm" in text
    assert str(pickle.loads(pickle.dumps(caught.value))) == text


def test_the_object_that_found_no_place_is_the_one_that_is_named():
    """One star leaves no room for a disc that fills the cell; of many stars, a later one finds no place."""
    spec = SceneSpec(stars=(1,), distractors=(1, 1), distractor_shapes=(Shape("disc", 0.03),), restarts=2)
    spec = replace(spec, cell_m=(0.08, 0.08), padding_m=(0, 0), attempts=9)
    with pytest.raises(SamplingExhausted, match=r"object 2 of 2 \(a disc\)"):
        sample_scenes(spec, "train", 0, 0, 50)


def test_starting_over_is_counted():
    crowded = replace(SceneSpec(), stars=(9,), distractors=(0, 0), attempts=15)
    scenes = sample_scenes(crowded, "train", 0, 0, 60)
    again = [scene for scene in scenes if scene.restarts]
    assert again
    assert all(sum(scene.attempts) >= 9 + 15 * scene.restarts for scene in again)
    assert all(scene.attempts[0] == 1 + scene.restarts for scene in scenes)


def test_hopeless_specifications_end_early_with_a_verdict():
    failures = []
    spec = SceneSpec(distractors=(0, 18))
    with pytest.raises(SamplingExhausted, match=r"of 21 .* no layout held nearly as many objects") as caught:
        require_feasible(spec, 0, lambda *told: failures.append(told))
    assert failures == [(number, spec.restarts + 1) for number in range(1, len(failures) + 1)]
    assert 10 <= len(failures) < 100
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
    assert is_infeasible(reached, objects) is verdict
