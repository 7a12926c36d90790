"""The published environments on our assets: they run, and what is felt in them is what the records hold."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import env_assets
import realtouch
from tactile_toolkit.errors import InputError
from tests.env_assets.published.rollouts import (
    CONTACT_HEIGHT_M,
    PRESS_DEPTH_M,
    Rollout,
    Step,
    expected_depth_m,
    roll,
)

pytestmark = [pytest.mark.env, pytest.mark.filterwarnings("ignore")]

STEPS = 50
ENVS = 4
SEED = 0

# Id, data set, steps of an episode, least share of touches that hit the object.
SIMULATED = [
    ("TactileMNIST-Depth-train-v0", "mnist3d", 16, 0.3),
    ("TactileMNISTVolume-Depth-train-v0", "mnist3d", 16, 0.3),
    ("TactileMNISTCenterOfMass-Depth-train-v0", "mnist3d", 16, 0.3),
    ("Starstruck-Depth-train-v0", "starstruck", 32, 0.3),
    ("Toolbox-Depth-v0", "wrench", 32, 0.03),
]
IDS = [case[0].split("-")[0] for case in SIMULATED]


@pytest.fixture(scope="module")
def provider(assets: Path) -> Any:
    return env_assets.AssetProvider(assets)


@pytest.fixture(scope="module")
def own_statistics(packages: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A folder for the statistics that the package else keeps in the user's home."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(packages.util, "CACHE_BASE_DIR", tmp_path_factory.mktemp("statistics"))
        yield


@pytest.fixture(scope="module", params=SIMULATED, ids=IDS)
def case(request: pytest.FixtureRequest) -> tuple[str, str, int, float]:
    return request.param


@pytest.fixture(scope="module")
def rollout(case: Any, provider: Any, own_statistics: Any) -> Rollout:
    """Fifty random steps of four environments, as registered."""
    return played(case[0], provider)


def played(env_id: str, provider: Any, steps: int = STEPS) -> Rollout:
    env = env_assets.make(env_id, provider=provider, num_envs=ENVS)
    try:
        rollout = roll(env, steps, SEED)
        for observation in rollout.observations:
            assert env.observation_space.contains(observation)
        return rollout
    finally:
        env.close()


def running(step: Step) -> list[int]:
    """Environments whose episode continued in a step; the pose of the object is known for these."""
    return np.flatnonzero(~step.was_done).tolist()


def test_fifty_steps(rollout):
    assert len(rollout.steps) == STEPS
    for step in rollout.steps:
        assert step.observation["sensor_img"].shape == (ENVS, 64, 64, 1)
        assert np.isfinite(step.reward).all()


def test_touches_feel_the_records(case, rollout, provider):
    """The depth image of each touch is that of the height map at the same place."""
    hit, expected_hit, errors_m = [], [], []
    for step in rollout.steps:
        for env in running(step):
            sensor_m = step.info["sensor_pose"][env].translation
            depth_m = step.info["depth"][env]
            expected_m = expected_depth_m(
                step.points[env].record, step.object_poses[env], sensor_m, depth_m.shape
            )
            hit.append(sensor_m[2] - PRESS_DEPTH_M > CONTACT_HEIGHT_M)
            expected_hit.append((sensor_m[2] - expected_m).max() > CONTACT_HEIGHT_M)
            errors_m.append(np.abs(depth_m - expected_m))
    assert np.mean(hit) > case[3]
    assert np.mean(hit) == pytest.approx(np.mean(expected_hit), abs=0.02)
    touching = np.array(errors_m)[hit]
    assert np.median(touching) < 1e-6
    assert np.mean(touching < 1e-4) > 0.9, "all but steep edges agree"


def test_targets_are_those_of_the_records(case, rollout, provider):
    meshes = provider.meshes(case[1])
    by_id = {record.id: record for record in meshes}
    for step in rollout.steps:
        targets = step.info["prediction"]["target"]
        for env in range(ENVS):
            record = by_id[step.points[env].id]
            expected = expected_target(case[0], record, step.object_poses[env], meshes)
            np.testing.assert_allclose(targets[env], expected, rtol=1e-5, atol=1e-6)


def expected_target(env_id: str, record: Any, pose: Any, meshes: Any) -> Any:
    """Compute what is to be predicted from record and pose alone."""
    if "Volume" in env_id:
        volumes_m3 = np.array([other.volume_m3 for other in meshes])
        return [(record.volume_m3 - volumes_m3.mean()) / volumes_m3.std()]
    if "CenterOfMass" in env_id:
        centre_m = pose.matrix @ np.append(record.mesh.center_mass, 1.0)
        return centre_m[:2] / 0.06
    if "Toolbox" in env_id:
        return np.concatenate([pose.translation[:2] / 0.15, pose.matrix[:2, 0]])
    return record.label


def test_episodes_end_at_the_step_limit(case, rollout):
    """The step after the last one of an episode begins the next."""
    limit = case[2]
    expected = [(number + 1) % (limit + 1) == limit for number in range(STEPS)]
    for step, ends in zip(rollout.steps, expected, strict=True):
        assert step.terminated.tolist() == [ends] * ENVS
        assert not step.truncated.any()
    assert any(expected)


@pytest.mark.parametrize("env_id", [case[0] for case in SIMULATED], ids=IDS)
def test_single_form(env_id, provider, own_statistics):
    env = env_assets.make(env_id, provider=provider)
    try:
        observation, _ = env.reset(seed=SEED)
        env.action_space.seed(SEED)
        steps = 0
        ended = False
        while not ended:
            assert env.observation_space.contains(observation)
            observation, _, terminated, truncated, _ = env.step(env.action_space.sample())
            ended = bool(terminated or truncated)
            steps += 1
        assert (
            steps
            == env.spec.max_episode_steps
            == {"Starstruck": 32, "Toolbox": 32}.get(env_id.split("-")[0], 16)
        )
    finally:
        env.close()


def test_settings_and_variants(provider, own_statistics):
    """Overridden settings hold; the sparse form rewards guesses only at the end."""
    env = env_assets.make(
        "tactile_mnist:TactileMNISTSnap-Depth-test-sparse-v0",
        provider=provider,
        num_envs=2,
        config={"step_limit": 3},
    )
    try:
        rollout = roll(env, 3, SEED)
        assert (
            env.unwrapped.config.dataset.records.column("id").tolist()
            == provider.meshes("mnist3d", "test").ids.tolist()
        )
        assert env.unwrapped.config.snap_touch_positions > 1
    finally:
        env.close()
    guessed = [step.reward - step.info["base_reward"] for step in rollout.steps]
    assert np.abs(guessed[:2]).max() < 1e-9
    assert (guessed[2] < -0.01).all()
    assert rollout.steps[2].terminated.all()


def test_taxim(provider, own_statistics):
    pytest.importorskip("taxim.taxim_jax", reason="Taxim (extra `env`) is not installed")
    env = env_assets.make("TactileMNIST-train-v0", provider=provider, config={"sensor_output_size": (32, 24)})
    try:
        observation, _ = env.reset(seed=SEED)
        for _ in range(3):
            assert observation["sensor_img"].shape == (24, 32, 3)
            assert np.std(observation["sensor_img"]) > 0.01
            observation, *_ = env.step(env.action_space.sample())
    finally:
        env.close()


def test_cycle_gan(provider, own_statistics):
    """Its weights come with the package."""
    pytest.importorskip("torchvision", reason="torchvision (extra `torch`) is not installed")
    config = {"sensor_backend": "torch"}
    env = env_assets.make("TactileMNIST-CycleGAN-train-v0", provider=provider, config=config)
    try:
        observation, _ = env.reset(seed=SEED)
        assert observation["sensor_img"].shape == (64, 64, 3)
        assert np.std(observation["sensor_img"]) > 0.01
    finally:
        env.close()


def test_recorded_touches(assets, provider, own_statistics):
    """Each observation is an image of the round, taken near where the agent wanted it."""
    rounds = {record.id: record for record in realtouch.load(str(assets / "real-single"))}
    config = {"sensor_output_size": (96, 72)}
    env = env_assets.make("TactileMNISTRealSnap-train-v0", provider=provider, num_envs=ENVS, config=config)
    try:
        observation, info = env.reset(seed=SEED)
        env.action_space.seed(SEED)
        for _ in range(STEPS):
            for number, point in enumerate(env.unwrapped.current_data_points):
                touch = int(info["touch_idx"][number])
                image = rounds[point.id].sensor_image[touch].astype(np.float32) / 255
                np.testing.assert_array_equal(observation["sensor_img"][number], image)
                pose = rounds[point.id].gel_pose_cell_frame[touch]
                np.testing.assert_allclose(info["sensor_pose"][number].translation[:2], pose.translation[:2])
            points = env.unwrapped.current_data_points
            observation, _, terminated, truncated, info = env.step(env.action_space.sample())
            labels = [rounds[point.id].label for point in points]
            assert np.asarray(info["prediction"]["target"]).tolist() == labels
            assert not (terminated & truncated).any()
    finally:
        env.close()


def test_taxim_without_its_package(packages, provider):
    pytest.importorskip("torch", reason="torch (extra `torch`) is not installed")
    if importlib.util.find_spec("torch_scatter"):
        pytest.skip("torch_scatter is installed, so that Taxim runs on torch")
    with pytest.raises(InputError, match=r"'taxim' with backend 'torch' cannot run here: .*torch_scatter"):
        env_assets.make("TactileMNIST-train-v0", provider=provider, config={"sensor_backend": "torch"})
