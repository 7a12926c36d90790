"""The state of environments whose episodes begin and end together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tactile_envs.config import Config
from tactile_envs.episode_kernels import place
from tactile_envs.mesh_pool import MeshPool
from tactile_envs.motion import Motion
from tactile_toolkit.array_types import Float64, Int64


@dataclass(eq=False)
class Episodes:
    """Objects and sensors of ``count`` environments.

    Attributes
    ----------
    step : int
        Steps since the episodes began.
    chosen, upcoming : ndarray of int64, shape (count,)
        Number of the mesh in each cell, and of the one of the next episode; -1 before the first reset.
    objects : ndarray of float64, shape (count, 3)
        Position of each object, metres, and turn, radians.
    sensors, targets : ndarray of float64, shape (count, 3)
        Position of each sensor, and where it was sent, metres.
    """

    count: int
    step: int = 0
    chosen: Int64 = field(init=False)
    upcoming: Int64 = field(init=False)
    objects: Float64 = field(init=False)
    sensors: Float64 = field(init=False)
    targets: Float64 = field(init=False)

    def __post_init__(self) -> None:
        self.chosen, self.upcoming = np.full((2, self.count), -1, np.int64)
        self.objects, self.sensors, self.targets = np.zeros((3, self.count, 3))

    def begin(
        self,
        config: Config,
        pool: MeshPool,
        rng: np.random.Generator,
        poses: Sequence[Float64 | None] | None = None,
    ) -> None:
        """Put the next objects into the cells; draws as the published environment does, in its order.

        ``poses`` are given places of objects (3,), None for those to be drawn.
        """
        poses = poses or [None] * self.count
        drawn = np.full((self.count, 3), 0.5)
        self.step, self.chosen[:] = 0, self.upcoming
        for i in range(self.count):
            self.upcoming[i] = rng.integers(0, len(pool))
            if poses[i] is None and config.randomize_initial_object_pose:
                drawn[i] = rng.random(3)
        if config.randomize_initial_object_pose:
            most_rad = config.max_initial_angle_perturbation
            room_m = np.array(config.cell_size) / 2 - config.object_placement_margin
            place(self.chosen, drawn, most_rad, room_m, pool.hulls, pool.grids, self.objects)
        else:
            self.objects[:] = 0.0
        for i, pose in enumerate(poses):
            if pose is not None:
                self.objects[i] = pose

    def aim_at_start(self, config: Config, motion: Motion, rng: np.random.Generator) -> None:
        """Send each sensor to the place of its first touch."""
        self.targets[:] = 0.0
        if config.randomize_initial_sensor_pose:
            self.targets[:, :2] = motion.random_places(rng, self.count).astype(np.float32)  # as published

    def move_to_targets(self, config: Config, motion: Motion, rng: np.random.Generator) -> None:
        """Move each sensor to its target, or to the nearest of some random places."""
        self.sensors[:] = self.targets
        if config.snap_touch_positions is None:
            return
        places = motion.random_places(rng, self.count, config.snap_touch_positions)
        nearest = np.linalg.norm(places - self.targets[:, None, :2], axis=2).argmin(axis=1)
        snapped = places[np.arange(self.count), nearest]
        if not self.step:  # single precision at the start of an episode, as published
            snapped = snapped.astype(np.float32).astype(np.float64)
        self.sensors[:, :2] = snapped
