"""Limits of the motion of sensors, and costs of actions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from tactile_envs.config import EpisodeConfig
from tactile_envs.episode_kernels import aim
from tactile_envs.gym_types import Action
from tactile_toolkit.array_types import Float32, Float64
from tactile_toolkit.errors import InputError

# The square of this times the largest `action_regularization` is finite in single precision.
_MAX_MOVE = 1e12
_TOP_M = 0.02  # tactile-mnist 0.13.0: range of the observed height of the sensor


@dataclass(frozen=True, eq=False)
class Motion:
    """Limits and costs of the motion of sensors.

    Attributes
    ----------
    low_m, high_m : ndarray of float64, shape (3,)
        Lowest and highest position, metres, cell frame.
    numbers : ndarray of float64, shape (8,)
        Both positions, greatest distance of an action, metres, and cost factor, as kernels take them.
    """

    low_m: Float64
    high_m: Float64
    numbers: Float64

    @classmethod
    def of(cls, config: EpisodeConfig) -> Self:
        """Return the motion of a configuration."""
        reach_m = np.array(config.cell_size) / 2 - np.array(config.cell_padding)
        low_m, high_m = np.array([*-reach_m, 0.0]), np.array([*reach_m, _TOP_M])
        longest_m = config.longest_way(config.linear_velocity, config.linear_acceleration)
        costs = [longest_m, config.action_regularization]
        return cls(low_m, high_m, np.concatenate([low_m, high_m, costs]))

    def random_places(self, rng: np.random.Generator, *shape: int) -> Float64:
        """Draw positions, shape (*shape, 2), metres."""
        return rng.uniform(self.low_m[:2], self.high_m[:2], (*shape, 2))

    def aim(self, moves: Float32, sensors: Float64, targets: Float64) -> Float32:
        """Write the targets of actions, and return the costs, shape (n,).

        ``moves`` are actions; ``sensors`` and ``targets`` are positions, metres. All have the shape (n, 3).
        """
        costs = np.zeros(len(moves), np.float32)
        aim(moves, self.numbers, sensors, targets, costs)
        return costs


def require_move(action: Action, name: str, num_envs: int) -> Float32:
    """Return a part of an action, shape (num_envs, 3).

    InputError for another shape, and for numbers so large that the cost, a square, is not finite; ValueError
    for NaN and infinite numbers, as in the published environment.
    """
    moves = np.ascontiguousarray(action[name], np.float32)
    if moves.shape != (num_envs, 3):
        raise InputError(f"{name} has shape {moves.shape}; expected {(num_envs, 3)}")
    sizes = np.abs(moves)
    if sizes.max() <= _MAX_MOVE:  # false for NaN
        return moves
    if not np.isfinite(moves).all():  # infinite moves lead to NaN
        raise ValueError(f"NaN values detected in {name}.")
    row = int(sizes.max(axis=1).argmax())
    raise InputError(
        f"{name} of environment {row} is {moves[row].tolist()}; expected numbers up to {_MAX_MOVE:.0e}: "
        "the cost of such an action is not finite",
        next="check the policy; longer movements than 1 are shortened to 1",
    )
