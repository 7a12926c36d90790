"""Compares published environments with ours for the same actions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import tactile_envs

SPACES = [
    f"{which}{name}_space"
    for name in ("action", "observation", "prediction_target")
    for which in ("single_", "")
]
HALF_MICROMETRE = 0.5e-6 / 2.125e-3
"""Tolerance of depth, in units of an image."""


def walk(published: Any, native: Any, steps: int, compare: Callable[[Any, Any], None]) -> None:
    """Take the same random steps in both, and compare each."""
    pair = (published, native)
    compare(*((env, *env.reset(seed=3)) for env in pair))
    native.action_space.seed(5)
    for _ in range(steps):
        action = native.action_space.sample()
        compare(*((env, *env.step(action)) for env in pair))


def same_spaces(published: Any, native: Any) -> None:
    """Compare spaces."""
    for name in SPACES:
        assert getattr(published, name) == getattr(native, name), name
        assert type(getattr(published, name)) is type(getattr(native, name)), name


def same_as_listed(env_id: str, published: Any) -> None:
    """Compare spaces with those in the list of ids."""
    (listed,) = (env for env in tactile_envs.ids() if env.id == env_id)
    observation, action = published.single_observation_space, published.single_action_space["action"]
    assert listed.observation == {name: space.shape for name, space in observation.items()}, listed
    assert listed.action == {name: space.shape for name, space in action.items()}, listed


def same_step(theirs: Any, ours: Any) -> None:
    """Compare all results of a reset or a step, except the picture."""
    (their_env, expected, *their_outcome), (our_env, observation, *our_outcome) = theirs, ours
    assert expected.keys() == observation.keys()
    assert all(observation[name].dtype == expected[name].dtype or name == "sensor_img" for name in expected)
    # The published environment leaves its space if a tilted sensor slides out of its limits.
    assert np.abs(np.clip(expected["sensor_pos"], -1, 1) - observation["sensor_pos"]).max() < 5e-5
    assert (expected["time_step"] == observation["time_step"]).all()
    within_m = 0.5e-6 if "sensor_rot" in observation else 1e-12
    _same_state(their_env.unwrapped, our_env, within_m)
    _same_sensor(their_outcome[-1], our_outcome[-1], within_m)
    same_outcome(their_outcome, our_outcome)


def same_outcome(theirs: Any, ours: Any) -> None:
    """Compare rewards, ends and scores of a step; a reset has none of them."""
    assert theirs[-1].keys() == ours[-1].keys()
    if len(theirs) == 1:
        return
    np.testing.assert_allclose(ours[0], theirs[0], rtol=1e-5, atol=1e-6)
    assert (theirs[1] == ours[1]).all()
    assert (theirs[2] == ours[2]).all()
    their_info, our_info = theirs[-1], ours[-1]
    np.testing.assert_array_equal(our_info["base_reward"], their_info["base_reward"])
    targets = [info["prediction"]["target"] for info in (their_info, our_info)]
    if isinstance(targets[0], dict):
        assert (targets[0]["weight"] == targets[1]["weight"]).all()
        targets = [target["target"] for target in targets]
    np.testing.assert_allclose(targets[1], targets[0], atol=3e-7, rtol=1e-6)
    losses = [info["prediction"]["loss"] for info in (their_info, our_info)]
    np.testing.assert_allclose(losses[1], losses[0], rtol=1e-5, atol=1e-6)
    if "stats" in their_info:
        _same_stats(their_info["stats"], our_info["stats"])


def _same_state(their_env: Any, our_env: Any, within_m: float) -> None:
    envs = (their_env, our_env)
    assert (their_env.current_data_point_indices == our_env.current_data_point_indices).all()
    object_poses = [env.current_object_poses_platform_frame.matrix for env in envs]
    assert np.abs(object_poses[0] - object_poses[1]).max() < 1e-12
    theirs, ours = (env.current_sensor_target_poses_platform_frame.matrix for env in envs)
    assert np.abs(theirs - ours)[:, :2].max() < within_m
    for their_limit, our_limit in zip(their_env.sensor_pos_limits, our_env.sensor_pos_limits, strict=True):
        assert (their_limit == our_limit).all()


def _same_sensor(theirs: dict[str, Any], ours: dict[str, Any], within_m: float) -> None:
    difference = np.abs(theirs["sensor_pose"].matrix - ours["sensor_pose"])
    assert difference[:, :2].max() < within_m
    assert difference.max() < 0.5e-6
    reached = theirs["depth"] < 4.25e-3
    off = np.abs(theirs["depth"] - ours["depth"])[reached] > 0.5e-6
    assert off.sum() <= 1e-3 * off.size


def _same_stats(theirs: dict[str, Any], ours: dict[str, Any]) -> None:
    assert theirs.keys() == ours.keys()
    for name in ("_scalar", "_vector"):
        assert (theirs[name] == ours[name]).all()
    assert theirs["scalar"].keys() == ours["scalar"].keys()
    for name, values in theirs["scalar"].items():
        # The package gives metrics of volumes as columns.
        np.testing.assert_allclose(ours["scalar"][name], np.ravel(values), rtol=1e-4, atol=1e-6)
    assert theirs["vector"].keys() == ours["vector"].keys()
    for name, values in theirs["vector"].items():
        for expected, padded in zip(values, ours["vector"][name], strict=True):
            metrics, padding = np.split(np.ravel(padded), [np.size(expected)])
            np.testing.assert_allclose(metrics, np.ravel(expected), rtol=1e-4, atol=1e-6)
            assert np.isnan(padding).all()  # of an episode that is shorter, or continues
