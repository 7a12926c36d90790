"""Samples of streams at other times, compared with brute force, NumPy and SciPy."""

from __future__ import annotations

import numpy as np
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation, Slerp

from realtouch.importing.streams import TIME_TOLERANCE_S, Neighbours

# Times on a grid are often equal; others hardly ever.
TIMES = st.lists(st.integers(0, 400).map(lambda number: number / 64), min_size=1, max_size=30)


@given(TIMES, st.sets(st.integers(20, 380), min_size=1), st.floats(0.001, 3))
def test_the_nearest_sample_is_the_nearest_of_all(times: list[float], numbers: set[int], gap: float) -> None:
    time_s, sample_s = np.array(times), np.array(sorted(numbers)) / 64
    found = Neighbours.of(time_s, sample_s, gap)
    distances = np.abs(time_s[:, None] - sample_s)
    np.testing.assert_array_equal(sample_s[found.nearest], sample_s[distances.argmin(axis=1)])
    twice = Neighbours.of(time_s, np.repeat(sample_s, 2), gap)  # of duplicates, the first
    np.testing.assert_array_equal(twice.nearest, 2 * found.nearest)
    np.testing.assert_array_equal([twice.share, twice.missing], [found.share, found.missing])
    for number, time in enumerate(times):
        before, after = sample_s[sample_s <= time], sample_s[sample_s >= time]
        if len(before) and len(after):
            is_missing = after[0] - before[-1] > gap + TIME_TOLERANCE_S
        else:
            is_missing = distances[number].min() > gap + TIME_TOLERANCE_S
        assert found.missing[number] == is_missing


@given(TIMES, st.dictionaries(st.integers(20, 380), st.floats(-1e6, 1e6), min_size=1))
def test_values_between_samples_are_those_of_numpy(times: list[float], values: dict[int, float]) -> None:
    sample_s = np.array(sorted(values)) / 64
    samples = np.array([values[number] for number in sorted(values)])
    found = Neighbours.of(np.array(times), sample_s, 10)
    expected = np.interp(times, sample_s, samples)
    np.testing.assert_allclose(found.interpolated(samples), expected, rtol=1e-12, atol=1e-9)
    vectors = np.stack([samples, -samples], axis=1)
    np.testing.assert_allclose(found.interpolated(vectors)[:, 1], -expected, rtol=1e-12, atol=1e-9)


@given(st.integers(0, 1 << 32), st.floats(1e-9, np.pi), st.booleans())
def test_turns_between_samples_are_those_of_scipy(seed: int, angle: float, is_negative: bool) -> None:
    random = np.random.default_rng(seed)
    turns = random.normal(size=(9, 3))
    turns *= min(angle, 3.1) / np.linalg.norm(turns, axis=1, keepdims=True)
    rotations = Rotation.random(1, rng=random)
    for turn in turns[1:]:
        rotations = Rotation.concatenate([rotations, rotations[-1] * Rotation.from_rotvec(turn)])
    sample_s = np.cumsum(random.uniform(0.01, 1, 9))
    time_s = np.sort(random.uniform(sample_s[0], sample_s[-1], 50))
    quaternions = rotations.as_quat()
    quaternions[1::2] *= 1 - 2 * is_negative  # both signs are the same rotation
    for order in ([0, 1, 2, 3], [3, 0, 1, 2]):
        found = Neighbours.of(time_s, sample_s, 10).turned(quaternions[:, order])
        rest = Rotation.from_quat(found[:, np.argsort(order)]) * Slerp(sample_s, rotations)(time_s).inv()
        assert rest.magnitude().max() < 1e-11
        np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, rtol=0, atol=1e-14)


def test_a_missing_sample_affects_only_its_neighbours() -> None:
    samples = np.array([0.0, 1.0, np.nan, 3.0, np.inf])
    found = Neighbours.of(np.array([-0.5, 0.5, 1.0, 1.5, 2.5, 3.0, 4.5]), np.arange(5.0), 1)
    expected = [0, 0.5, 1, np.nan, np.nan, 3, np.inf]
    np.testing.assert_array_equal(found.interpolated(samples), expected)
    assert not found.missing.any()


def test_a_quaternion_of_another_length_stays_one() -> None:
    """The check of poses must still find the error."""
    quaternions = np.array([[0, 0, 0, 1.0], [0, 0, 0, 2.0], [0, 0, 0, 0.0]])
    found = Neighbours.of(np.array([0, 0.5, 1, 1.5, 2]), np.arange(3.0), 1).turned(quaternions)
    np.testing.assert_array_equal(found[:3, 3], [1, 1.5, 2])
    assert np.isnan(found[3:]).all()
