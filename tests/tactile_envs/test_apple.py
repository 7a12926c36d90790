"""The wrappers of APPLE (https://github.com/TimSchneider42/apple), the training code of the paper.

They need JAX and modules of their own; here, an environment is used in the same order as by them
(``__prepare_env``).
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest

ap_gym = pytest.importorskip("ap_gym", reason="ap-gym (extra `envs`) is not installed")
import gymnasium as gym  # noqa: E402
from gymnasium.vector.utils import batch_space  # noqa: E402

from tests.tactile_envs.driving import DEPTH, ENVS, drive, make  # noqa: E402

pytestmark = [pytest.mark.envs, pytest.mark.filterwarnings("ignore")]


def _in_32_bits(space: Any) -> Any:
    """Return a copy of a space, with integers and numbers of 32 bits."""
    seed = space._np_random
    if isinstance(space, gym.spaces.Dict):
        return type(space)({name: _in_32_bits(part) for name, part in space.spaces.items()})
    if isinstance(space, gym.spaces.MultiDiscrete):
        return gym.spaces.MultiDiscrete(space.nvec, dtype=np.int32, seed=seed, start=space.start)
    if isinstance(space, gym.spaces.Discrete):
        return gym.spaces.Discrete(space.n, seed=seed, start=space.start, dtype=np.int32)
    options = {"dtype": np.float32, "seed": seed}
    if isinstance(space, ap_gym.ImageSpace):
        size = (space.width, space.height, space.channels)
        options.update(low=space.low, high=space.high, dtype=space.dtype)
        return ap_gym.ImageSpace(*size, batch_shape=space.batch_shape, **options)
    kind = ap_gym.LogitSpace if isinstance(space, ap_gym.LogitSpace) else gym.spaces.Box
    return kind(space.low, space.high, space.shape, **options)


class _RandomActions(ap_gym.ActivePerceptionVectorWrapper):
    """Takes only predictions, and acts at random."""

    def __init__(self, env: Any) -> None:
        super().__init__(env)
        self._actions = copy.deepcopy(env.inner_action_space)
        self._single_action_space = ap_gym.ActivePerceptionActionSpace(
            gym.spaces.Tuple(()), self.single_prediction_space
        )
        self._action_space = batch_space(self._single_action_space, env.num_envs)

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        self._actions.seed(seed)
        return super().reset(seed=seed, options=options)

    def step(self, action: Any) -> Any:
        return super().step({"action": self._actions.sample(), "prediction": action["prediction"]})


class _Checked(ap_gym.ActivePerceptionVectorWrapper):
    """Spaces and values in single precision, and a limit of steps."""

    def __init__(self, env: Any) -> None:
        super().__init__(env)
        self._observation_space = _in_32_bits(env.observation_space)
        self._single_observation_space = _in_32_bits(env.single_observation_space)
        self._prediction_target_space = _in_32_bits(env.prediction_target_space)
        self._single_prediction_target_space = _in_32_bits(env.single_prediction_target_space)
        self._steps = np.zeros(self.num_envs, np.int32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        self._steps[:] = 0
        return super().reset(seed=seed, options=options)

    def step(self, action: Any) -> Any:
        self._steps += 1
        assert (self._steps <= self.spec.max_episode_steps).all()
        observation, reward, done, cut, info = super().step(action)
        self._steps[done | cut] = -1
        for name, values in observation.items():
            assert values.dtype == self.observation_space[name].dtype
        return observation, reward.astype(np.float32), done, cut, info


class _BinaryReward(ap_gym.ActivePerceptionVectorWrapper):
    """Rewards correct predictions."""

    def step(self, action: Any) -> Any:
        observation, _, done, cut, info = super().step(action)
        assert "_base_reward" not in info
        right = np.argmax(action["prediction"], axis=-1) == info["prediction"]["target"]
        return observation, info["base_reward"] + right.astype(np.float32), done, cut, info


class _Pictures(ap_gym.ActivePerceptionVectorWrapper):
    """Observes rendered pictures."""

    def __init__(self, env: Any) -> None:
        super().__init__(env)
        env.reset(seed=0)
        height, width, channels = env.render()[0].shape
        pixels = ap_gym.ImageSpace(width, height, channels, dtype=np.uint8, low=0, high=255)
        spaces = {**env.single_observation_space.spaces, "pixels": pixels}
        self._single_observation_space = gym.spaces.Dict(spaces)
        self._observation_space = batch_space(self._single_observation_space, self.num_envs)

    def reset(self, **options: Any) -> Any:
        observation, info = super().reset(**options)
        return {**observation, "pixels": np.asarray(self.env.render())}, info

    def step(self, action: Any) -> Any:
        observation, *rest = super().step(action)
        return {**observation, "pixels": np.asarray(self.env.render())}, *rest


@pytest.mark.thorough
@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("sparse", [False, True])
def test_the_stack_of_apple(assets, sparse):
    """From the image spaces that it looks for to the statistics and videos that it logs."""
    name = DEPTH.replace("train", "train-sparse") if sparse else DEPTH
    env = make(assets, name, render_mode="rgb_array")
    assert isinstance(env.single_observation_space["sensor_img"], ap_gym.ImageSpace)
    assert env.metadata["render_fps"] == 5
    env = ap_gym.ensure_active_perception_vector_env(gym.vector.VectorWrapper(env))
    env = env if sparse else _BinaryReward(env)
    env = _Checked(_RandomActions(_Pictures(env)))
    assert env.prediction_target_space.sample() is not None
    for observation, reward, done, info in drive(env, 40):
        assert observation["pixels"].dtype == np.uint8
        assert reward.dtype == np.float32
        target = info["prediction"]["target"]
        assert (set(target) == {"target", "weight"}) if sparse else (target.shape == (ENVS,))
        assert ("stats" in info) == done.any()
        if done.any():
            stats = info["stats"]
            for kind in ("scalar", "vector"):
                for key in (key for key in stats[kind] if key[0] != "_"):
                    valid = stats[kind][f"_{key}"]
                    assert np.asarray(stats[kind][key])[valid].shape[0] == valid.sum()
            lengths = {len(curve) for curve in stats["vector"]["accuracy"]}
            assert lengths == {env.spec.max_episode_steps}
