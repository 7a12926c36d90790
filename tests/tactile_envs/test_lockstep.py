"""Native environments compared with the published ones, step by step: spaces, episodes and measures."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest
import trimesh

pytest.importorskip("ap_gym", reason="ap-gym (extra `envs`) is not installed")

from tactile_envs.config import RecordedConfig
from tactile_envs.entry_points import make_vector
from tactile_envs.env_specs import GRASP_ID, env_specs
from tests.published_envs import make, registrations
from tests.tactile_envs.lockstep import HALF_MICROMETRE, same_as_listed, same_spaces, same_step, walk

pytestmark = [pytest.mark.oracle, pytest.mark.sim, pytest.mark.filterwarnings("ignore")]

ENVS = 4
STEPS = 68  # four episodes of digits, two of other objects
CASES = (
    *("TactileMNIST-Depth-train-v0", "TactileMNIST-Depth-test-sparse-v0"),
    *("TactileMNISTSnap-Depth-train-v0", "TactileMNISTVolume-Depth-train-v0"),
    *("TactileMNISTCenterOfMass-Depth-train-v0", "Starstruck-Depth-train-v0"),
    *("Toolbox-Depth-v0", "Toolbox-small-Depth-sparse-v0"),
)
SPARSE = [
    f"{family}-Depth-sparse-v0"
    for family in dict.fromkeys(name.split("-Depth")[0] for name in env_specs() if "-Depth" in name)
    if "RealSnap" not in family
]
"""One id of each simulated family: splits differ only in objects, and sensors only in pictures."""
OTHERS = {
    *("dataset", "mesh_dataset"),
    *("sensor_backend", "sensor_device", "sensor_device_index", "convert_image_to_numpy"),
    *("depth_estimator_backend", "depth_estimator_type"),
    *("show_sensor_target_pos", "enable_rendering"),
}
"""Settings that we do not have, beside ``render...``: of data, of renderers, and of pictures."""


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("env_id", CASES)
def test_same_episodes(env_id, provider, assets, packages):
    """Labels and poses exactly, rewards to rounding, and depth to half a micrometre, in several episodes.

    A pixel in 100,000 beside an upright wall lies on the other side of its edge: the driver rounds corners to
    1/256 of a pixel. Digits have hardly any such walls.
    """
    published = make(env_id, provider=provider, num_envs=ENVS)
    native = make_vector(env_id, num_envs=ENVS, assets=assets, config={"depth_in_info": True})
    same_spaces(published, native)
    off, pixels = 0, 0

    def compare(theirs: Any, ours: Any) -> None:
        nonlocal off, pixels
        same_step(theirs, ours)
        far = np.abs(theirs[1]["sensor_img"] - ours[1]["sensor_img"]) > HALF_MICROMETRE
        off, pixels = off + int(far.sum()), pixels + far.size

    walk(published, native, STEPS, compare)
    published.close()
    is_digit = type(native.current_data_points[0]).__name__ == "DigitRecord"
    assert off <= (3e-6 if is_digit else 2e-5) * pixels


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("env_id", SPARSE)
def test_sparse_forms(env_id, provider, assets, packages, tmp_path):
    """Rewards, weights, keys of info and statistics of all `-sparse` ids, over several episodes."""
    folder, source = assets, provider
    if env_id.startswith(("ABC", "Minecraft")):
        for number, side_mm in enumerate((20, 30)):
            trimesh.creation.box([side_mm, 30, 6]).export(tmp_path / f"{number}.stl")
        folder, source = tmp_path, None
    own = None if source else folder
    config = {"step_limit": 3}
    published = make(env_id, provider=source, assets=own, num_envs=ENVS, config=config)
    native = make_vector(env_id, num_envs=ENVS, assets=folder, config={**config, "depth_in_info": True})
    same_spaces(published, native)
    same_as_listed(env_id, published)
    ends = []

    def compare(theirs: Any, ours: Any) -> None:
        same_step(theirs, ours)
        ends.append("stats" in ours[-1])

    walk(published, native, 9, compare)
    published.close()
    assert ends == [False, False, False, True, False, False, False, True, False, False]


def test_cycle_gan(provider, assets, packages):
    """The episodes and the pictures of the network are the same."""
    env_id = "TactileMNISTVolumeSnap-CycleGAN-v0"
    pytest.importorskip("torchvision", reason="torchvision (extra `torch`) is not installed")
    config = {"step_limit": 1}
    published = make(env_id, provider=provider, num_envs=1, config={**config, "sensor_backend": "torch"})
    native = make_vector(env_id, num_envs=1, assets=assets, config={**config, "depth_in_info": True})
    same_spaces(published, native)

    def compare(theirs: Any, ours: Any) -> None:
        same_step(theirs, ours)
        off = np.abs(theirs[1]["sensor_img"] - ours[1]["sensor_img"])
        assert np.median(off) < 1e-4
        assert (off > 1 / 255).mean() < 0.01

    walk(published, native, 2, compare)
    published.close()


def test_settings_are_those_of_the_registration(packages):
    """The ids are the published ones, with the same settings."""
    published = registrations()
    specs = {name: spec for name, spec in env_specs().items() if name != GRASP_ID}  # ours
    assert specs.keys() == published.keys()
    assert len(published) == 356
    for name, spec in specs.items():
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
    """Compare noise; for depth, that of the package concerns only its base depth, not images."""
    noise, base_depth = ours.pop("sensor_noise", None), ours.pop("real_base_depth_dataset", None)
    assert base_depth == getattr(theirs, "real_base_depth_dataset", None)
    if noise is not None:
        assert noise.to_dict() == {name: getattr(theirs, name) for name in noise.to_dict()}
    elif theirs is not None:
        assert not any(value for name, value in vars(theirs).items() if name.endswith("_std"))


def test_taxim_within_a_level(provider, assets, packages):
    """Within a level for 99 % of the pixels of a touch; other pixels as `tactile_sim.optics.taxim` states.

    On flat gel, the package selects colours by rounding noise, which differ by up to 26 levels; pixels
    beside upright walls may be further off.
    """
    env_id = "TactileMNIST-train-v0"
    published = make(env_id, provider=provider, num_envs=ENVS)
    native = make_vector(env_id, num_envs=ENVS, assets=assets)
    near, seen = 0, 0

    def compare(theirs: Any, ours: Any) -> None:
        nonlocal near, seen
        one, other = theirs[1]["sensor_img"], ours[1]["sensor_img"]
        off = 255 * np.abs(one - other).max(axis=3)
        assert (off <= 26).mean() > 0.999
        shows = 255 * np.abs(other - native.camera.bare_picture()).max(axis=3) > 1
        near, seen = near + int((off[shows] <= 1).sum()), seen + int(shows.sum())

    walk(published, native, 10, compare)
    published.close()
    assert seen > 5_000
    assert near >= 0.99 * seen
