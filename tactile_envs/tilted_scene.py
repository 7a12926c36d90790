"""Simulated touches by sensors that turn: their actions, observations and contacts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import gymnasium as gym
import numpy as np
import trimesh

from env_assets.mesh_view import LazyMesh, MeshRecord
from tactile_envs import (
    episode_kernels,
    gym_types,
    mesh_pool,
    mesh_scene,
    motion,
    reset_options,
    scene,
    tilted_kernels,
    toucher,
)
from tactile_envs.camera import Camera
from tactile_envs.config import Config
from tactile_toolkit.array_types import Float32, Float64, Int64
from tactile_toolkit.errors import InputError

_TURN, _TURNED = "sensor_target_rot_rel", "sensor_rot"
# tactile-mnist 0.13.0: thickness of the plate, and from how many widths of it sensors look.
_PLATE_M, _PLATES_AWAY = 0.002, 2.0
_ROUNDING_RAD = 1e-6


class TiltedScene(mesh_scene.MeshScene):
    """Objects in cells, touched by sensors that actions turn as well.

    A sensor comes down along its own axis. It sees the objects, and the plate up to its edges. Parameters are
    those of :class:`tactile_envs.mesh_scene.MeshScene`.
    """

    def __init__(
        self, config: Config, records: Sequence[MeshRecord], num_envs: int, threads: int, camera: Camera
    ) -> None:
        super().__init__(config, records, num_envs, threads, camera)
        widest_rad = config.longest_way(config.angular_velocity, config.angular_acceleration)
        self._limits = np.array([widest_rad, config.max_tilt_angle])
        box = partial(trimesh.creation.box, (*config.cell_size, _PLATE_M))
        self._plate = mesh_pool.MeshPool.packed([LazyMesh(0, 0, box)], config.max_tilt_angle)
        self._far_m = _PLATES_AWAY * max(config.cell_size)
        self.action_parts[_TURN] = gym.spaces.Box(-np.ones(3, np.float32), np.ones(3, np.float32))
        self.observation_parts[_TURNED] = gym.spaces.Box(-np.ones(6, np.float32), np.ones(6, np.float32))

    @property
    def _most_tilt_rad(self) -> float:
        return self.config.max_tilt_angle

    def _aim_at_start(self, rows: reset_options.Rows, rng: np.random.Generator) -> None:
        self._targets[rows] = 0.0
        angles = np.zeros((3, self.num_envs))
        if self.config.randomize_initial_sensor_pose:
            # Drawn for all cells, one after the other, and places in single precision, as published.
            drawn = rng.random((self.num_envs, 5))
            low_m, high_m = self._motion.low_m[:2], self._motion.high_m[:2]
            places_m = low_m + (high_m - low_m) * drawn[:, :2]
            self._targets[rows, :2] = np.asarray(places_m[rows], np.float32)
            angles = drawn.T[2:] * [[self.config.max_tilt_angle], [2 * math.pi], [2 * math.pi]]
            angles[1:] -= math.pi
        self._axes[rows] = _axes_of(*angles)[rows]

    def _aim_as_given(self, row: int, start: reset_options.SensorStart) -> None:
        tilt_rad, most_rad = math.acos(max(-1.0, min(start.axes[2, 2], 1.0))), self.config.max_tilt_angle
        if tilt_rad > most_rad + _ROUNDING_RAD:
            raise InputError(
                f"option 'initial_sensor_target_pose' tilts sensor {row} by {tilt_rad:.4f} rad; expected at "
                f"most max_tilt_angle, {most_rad:.4f}"
            )
        self._targets[row] = start.position_m
        self._axes[row] = start.axes

    def checked_action(self, action: gym_types.Action) -> gym_types.Action:
        """Return the arrays of an action; InputError or ValueError if it cannot be used."""
        return {**super().checked_action(action), _TURN: motion.require_move(action, _TURN, self.num_envs)}

    def aim(self, action: gym_types.Action, rows: reset_options.Rows) -> Float32:
        """Set the targets of some sensors from an action; return the costs of actions, shape (n,)."""
        costs = super().aim(action, rows)
        axes = self._axes.copy()
        episode_kernels.turn(action[_TURN], self._limits, self.config.action_regularization, axes, costs)
        self._axes[rows] = axes[rows]
        return costs

    def touch(self, rows: reset_options.Rows, rng: np.random.Generator, steps: Int64) -> scene.Readings:
        """Touch in some cells, and let their objects slip."""
        readings = super().touch(rows, rng, steps)
        axes = self._axes[rows].transpose(0, 2, 1)[:, 1:].reshape(-1, 6)
        turned = np.clip(axes, -1, 1).astype(np.float32)
        return scene.Readings({**readings.observation, _TURNED: turned}, readings.info)

    def _press(
        self,
        rows: reset_options.Rows,
        lifts_m: Float64,
        sensors: Float64,
        places: Float64,
        drift: Float64,
        has_depth: bool,
    ) -> toucher.SensorReadings:
        numbers, axes = self.numbers[rows], np.ascontiguousarray(self._axes[rows])
        pools = (self._pool.arrays, self._plate.arrays)
        read = (self._toucher.window, self._motion.numbers, drift, *pools, self._far_m)

        def press(begin: int, end: int, room: Float32, readings: toucher.SensorReadings) -> None:
            tilted_kernels.touch_tilted(
                begin, end, *read, numbers, lifts_m, axes, sensors, places, room, *readings
            )

        return self._toucher.shared(len(numbers), press, with_depth=has_depth)


def _axes_of(tilt: Float64, towards: Float64, spin: Float64) -> Float64:
    """Return axes (n, 3, 3), in columns, of sensors that are spun, then tilted in a direction; radians."""
    x, y, level = np.cos(towards), np.sin(towards), np.zeros(len(tilt))
    z = np.stack([np.sin(tilt) * x, np.sin(tilt) * y, np.cos(tilt)], axis=1)
    down = np.stack([np.cos(tilt) * x, np.cos(tilt) * y, -np.sin(tilt)], axis=1)
    across = np.stack([-y, x, level], axis=1)
    cosine, sine = np.cos(spin)[:, None], np.sin(spin)[:, None]
    return np.stack([cosine * down + sine * across, cosine * across - sine * down, z], axis=2)
