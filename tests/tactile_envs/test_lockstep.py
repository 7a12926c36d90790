"""Native environments beside the published ones, step by step: the same spaces, episodes and measures."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest
import trimesh

pytest.importorskip("ap_gym", reason="ap-gym (extra `envs`) is not installed")

import tactile_envs
from tactile_envs.config import RecordedConfig
from tactile_envs.entry_points import make_vector
from tactile_envs.env_specs import env_specs
from tests.published_envs import make, registrations

pytestmark = [pytest.mark.oracle, pytest.mark.sim, pytest.mark.filterwarnings("ignore")]

ENVS = 4
SPACES = (
    "single_action_space",
    "action_space",
    "single_observation_space",
    "observation_space",
    "single_prediction_target_space",
    "prediction_target_space",
)
CASES = (
    "TactileMNIST-Depth-train-v0",
    "TactileMNIST-Depth-test-sparse-v0",
    "TactileMNISTSnap-Depth-train-v0",
    "TactileMNISTVolume-Depth-train-v0",
    "TactileMNISTCenterOfMass-Depth-train-v0",
    "Starstruck-Depth-train-v0",
    "Toolbox-Depth-v0",
    "Toolbox-small-Depth-sparse-v0",
)
SPARSE = [
    f"{family}-Depth-sparse-v0"
    for family in dict.fromkeys(name.split("-Depth")[0] for name in env_specs() if "-Depth" in name)
    if "RealSnap" not in family
]
"""One of each simulated family: the splits differ in their objects, and sensors in pictures."""
OTHERS = {
    *("dataset", "mesh_dataset"),
    *("sensor_backend", "sensor_device", "sensor_device_index", "convert_image_to_numpy"),
    *("depth_estimator_backend", "depth_estimator_type"),
    *("show_sensor_target_pos", "enable_rendering"),
}
"""Settings that we do not have, beside ``render...``: of data, of what computes an image, and of pictures."""
HALF_MICROMETRE = 0.5e-6 / 2.125e-3


@pytest.fixture(params=CASES)
def pair(request, provider, assets, packages):
    """The published environment and ours."""
    published = make(request.param, provider=provider, num_envs=ENVS)
    native = make_vector(request.param, num_envs=ENVS, assets=assets, config={"depth_in_info": True})
    yield published, native
    published.close()
    native.close()


def _walk(pair: Any, steps: int, compare: Any) -> None:
    """Take the same random steps in both, and compare each."""
    published, native = pair
    theirs, ours = ((env, *env.reset(seed=3)) for env in pair)
    compare(theirs, ours)
    native.action_space.seed(5)
    for _ in range(steps):
        action = native.action_space.sample()
        theirs, ours = ((env, *env.step(action)) for env in (published, native))
        compare(theirs, ours)


@pytest.mark.one_at_a_desk
def test_same_episodes(pair):
    """Labels and poses exactly, rewards to rounding, and depth to half a micrometre, in ten episodes.

    A pixel in 100,000 beside an upright wall lies on the other side of its edge: the driver rounds corners to
    1/256 of a pixel. Digits have hardly any such walls.
    """
    published, native = pair
    _same_spaces(published, native)
    off, pixels = 0, 0

    def compare(theirs: Any, ours: Any) -> None:
        nonlocal off, pixels
        _same_step(theirs, ours)
        far = np.abs(theirs[1]["sensor_img"] - ours[1]["sensor_img"]) > HALF_MICROMETRE
        off, pixels = off + int(far.sum()), pixels + far.size

    _walk(pair, 160, compare)
    is_digit = type(native.current_data_points[0]).__name__ == "DigitRecord"
    assert off <= (3e-6 if is_digit else 2e-5) * pixels


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("env_id", SPARSE)
def test_sparse_forms(env_id, provider, assets, packages, tmp_path):
    """Rewards, weights, keys of info and statistics of every form with `-sparse`, over several episodes."""
    folder, source = assets, provider
    if env_id.startswith(("ABC", "Minecraft")):
        for number, side_mm in enumerate((20, 30)):
            trimesh.creation.box([side_mm, 30, 6]).export(tmp_path / f"{number}.stl")
        folder, source = tmp_path, None
    own = None if source else folder
    config = {"step_limit": 3}
    published = make(env_id, provider=source, assets=own, num_envs=ENVS, config=config)
    native = make_vector(env_id, num_envs=ENVS, assets=folder, config={**config, "depth_in_info": True})
    _same_spaces(published, native)
    ends = []

    def compare(theirs: Any, ours: Any) -> None:
        _same_step(theirs, ours)
        ends.append("stats" in ours[-1])

    _walk((published, native), 9, compare)
    published.close()
    assert ends == [False, False, False, True, False, False, False, True, False, False]


def test_cycle_gan(provider, assets, packages):
    """The same episodes, and pictures of the same network."""
    env_id = "TactileMNISTVolumeSnap-CycleGAN-v0"
    pytest.importorskip("torchvision", reason="torchvision (extra `torch`) is not installed")
    config = {"step_limit": 2}
    published = make(env_id, provider=provider, num_envs=2, config={**config, "sensor_backend": "torch"})
    native = make_vector(env_id, num_envs=2, assets=assets, config={**config, "depth_in_info": True})
    _same_spaces(published, native)

    def compare(theirs: Any, ours: Any) -> None:
        _same_step(theirs, ours)
        off = np.abs(theirs[1]["sensor_img"] - ours[1]["sensor_img"])
        assert np.median(off) < 1e-4
        assert (off > 1 / 255).mean() < 0.01

    _walk((published, native), 3, compare)
    published.close()


def _same_spaces(published: Any, native: Any) -> None:
    for name in SPACES:
        assert getattr(published, name) == getattr(native, name), name
        assert type(getattr(published, name)) is type(getattr(native, name)), name


def _same_step(theirs: Any, ours: Any) -> None:
    """Compare all that a reset or a step gives, but for the picture."""
    (there, seen, *outcome), (here, found, *result) = theirs, ours
    assert seen.keys() == found.keys()
    assert all(found[name].dtype == seen[name].dtype or name == "sensor_img" for name in seen)
    # The published environment leaves its space where a tilted sensor slides out of its limits.
    assert np.abs(np.clip(seen["sensor_pos"], -1, 1) - found["sensor_pos"]).max() < 5e-5
    assert (seen["time_step"] == found["time_step"]).all()
    within_m = 0.5e-6 if "sensor_rot" in found else 1e-12
    _same_state(there.unwrapped, here, within_m)
    _same_info(outcome[-1], result[-1], within_m)
    if len(outcome) > 1:
        np.testing.assert_allclose(result[0], outcome[0], rtol=1e-5, atol=1e-6)
        assert (outcome[1] == result[1]).all()
        assert (outcome[2] == result[2]).all()


def _same_state(there: Any, here: Any, within_m: float) -> None:
    assert (there.current_data_point_indices == here.current_data_point_indices).all()
    for name in ("current_object_poses_platform_frame",):
        off = np.abs(getattr(there, name).matrix - getattr(here, name).matrix)
        assert off.max() < 1e-12, name
    theirs, ours = (env.current_sensor_target_poses_platform_frame.matrix for env in (there, here))
    assert np.abs(theirs - ours)[:, :2].max() < within_m
    for one, other in zip(there.sensor_pos_limits, here.sensor_pos_limits, strict=True):
        assert (one == other).all()


def _same_info(theirs: dict[str, Any], ours: dict[str, Any], within_m: float) -> None:
    assert theirs.keys() == ours.keys()
    one, other = theirs["sensor_pose"].matrix, ours["sensor_pose"]
    assert np.abs(one - other)[:, :2].max() < within_m
    assert np.abs(one - other).max() < 0.5e-6
    reached = theirs["depth"] < 4.25e-3
    off = np.abs(theirs["depth"] - ours["depth"])[reached] > 0.5e-6
    assert off.sum() <= 1e-3 * off.size
    if "prediction" not in theirs:
        return
    np.testing.assert_array_equal(theirs["base_reward"], ours["base_reward"])
    targets = [info["prediction"]["target"] for info in (theirs, ours)]
    if isinstance(targets[0], dict):
        assert (targets[0]["weight"] == targets[1]["weight"]).all()
        targets = [target["target"] for target in targets]
    np.testing.assert_allclose(targets[1], targets[0], atol=3e-7, rtol=1e-6)
    losses = [info["prediction"]["loss"] for info in (theirs, ours)]
    np.testing.assert_allclose(losses[1], losses[0], rtol=1e-5, atol=1e-6)
    if "stats" in theirs:
        _same_stats(theirs["stats"], ours["stats"])


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
        for one, other in zip(values, ours["vector"][name], strict=True):
            taken, rest = np.split(np.ravel(other), [np.size(one)])
            np.testing.assert_allclose(taken, np.ravel(one), rtol=1e-4, atol=1e-6)
            assert np.isnan(rest).all()  # of an episode that is shorter, or goes on


def test_same_reward_by_the_loss_function(pair):
    """`loss_fn`, which training code differentiates, gives the loss of the steps."""
    _, env = pair
    env.reset(seed=0)
    for _ in range(3):
        action = env.action_space.sample()
        *_, info = env.step(action)
        target = info["prediction"]["target"]
        target = target["target"] if isinstance(target, dict) else target
        given = env._task.loss_fn(action["prediction"], target, (ENVS,))
        np.testing.assert_allclose(info["prediction"]["loss"], given, rtol=1e-5, atol=1e-6)


def test_settings_are_those_of_the_registration(packages):
    """Every published id is here, with the same settings, and no other."""
    published = registrations()
    assert env_specs().keys() == published.keys()
    assert len(published) == 356
    for name, spec in env_specs().items():
        kind = packages.TactilePerceptionConfig
        if isinstance(spec.config, RecordedConfig):
            kind = packages.TactileRealSnapConfig
        theirs = {field.name: field.default for field in fields(kind)}
        theirs |= published[name].kwargs["default_config"]
        ours = {field.name: getattr(spec.config, field.name) for field in fields(spec.config)}
        _same_noise(theirs.pop("sensor_noise", None), ours)
        for setting in ours.keys() & theirs.keys():
            np.testing.assert_array_equal(ours[setting], theirs[setting], f"{name} {setting}")
        rest = theirs.keys() - ours.keys()
        assert all(setting in OTHERS or setting.startswith("render") for setting in rest), rest


def _same_noise(theirs: Any, ours: dict[str, Any]) -> None:
    """Compare noise; for depth the package gives one without an effect on images, for its base depth."""
    noise, base_depth = ours.pop("sensor_noise", None), ours.pop("real_base_depth_dataset", None)
    assert base_depth == getattr(theirs, "real_base_depth_dataset", None)
    if noise is not None:
        assert noise.to_dict() == {name: getattr(theirs, name) for name in noise.to_dict()}
    elif theirs is not None:
        assert not any(value for name, value in vars(theirs).items() if name.endswith("_std"))


def test_every_id_says_what_its_environment_is(packages, provider, assets, tmp_path):
    """One of each family and sensor, beside the spaces of the published environment."""
    for number, side_mm in enumerate((20, 30)):
        trimesh.creation.box([side_mm, 30, 6]).export(tmp_path / f"{number}.stl")
    for each in tactile_envs.ids("sparse", "Depth"):
        if each.split == "test" or "RealSnap" in each.id or "-train" in each.id:
            continue
        own = tmp_path if each.assets in ("abc", "minecraft") else None
        env = make(each.id, provider=provider, assets=own, num_envs=1)
        seen, action = env.single_observation_space, env.single_action_space["action"]
        assert each.observation == {name: space.shape for name, space in seen.items()}, each
        assert each.action == {name: space.shape for name, space in action.items()}, each
        assert env.unwrapped.config.step_limit == each.episode_length
        env.close()


@pytest.mark.parametrize("env_id", ["TactileMNIST-train-v0", "Starstruck-train-v0"])
def test_taxim_within_a_level(env_id, provider, assets, packages):
    """Where a touch shows, within a level at 99 %; else as `tactile_sim.optics` states.

    Where the gel is flat, the package looks colours up by rounding noise, 26 levels apart at most; pixels
    beside upright walls may be further off.
    """
    published = make(env_id, provider=provider, num_envs=ENVS)
    native = make_vector(env_id, num_envs=ENVS, assets=assets)
    near, seen = 0, 0

    def compare(theirs: Any, ours: Any) -> None:
        nonlocal near, seen
        one, other = theirs[1]["sensor_img"], ours[1]["sensor_img"]
        off = 255 * np.abs(one - other).max(axis=3)
        assert (off <= 26).mean() > 0.999
        shows = 255 * np.abs(other - native._scene._camera._bare_picture(0)).max(axis=3) > 1
        near, seen = near + int((off[shows] <= 1).sum()), seen + int(shows.sum())

    _walk((published, native), 20, compare)
    published.close()
    assert seen > 10_000
    assert near >= 0.99 * seen
