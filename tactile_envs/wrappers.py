"""Wrappers for training libraries that take one flat action."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector.utils import batch_space

from tactile_envs import motion
from tactile_envs.config import Info, Observation, Space
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import AnyArray, Bool, Float32

LOGIT_LIMIT = 5.0
"""Bound of parts of an action that have none; the probability of one of ten classes is at most 0.9996."""

_LARGEST_LIMIT = 1e30
_Path = tuple[str, ...]


class FlatAction(gym.Wrapper, RecordConstructorArgs):
    """Environment with one flat action, and observations and rewards as libraries expect them.

    Parts of an action follow each other, the prediction last. Nothing is scaled. Single numbers of
    observations become arrays of shape (1,).

    Parameters
    ----------
    env : gymnasium.Env
        An environment of this package, or wrappers around one.
    limit : float
        Bound of the numbers of an action that have none in the environment, such as logits. Libraries keep
        actions within the bounds of their space; larger numbers are passed on as they are.

    Raises
    ------
    InputError
        A part of an action or observation is not a box, or the limit is not a positive number.
    """

    def __init__(self, env: gym.Env[Any, Any], limit: float = LOGIT_LIMIT) -> None:
        RecordConstructorArgs.__init__(self, limit=limit)
        gym.Wrapper.__init__(self, env)
        self._form = _FlatForm(env.action_space, env.observation_space, limit)
        self.action_space, self.observation_space = self._form.action_space, self._form.observation_space

    def reset(self, **options: Any) -> tuple[Observation, Info]:
        """Begin an episode, as the environment does."""
        observation, info = self.env.reset(**options)
        return self._form.shaped(observation), info

    def step(self, action: AnyArray) -> tuple[Observation, float, bool, bool, Info]:
        """Take one touch, with an action of ``action_space``; InputError for another shape."""
        observation, reward, terminated, truncated, info = self.env.step(self._form.unflatten(action))
        return self._form.shaped(observation), float(reward), terminated, truncated, info


class FlatActionVector(gym.vector.VectorWrapper):
    """Vector of environments with flat actions, as :class:`FlatAction`.

    Parameters
    ----------
    env : gymnasium.vector.VectorEnv
        Environments of this package, or wrappers around them.
    limit : float
        As for :class:`FlatAction`.

    Attributes
    ----------
    autoreset_mode : gymnasium.vector.AutoresetMode
        That of the environments.

    Raises
    ------
    InputError
        A part of an action or observation is not a box, or the limit is not a positive number.
    """

    def __init__(self, env: gym.vector.VectorEnv[Any, Any, Any], limit: float = LOGIT_LIMIT) -> None:
        super().__init__(env)
        self.autoreset_mode = env.metadata["autoreset_mode"]
        self._form = _FlatForm(env.single_action_space, env.single_observation_space, limit)
        self.single_action_space = self._form.action_space
        self.single_observation_space = self._form.observation_space
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    def reset(self, **options: Any) -> tuple[Observation, Info]:
        """Begin episodes, as the environments do."""
        observation, info = self.env.reset(**options)
        return self._form.shaped(observation, self.num_envs), info

    def step(self, actions: AnyArray) -> tuple[Observation, Float32, Bool, Bool, Info]:
        """Take one touch each, with an action of ``action_space``; InputError for another shape."""
        action = self._form.unflatten(actions, self.num_envs)
        observation, reward, terminated, truncated, info = self.env.step(action)
        if "final_obs" in info:
            info["final_obs"] = self._form.shaped(info["final_obs"], self.num_envs)
        return self._form.shaped(observation, self.num_envs), reward, terminated, truncated, info


class _Part(NamedTuple):
    """A part of an action: the names that lead to it, its shape, and its numbers in a flat action."""

    path: _Path
    shape: tuple[int, ...]
    numbers: slice


class _FlatForm:
    """Spaces of flat actions and of observations without single numbers, and conversions to and from them."""

    def __init__(self, action: Space, observation: Space, limit: float) -> None:
        if not (isinstance(limit, (int, float)) and 0 < limit <= _LARGEST_LIMIT):
            raise InputError(
                f"is {limit!r}; expected a positive number up to {_LARGEST_LIMIT:g}", field="limit"
            )
        self._parts: list[_Part] = []
        lows = []
        highs = []
        end = 0
        for path, box in _boxes(action):
            begin = end
            end = end + box.low.size
            self._parts.append(_Part(path, box.shape, slice(begin, end)))
            lows.append(box.low.ravel())
            highs.append(box.high.ravel())
        low, high = (np.concatenate(bounds).astype(np.float32) for bounds in (lows, highs))
        low[np.isinf(low)], high[np.isinf(high)] = -limit, limit
        self.action_space = gym.spaces.Box(low, high)
        self.observation_space = gym.spaces.Dict(
            {path[-1]: _with_axis(box) for path, box in _boxes(observation)}
        )

    def unflatten(self, flat: AnyArray, *batch: int) -> Info:
        """Return actions of the environment; InputError if flat ones have another shape."""
        numbers = motion.single_precision(flat, "action")
        shape = (*batch, *self.action_space.shape)
        if numbers.shape != shape:
            raise InputError(f"the action has shape {numbers.shape}; expected {shape}")
        action: Info = {}
        for (*folders, name), part_shape, part in self._parts:
            inner = action
            for folder in folders:
                inner = inner.setdefault(folder, {})
            inner[name] = numbers[..., part].reshape(*batch, *part_shape)
        return action

    def shaped(self, observation: Observation, *batch: int) -> Observation:
        """Return observations with the shapes of their space."""
        return {
            name: values.reshape(*batch, *(values.shape[len(batch) :] or (1,)))
            for name, values in observation.items()
        }


def _boxes(space: Space, path: _Path = ()) -> Iterator[tuple[_Path, gym.spaces.Box]]:
    """Yield the boxes of a space, each with the names that lead to it."""
    if isinstance(space, gym.spaces.Dict):
        for name, part in space.items():
            yield from _boxes(part, (*path, name))
    elif isinstance(space, gym.spaces.Box) and path:
        yield path, space
    else:
        raise InputError(
            f"the environment has the space {space}; expected a dictionary of boxes",
            next="give the environment as `gymnasium.make` or `gymnasium.make_vec` returns it",
        )


def _with_axis(box: gym.spaces.Box) -> gym.spaces.Box:
    """Return a space with at least one axis."""
    if box.shape:
        return box
    return gym.spaces.Box(box.low.reshape(1), box.high.reshape(1), dtype=np.float32)
