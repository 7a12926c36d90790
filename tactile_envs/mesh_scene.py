"""Simulated touches: objects of a pool of meshes in cells, pressed by an upright sensor."""

from __future__ import annotations

from collections.abc import Sequence

import gymnasium as gym
import numpy as np

from env_assets.mesh_view import MeshRecord
from realtouch import Poses
from tactile_envs import (
    elastic_gel,
    episode_kernels,
    mesh_pool,
    randomization,
    reset_options,
    scene,
    toucher,
)
from tactile_envs.camera import Camera
from tactile_envs.config import Config
from tactile_envs.drawing import EnvDrawing
from tactile_toolkit.array_types import AnyArray, Float32, Float64, Int64
from tactile_toolkit.errors import InputError

_NO_DRIFT = np.zeros(3)
_UPRIGHT_WITHIN = 1e-6


class MeshScene(scene.TouchScene):
    """Objects in cells, touched by sensors that stay upright.

    A sensor points the same way when it touches as its target does.

    Random numbers are drawn as by the published environment, in its order.

    Parameters
    ----------
    config : Config
        Settings.
    records : sequence
        Meshes with ``id``, ``label``, ``vertices_m`` and ``faces``, and ``label_names`` of the data set.
    num_envs : int
        Number of cells.
    threads : int
        Number of threads that share a touch.
    camera : Camera
        Renders the images.
    """

    config: Config

    def __init__(
        self, config: Config, records: Sequence[MeshRecord], num_envs: int, threads: int, camera: Camera
    ) -> None:
        super().__init__(config, num_envs, camera.channels)
        self._records, self._pool = records, mesh_pool.MeshPool.of(records, self._most_tilt_rad)
        self._camera = camera
        self._elastic: elastic_gel.ElasticGel | None = None
        met = camera.sensor
        if config.elastic_gel is not None:
            self._elastic = elastic_gel.ElasticGel(config, camera.sensor)
            met = self._elastic.sensor
        self._toucher = toucher.Toucher(met, config.least_height_m, num_envs, threads)
        self._upcoming, self._sensors = np.full(num_envs, -1, np.int64), np.zeros((num_envs, 3))
        self._felt: Float32 = np.zeros((num_envs, 1, 1, camera.channels), np.float32)
        self._poses = np.tile(np.eye(4), (num_envs, 1, 1))  # of sensors, but for where they are
        width, height = config.sensor_output_size
        shape = (num_envs, height, width, camera.channels)
        self._randomization = randomization.Randomization(config, shape, camera.bases)
        if self._elastic is not None:
            most = np.full(3, np.inf, np.float32)
            self.observation_parts["force"] = gym.spaces.Box(-most, most)

    def __getstate__(self) -> dict[str, object]:
        """Leave out the mapped meshes, which a copy maps again; the copy has the same state."""
        return {**self.__dict__, "_pool": None}

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update(state)
        self._pool = mesh_pool.MeshPool.of(self._records, self._most_tilt_rad)
        self._pool.require(self.numbers[self.numbers >= 0])

    @property
    def _most_tilt_rad(self) -> float:
        """Greatest tilt of sensors, radians."""
        return 0.0

    @property
    def _axes(self) -> Float64:
        """Axes of the sensors in columns, shape (num_envs, 3, 3), cell frame; a view."""
        return self._poses[:, :3, :3]

    @property
    def pool(self) -> mesh_pool.MeshPool:
        """The meshes."""
        return self._pool

    def begin(
        self, rows: reset_options.Rows, rng: np.random.Generator, options: reset_options.ResetOptions
    ) -> None:
        """Put the next objects into some cells, and aim at the positions of their first touches."""
        chosen = np.arange(self.num_envs)[rows].tolist()
        for row in chosen:
            number = options.numbers[row]
            if number is None and self._upcoming[row] < 0:
                number = int(rng.integers(0, len(self._pool)))
            if number is not None:
                scene.require_number(number, len(self._pool))
                self._upcoming[row] = number
        self._place_objects(rows, chosen, rng, options.poses)
        self._randomization.begin(rows, rng)
        self._aim_at_start(rows, rng)
        for row in chosen:
            start = options.starts[row]
            if start is not None:
                self._aim_as_given(row, start)

    def discard_upcoming(self, rows: reset_options.Rows) -> None:
        """Discard the objects that were chosen for the next episodes of some cells, as a reset does."""
        self._upcoming[rows] = -1

    def _place_objects(
        self,
        rows: reset_options.Rows,
        chosen: Sequence[int],
        rng: np.random.Generator,
        poses: Sequence[Float64 | None],
    ) -> None:
        config = self.config
        self.numbers[rows] = self._upcoming[rows]
        self._pool.require(self.numbers[rows])
        drawn = np.full((self.num_envs, 3), 0.5)
        for row in chosen:
            self._upcoming[row] = rng.integers(0, len(self._pool))
            if poses[row] is None and config.randomize_initial_object_pose:
                drawn[row] = rng.random(3)
        placed = np.zeros((len(chosen), 3))
        if config.randomize_initial_object_pose:
            most_rad = config.max_initial_angle_perturbation
            room_m = np.array(config.cell_size) / 2 - config.object_placement_margin
            pool = self._pool
            episode_kernels.place(
                self.numbers[rows], drawn[rows], most_rad, room_m, pool.hulls, pool.grids, placed
            )
        self.places[rows] = placed
        for row in chosen:
            pose = poses[row]
            if pose is not None:
                self.places[row] = pose

    def _aim_at_start(self, rows: reset_options.Rows, rng: np.random.Generator) -> None:
        """Send sensors to the positions of their first touches."""
        self._targets[rows] = 0.0
        if self.config.randomize_initial_sensor_pose:
            # Drawn for all cells, and in single precision, as published.
            places = self._motion.random_places(rng, self.num_envs)
            self._targets[rows, :2] = np.asarray(places[rows], np.float32)

    def _aim_as_given(self, row: int, start: reset_options.SensorStart) -> None:
        """Send one sensor to the position of its first touch; InputError if the position is out of range."""
        if np.abs(start.axes - np.eye(3)).max() > _UPRIGHT_WITHIN:
            raise InputError(
                f"option 'initial_sensor_target_pose' turns sensor {row}, which stays upright",
                next='give (x, y), or set config={"allow_sensor_rotation": True}',
            )
        self._targets[row] = start.position_m

    @property
    def _positions_m(self) -> Float64:
        return self._sensors

    def touch(self, rows: reset_options.Rows, rng: np.random.Generator, steps: Int64) -> scene.Readings:
        """Touch in some cells, and let their objects slip."""
        config = self.config
        self._move_to_targets(rows, rng, steps)
        drift = _NO_DRIFT
        if config.perturb_object_pose:
            # One draw for all, as published.
            slip_m = rng.normal(scale=config.translation_perturbation_scale, size=2)
            drift = np.array([*slip_m, rng.normal(scale=config.rotation_perturbation_scale)])
        has_depth = config.depth_in_info or self._camera.sees_depth or self._elastic is not None
        sensors, places = self._sensors[rows], self.places[rows]
        draws = self._randomization.touch(len(sensors), rng)
        touches = self._press(rows, draws.lifts_m, sensors, places, drift, has_depth)
        felt: dict[str, AnyArray] = {}
        if self._elastic is not None:
            touches, felt["force"] = self._elastic.press(touches, sensors, self._axes[rows], self._motion)
        if rows is not reset_options.EVERY:  # otherwise both are views
            self._sensors[rows], self.places[rows] = sensors, places
        images = self._camera.pictures(touches, draws.bases)
        images = self._randomization.add_noise(images, rows, draws)
        self._keep(rows, images)
        poses: AnyArray = self._poses[rows].copy()
        poses[:, :3, 3] = sensors
        info: dict[str, AnyArray] = {"sensor_pose": poses}
        if config.depth_in_info:
            info["depth"] = touches.depths_m
        return scene.Readings({"sensor_pos": touches.positions, "sensor_img": images, **felt}, info)

    def _press(
        self,
        rows: reset_options.Rows,
        lifts_m: Float64,
        sensors: Float64,
        places: Float64,
        drift: Float64,
        has_depth: bool,
    ) -> toucher.SensorReadings:
        """Press sensors onto objects, which slip by ``drift``; both are moved."""
        numbers = self.numbers[rows]
        return self._toucher.touch(
            self._pool, numbers, lifts_m, sensors, places, self._motion, drift, with_depth=has_depth
        )

    def _keep(self, rows: reset_options.Rows, images: Float32) -> None:
        """Keep the last images for pictures."""
        if rows is reset_options.EVERY:
            self._felt = images
            return
        self._felt = self._felt.copy()
        self._felt[rows] = images

    def _move_to_targets(self, rows: reset_options.Rows, rng: np.random.Generator, steps: Int64) -> None:
        """Move sensors to their targets, or to the nearest of some random positions."""
        self._sensors[rows] = self._targets[rows]
        if self.config.snap_touch_positions is None:
            return
        places = self._motion.random_places(rng, self.num_envs, self.config.snap_touch_positions)
        nearest = np.linalg.norm(places - self._targets[:, None, :2], axis=2).argmin(axis=1)
        snapped = places[np.arange(self.num_envs), nearest]
        if not steps.any():  # in single precision, as published
            snapped = snapped.astype(np.float32).astype(np.float64)
        self._sensors[rows, :2] = snapped[rows]

    @property
    def data_points(self) -> tuple[object, ...]:
        """Records of the objects that lie in the cells."""
        return tuple(self._records[int(number)] for number in self.numbers)

    @property
    def object_poses(self) -> Poses:
        """Poses of the objects, metres, cell frame."""
        foot_m = self._pool.measure("foot_m")[self.numbers]
        half = self.places[:, 2] / 2
        quaternion = np.zeros((self.num_envs, 4))
        quaternion[:, 2], quaternion[:, 3] = np.sin(half), np.cos(half)
        return Poses(np.column_stack([self.places[:, :2], -foot_m]), quaternion)

    @property
    def target_poses(self) -> Poses:
        """Targets of the sensors, metres, cell frame."""
        from scipy.spatial.transform import Rotation

        return Poses(self._targets.copy(), Rotation.from_matrix(self._axes).as_quat())

    def drawing(self, row: int) -> EnvDrawing:
        """Return the content of a picture of one cell: the object in its pose for the next touch."""
        return EnvDrawing(
            self._pool,
            int(self.numbers[row]),
            self.places[row],
            self._sensors[row],
            self._targets[row],
            self._felt[row],
            self.config.cell_size,
            self._camera.sensor.window_m,
            self._axes[row, :2, :2],
        )

    def close(self) -> None:
        """End the threads."""
        self._toucher.close()
