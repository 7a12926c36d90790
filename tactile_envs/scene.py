"""The part of an environment that is simulated or recorded: objects, touches and motion of sensors."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import ap_gym
import gymnasium as gym
import numpy as np

from realtouch import Poses
from tactile_envs import gym_types, motion, reset_options
from tactile_envs.config import EpisodeConfig
from tactile_envs.drawing import EnvDrawing
from tactile_toolkit.array_types import AnyArray, Bool, Float32, Float64, Int64
from tactile_toolkit.errors import InputError

_MOVE = "sensor_target_pos_rel"


class Readings(NamedTuple):
    """One touch of some environments: parts of an observation, and of an info."""

    observation: dict[str, AnyArray]
    info: dict[str, AnyArray]


class TouchScene(ABC):
    """Some cells with an object and a sensor each.

    Parameters
    ----------
    config : EpisodeConfig
        Settings.
    num_envs : int
        Number of cells.
    channels : int
        Number of colours of the images.

    Attributes
    ----------
    action_parts, observation_parts : dict of str to gymnasium.Space
        Spaces of a single action, and of the observation of a single sensor.
    numbers : ndarray of int64, shape (num_envs,)
        Number of the object in each cell; -1 before the first episode.
    places : ndarray of float64, shape (num_envs, 3)
        Position (x, y) of each object, metres, and its rotation, radians, cell frame.
    """

    config: EpisodeConfig

    def __init__(self, config: EpisodeConfig, num_envs: int, channels: int) -> None:
        self.config, self.num_envs = config, num_envs
        self._motion = motion.Motion.of(config)
        self.numbers = np.full(num_envs, -1, np.int64)
        self.places, self._targets = np.zeros((2, num_envs, 3))
        corner = np.ones(3, np.float32)
        self.action_parts: dict[str, gym_types.Space] = {_MOVE: gym.spaces.Box(-corner, corner)}
        self.observation_parts: dict[str, gym_types.Space] = {
            "sensor_pos": gym.spaces.Box(-corner, corner),
            "sensor_img": ap_gym.ImageSpace(*config.sensor_output_size, channels, dtype=np.float32),
        }

    @abstractmethod
    def begin(
        self, rows: reset_options.Rows, rng: np.random.Generator, options: reset_options.ResetOptions
    ) -> None:
        """Begin an episode in some cells: choose objects and the places of the first touches."""

    def discard_upcoming(self, rows: reset_options.Rows) -> None:  # noqa: B027
        """Discard the objects that were chosen for the next episodes of some cells, as a reset does."""

    def checked_action(self, action: gym_types.Action) -> gym_types.Action:
        """Return the arrays of an action of all cells; InputError or ValueError if it cannot be used."""
        return {_MOVE: motion.require_move(action, _MOVE, self.num_envs)}

    @property
    @abstractmethod
    def _positions_m(self) -> Float64:
        """Positions of the sensors, shape (num_envs, 3), metres, cell frame."""

    def aim(self, action: gym_types.Action, rows: reset_options.Rows) -> Float32:
        """Set the targets of sensors in some cells from an action; return the costs, (num_envs,)."""
        if rows is reset_options.EVERY:
            return self._motion.aim(action[_MOVE], self._positions_m, self._targets)
        targets = self._targets.copy()
        costs = self._motion.aim(action[_MOVE], self._positions_m, targets)
        self._targets[rows] = targets[rows]
        return costs

    @abstractmethod
    def touch(self, rows: reset_options.Rows, rng: np.random.Generator, steps: Int64) -> Readings:
        """Touch in some cells; ``steps``, shape (n,), count from the first touch of their episodes."""

    @property
    def is_exhausted(self) -> Bool | None:
        """Whether no further touch is possible, for each cell, (num_envs,); None if there always is one."""
        return None

    @property
    @abstractmethod
    def data_points(self) -> tuple[object, ...]:
        """The records of the objects in the cells, or of their recorded touches."""

    @property
    @abstractmethod
    def object_poses(self) -> Poses:
        """Poses of the objects, metres, cell frame."""

    @property
    @abstractmethod
    def target_poses(self) -> Poses:
        """Targets of the sensors, metres, cell frame."""

    @property
    def position_limits_m(self) -> tuple[Float64, Float64]:
        """Lowest and highest position of sensors, shape (3,) each, metres; the range of observations."""
        return self._motion.low_m, self._motion.high_m

    @abstractmethod
    def drawing(self, row: int) -> EnvDrawing:
        """Return the content of a picture of one cell."""

    def close(self) -> None:  # noqa: B027
        """Release threads."""


def require_number(number: int, count: int) -> None:
    """Raise InputError for the number of an object, an option of a reset, beyond a set of ``count``."""
    if not 0 <= number < count:
        raise InputError(f"datapoint_idx is {number}; expected 0 to {count - 1}")
