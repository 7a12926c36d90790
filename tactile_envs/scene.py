"""What sensors touch, and how they get there: the part of an environment that is simulated or recorded."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from realtouch import Poses
from tactile_envs import gym_types, reset_options
from tactile_envs.config import EpisodeConfig
from tactile_envs.drawing import EnvDrawing
from tactile_toolkit.array_types import AnyArray, Bool, Float32, Float64, Int64


class Readings(NamedTuple):
    """One touch of some environments: parts of an observation, and of an info."""

    observation: dict[str, AnyArray]
    info: dict[str, AnyArray]


class TouchScene(Protocol):
    """Some cells with an object and a sensor each.

    Attributes
    ----------
    num_envs : int
        How many cells.
    action_parts, observation_parts : dict of str to gymnasium.Space
        Spaces of a single action, and of what a single sensor observes.
    numbers : ndarray of int64, shape (num_envs,)
        Number of the object in each cell; -1 before the first episode.
    places : ndarray of float64, shape (num_envs, 3)
        Position (x, y) of each object, metres, and its turn, radians, cell frame.
    """

    num_envs: int
    action_parts: dict[str, gym_types.Space]
    observation_parts: dict[str, gym_types.Space]
    numbers: Int64
    places: Float64

    @property
    def config(self) -> EpisodeConfig:
        """Settings."""

    def begin(
        self, rows: reset_options.Rows, rng: np.random.Generator, options: reset_options.ResetOptions
    ) -> None:
        """Begin an episode in some cells: choose objects and the places of the first touches."""

    def discard_upcoming(self, rows: reset_options.Rows) -> None:
        """Forget which objects come next in some cells, as a reset does."""

    def checked_action(self, action: gym_types.Action) -> gym_types.Action:
        """Return the arrays of an action of all cells; InputError or ValueError if it cannot be used."""

    def aim(self, action: gym_types.Action, rows: reset_options.Rows) -> Float32:
        """Send the sensors of some cells to where an action says; return what actions cost, (num_envs,)."""

    def touch(self, rows: reset_options.Rows, rng: np.random.Generator, steps: Int64) -> Readings:
        """Touch in some cells; ``steps``, shape (n,), count from the first touch of their episodes."""

    @property
    def is_exhausted(self) -> Bool | None:
        """In which cells no further touch is possible, shape (num_envs,); None where there always is one."""

    @property
    def data_points(self) -> tuple[object, ...]:
        """The records of the objects in the cells, or of their recorded touches."""

    @property
    def object_poses(self) -> Poses:
        """Poses of the objects, metres, cell frame."""

    @property
    def target_poses(self) -> Poses:
        """Where the sensors were sent, metres, cell frame."""

    @property
    def position_limits_m(self) -> tuple[Float64, Float64]:
        """Lowest and highest position of sensors, shape (3,) each, metres; the range of what they observe."""

    def drawing(self, row: int) -> EnvDrawing:
        """Return what a picture of one cell shows."""

    def close(self) -> None:
        """Release threads."""
