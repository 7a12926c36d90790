"""Training code drives environments: the wrappers of gymnasium, of ap-gym, and those of APPLE.

APPLE (https://github.com/TimSchneider42/apple) is the training code of the paper. Its wrappers need JAX and
modules of its own; what they ask of an environment is asked here in the same order (``__prepare_env``).
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ap_gym = pytest.importorskip("ap_gym", reason="ap-gym (extra `envs`) is not installed")
import gymnasium as gym  # noqa: E402
from gymnasium.vector.utils import batch_space  # noqa: E402
from gymnasium.wrappers import vector as wrappers  # noqa: E402

import tactile_envs  # noqa: E402, F401

pytestmark = [pytest.mark.envs, pytest.mark.filterwarnings("ignore")]

DEPTH = "tactile_envs:TactileMNIST-Depth-train-v0"
ENVS, STEPS = 3, 20


def make(assets: Path, name: str = DEPTH, **options: Any) -> Any:
    return gym.make_vec(name, num_envs=ENVS, assets=str(assets), **options)


def drive(env: Any, steps: int = STEPS) -> list[Any]:
    """Take random steps, more than an episode has; observations stay in their spaces."""
    observation, info = env.reset(seed=1)
    env.action_space.seed(1)
    assert observation in env.observation_space
    taken = []
    for _ in range(steps):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert observation in env.observation_space
        assert np.isfinite(reward).all()
        taken.append((observation, reward, terminated | truncated, info))
    assert any(np.all(done) for _, _, done, _ in taken)
    return taken


def _same(observation: Any) -> Any:
    return observation


APPLY: dict[str, Callable[[Any], Any]] = {
    "RecordEpisodeStatistics": wrappers.RecordEpisodeStatistics,
    "TransformObservation": lambda env: wrappers.TransformObservation(env, _same),
    "VectorizeTransformObservation": lambda env: wrappers.VectorizeTransformObservation(
        env, gym.wrappers.TransformObservation, func=_same, observation_space=env.single_observation_space
    ),
    "FilterObservation": lambda env: wrappers.FilterObservation(env, ["sensor_pos", "time_step"]),
    "FlattenObservation": wrappers.FlattenObservation,
    "NormalizeObservation": lambda env: wrappers.NormalizeObservation(wrappers.FlattenObservation(env)),
    "DtypeObservation": lambda env: wrappers.DtypeObservation(wrappers.FlattenObservation(env), np.float64),
    "TransformAction": lambda env: wrappers.TransformAction(env, _same),
    "TransformReward": lambda env: wrappers.TransformReward(env, _same),
    "VectorizeTransformReward": lambda env: wrappers.VectorizeTransformReward(
        env, gym.wrappers.TransformReward, func=_same
    ),
    "ClipReward": lambda env: wrappers.ClipReward(env, -1, 1),
    "NormalizeReward": wrappers.NormalizeReward,
}
"""Of ``gymnasium.wrappers.vector``.

Those for observations or actions that are one box do not apply, nor ``DictInfoToList`` and those for torch,
which convert arrays alone: ``info`` holds poses, as that of the published class does.
"""


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("name", APPLY)
def test_wrappers_of_gymnasium(assets, name):
    drive(APPLY[name](make(assets)))


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    ("name", "wrap"),
    [
        (DEPTH, ap_gym.ActivePerceptionVectorWrapper),
        (DEPTH, ap_gym.ActivePerceptionVectorLogWrapper),
        (DEPTH, ap_gym.ActiveClassificationVectorLogWrapper),
        ("tactile_envs:TactileMNISTVolume-Depth-train-v0", ap_gym.ActiveRegressionVectorLogWrapper),
        (DEPTH, lambda env: ap_gym.ActivePerceptionVectorRestoreWrapper(wrappers.ClipReward(env, -9, 9))),
        (DEPTH, ap_gym.ensure_active_perception_vector_env),
    ],
    ids=["plain", "log", "classification", "regression", "restore", "ensure"],
)
def test_wrappers_of_ap_gym(assets, name, wrap):
    env = wrap(make(assets, name))
    assert env.prediction_target_space == env.unwrapped.prediction_target_space
    assert env.loss_fn is env.unwrapped.loss_fn
    for _, _, done, info in drive(env):
        assert info["prediction"]["loss"].shape == (ENVS,)
        assert ("stats" in info) == done.any()


def test_a_vector_seen_as_one(assets):
    env = ap_gym.ActivePerceptionVectorToSingleWrapper(gym.make_vec(DEPTH, num_envs=1, assets=str(assets)))
    env = ap_gym.TimeLimit(ap_gym.ActivePerceptionLogWrapper(env), 5, issue_termination=True)
    observation, _ = env.reset(seed=0)
    for step in range(5):
        observation, _, terminated, _, _ = env.step(env.action_space.sample())
        assert bool(terminated) == (step == 4)
    assert observation["time_step"] == 1


def _in_32_bits(space: Any) -> Any:
    """Make a space again from its parts, with integers and numbers of 32 bits."""
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
    """Takes predictions alone, and acts at random."""

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
    """Rewards answers that are right."""

    def step(self, action: Any) -> Any:
        observation, _, done, cut, info = super().step(action)
        assert "_base_reward" not in info
        right = np.argmax(action["prediction"], axis=-1) == info["prediction"]["target"]
        return observation, info["base_reward"] + right.astype(np.float32), done, cut, info


class _Pictures(ap_gym.ActivePerceptionVectorWrapper):
    """Observes what is rendered."""

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


def test_a_single_one_through_the_wrappers_of_ap_gym(assets):
    env = gym.make(DEPTH, assets=str(assets))
    env = ap_gym.ActiveClassificationLogWrapper(ap_gym.ActivePerceptionWrapper(env))
    env = ap_gym.ensure_active_perception_env(gym.wrappers.RecordEpisodeStatistics(env))
    env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(16):
        *_, terminated, _, info = env.step(env.action_space.sample())
    assert terminated
    assert info["episode"]["l"] == 16
    assert set(info["stats"]) >= {"scalar", "vector"}
