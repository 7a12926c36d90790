"""A single environment, as a vector of one."""

from __future__ import annotations

from collections.abc import Mapping

import ap_gym
import numpy as np
from gymnasium.envs.registration import EnvSpec

from tactile_envs import environment, gym_types
from tactile_toolkit.array_types import UInt8


class TactileEnv(ap_gym.BaseActivePerceptionEnv):  # type: ignore[misc]
    """One environment; the step after the last touch of an episode begins the next one.

    Parameters
    ----------
    vector_env : TactileVectorEnv
        A vector of one, which does the work.

    Attributes
    ----------
    vector_env : TactileVectorEnv
        The vector, with poses of objects and sensors.
    """

    def __init__(self, vector_env: environment.TactileVectorEnv) -> None:
        self.vector_env, self.render_mode = vector_env, vector_env.render_mode
        self.metadata = {
            name: value for name, value in vector_env.metadata.items() if name != "autoreset_mode"
        }
        self.action_space = vector_env.single_action_space
        self.observation_space = vector_env.single_observation_space
        self.prediction_target_space = vector_env.single_prediction_target_space
        self.loss_fn = vector_env.loss_fn

    def reset(
        self, *, seed: int | None = None, options: gym_types.Options | None = None
    ) -> tuple[gym_types.Observation, gym_types.Info]:
        """Begin an episode.

        Parameters
        ----------
        seed : int, optional
            Seed of all random numbers.
        options : mapping, optional
            ``datapoint_idx``, ``initial_object_pose``, ``initial_sensor_target_pose``, as for
            :meth:`TactileVectorEnv.reset` for one environment.

        Returns
        -------
        tuple
            Observation and info of the first touch.

        Raises
        ------
        InputError
            An option is unknown, or a value cannot be used.
        gymnasium.error.ClosedEnvironmentError
            The environment was closed.
        """
        super().reset(seed=seed)
        self.vector_env.np_random = self.np_random
        given = {name: [value] for name, value in (options or {}).items()}
        observation, info = self.vector_env.reset(options=given)
        return _first(observation), _first(info)

    def step(
        self, action: gym_types.Action
    ) -> tuple[gym_types.Observation, float, bool, bool, gym_types.Info]:
        """Take one touch; see :meth:`TactileVectorEnv.step` for actions and errors.

        Returns
        -------
        tuple
            Observation, reward, whether the episode was terminated, whether it was truncated, and info.
        """
        observation, reward, terminated, truncated, info = self.vector_env.step(_batched(action))
        return _first(observation), float(reward[0]), bool(terminated[0]), bool(truncated[0]), _first(info)

    def render(self) -> UInt8 | None:
        """Return a picture, (240, 336, 3) uint8; None without a render mode."""
        pictures = self.vector_env.render()
        if pictures is None:
            return None
        return pictures[0]

    def close(self) -> None:
        """Release threads."""
        self.vector_env.close()

    @property
    def spec(self) -> EnvSpec | None:
        """Registration, with the length of an episode."""
        return self.vector_env.spec

    @spec.setter
    def spec(self, spec: EnvSpec) -> None:
        self.vector_env.spec = spec


def _batched(action: gym_types.Nested) -> gym_types.Nested:
    """Return an action, or a part of it, as that of a vector of one."""
    if isinstance(action, Mapping):
        return {name: _batched(part) for name, part in action.items()}
    return np.asarray(action)[np.newaxis]


def _first(values: gym_types.Nested) -> gym_types.Nested:
    """Return the results of the first environment of a vector: arrays without their first axis."""
    if isinstance(values, dict):
        return {name: _first(part) for name, part in values.items()}
    return np.asarray(values[0])
