"""Training libraries accept the environments; ``docs/howto/training_libraries.md`` trains agents."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch (extra `torch`) is not installed")
gym = pytest.importorskip("gymnasium", reason="gymnasium (extra `envs`) is not installed")

import tactile_envs  # noqa: E402

pytestmark = [pytest.mark.libraries, pytest.mark.thorough, pytest.mark.filterwarnings("ignore")]

FAMILIES = (
    "tactile_envs/TactileMNIST-Depth-train-v0",
    "tactile_envs/TactileMNISTVolume-Depth-train-sparse-v0",
    "tactile_envs/Toolbox-Depth-v0",
)


@pytest.mark.own_process
def test_torchrl(assets):
    """Its own check: specifications, seeds, resets of some; a single environment is no vector.

    In another process, because TorchRL changes how processes are started.
    """
    envs = pytest.importorskip("torchrl.envs", reason="torchrl (extra `libraries`) is not installed")
    options = {"assets": str(assets), "config": {"step_limit": 4}}
    for name in FAMILIES:
        vector = gym.make_vec(name, num_envs=3, autoreset_mode="DISABLED", **options)
        for env, count in (
            (envs.GymEnv(name, **options), 1),
            (envs.GymWrapper(gym.make(name, **options)), 1),
            (envs.GymWrapper(tactile_envs.wrappers.FlatAction(gym.make(name, **options))), 1),
            (envs.GymWrapper(tactile_envs.wrappers.FlatActionVector(vector)), 3),
        ):
            env.set_seed(0)
            envs.check_env_specs(env)
            assert env.batch_size.numel() == count
            touches = env.rollout(12, break_when_any_done=False)
            assert touches["next", "terminated"].sum() == 3 * count
            assert touches["next", "reward"].shape == (*env.batch_size, 12, 1)
            ends = touches["next", "time_step"].reshape(count, 12)[:, 3::4]
            assert (ends == 1).all()


@pytest.mark.parametrize("name", FAMILIES)
def test_stable_baselines(assets, name):
    """Its own check; and side by side, where rewards and last observations are those of one alone."""
    checker = pytest.importorskip(
        "stable_baselines3.common.env_checker",
        reason="stable-baselines3 (extra `libraries`) is not installed",
    )
    from stable_baselines3.common.env_util import make_vec_env

    def make() -> Any:
        return tactile_envs.wrappers.FlatAction(gym.make(name, assets=str(assets), config={"step_limit": 4}))

    checker.check_env(make())
    vector, alone = make_vec_env(make, n_envs=2, seed=5), make()
    first = vector.reset()
    seen, _ = alone.reset(seed=5)
    for _ in range(4):
        np.testing.assert_equal({key: values[0] for key, values in first.items()}, seen)
        action = alone.action_space.sample()
        first, rewards, over, infos = vector.step(np.stack([action, action]))
        seen, reward, terminated, _, _ = alone.step(action)
        assert rewards[0] == np.float32(reward)
        assert over[0] == terminated
    np.testing.assert_equal(infos[0]["terminal_observation"], seen)
    assert infos[0]["episode"]["l"] == 4


@pytest.mark.parametrize("name", FAMILIES)
def test_skrl(assets, name):
    """Return tensors with a row for each environment."""
    wrap_env = pytest.importorskip(
        "skrl.envs.wrappers.torch", reason="skrl (extra `libraries`) is not installed"
    ).wrap_env
    options = {"assets": str(assets), "config": {"step_limit": 4}}
    one = tactile_envs.wrappers.FlatAction(gym.make(name, **options))
    many = gym.make_vec(name, num_envs=3, autoreset_mode="SAME_STEP", **options)
    for env, count in ((wrap_env(one), 1), (wrap_env(tactile_envs.wrappers.FlatActionVector(many)), 3)):
        assert env.num_envs == count
        observation, _ = env.reset()
        size = observation.shape
        ends = []
        for _ in range(4):
            action = torch.as_tensor(env.action_space.sample()).expand(count, -1)
            observation, reward, terminated, _, _ = env.step(action)
            assert (observation.shape, reward.shape) == (size, (count, 1))
            assert torch.isfinite(reward).all()
            ends.append(terminated.sum().item())
        assert ends == [0, 0, 0, count]
