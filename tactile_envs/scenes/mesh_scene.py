"""Scenes of meshes: objects in cells, how their touches vary, and touches of an elastic gel."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import NamedTuple

import gymnasium as gym
import numpy as np

from env_assets.mesh_view import MeshRecord, MeshView, PlannedView
from realtouch import Poses
from tactile_envs import episode_kernels, mesh_pool, motion, object_sets
from tactile_envs.config import Config
from tactile_envs.drawing import EnvDrawing
from tactile_envs.motion import Motion, Rows
from tactile_envs.scenes import scene
from tactile_envs.touch_kernels import Cells, SensorReadings
from tactile_sim import Sensor
from tactile_sim.elastic.contact import GelLoad, GelSurface
from tactile_sim.optics.sensor_noise import EpisodeNoise
from tactile_sim.press.elastic_press import WholeGel, loads_of
from tactile_sim.sets.touched_solids import content_fingerprint
from tactile_toolkit.errors import InputError
from tactile_toolkit.read import RecordDataset
from tactile_toolkit.value_types import AnyArray, Bool, Float32, Float64, Int64, JsonDict

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
    camera: scene.Camera

    def __init__(
        self, config: Config, records: object_sets.Objects, num_envs: int, threads: int, camera: scene.Camera
    ) -> None:
        super().__init__(config, num_envs, camera.channels)
        self._records, self._pool = records, mesh_pool.MeshPool.of(records, self._most_tilt_rad)
        self.camera = camera
        self._elastic: ElasticGel | None = None
        met = camera.sensor
        if config.elastic_gel is not None:
            self._elastic = ElasticGel(config, camera.sensor)
            met = self._elastic.sensor
        self._toucher = motion.Toucher(met, config.least_height_m, num_envs, threads)
        self._met_object = np.zeros(num_envs, np.bool_)
        self._upcoming, self._sensors = np.full(num_envs, -1, np.int64), np.zeros((num_envs, 3))
        self._felt: Float32 = np.zeros((num_envs, 1, 1, camera.channels), np.float32)
        self._poses = np.tile(np.eye(4), (num_envs, 1, 1))  # of sensors, but for where they are
        width, height = config.sensor_output_size
        shape = (num_envs, height, width, camera.channels)
        self._randomization = Randomization(config, shape, camera.bases)
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

    def begin(self, rows: motion.Rows, rng: np.random.Generator, options: motion.ResetOptions) -> None:
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

    def discard_upcoming(self, rows: motion.Rows) -> None:
        """Discard the objects that were chosen for the next episodes of some cells, as a reset does."""
        self._upcoming[rows] = -1

    def _place_objects(
        self,
        rows: motion.Rows,
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
            reach_m = np.array(config.cell_size) / 2 - config.object_placement_margin
            pool = self._pool
            episode_kernels.place_objects(
                self.numbers[rows], drawn[rows], most_rad, reach_m, pool.hulls, pool.grids, placed
            )
        self.planar_poses[rows] = placed
        for row in chosen:
            pose = poses[row]
            if pose is not None:
                self.planar_poses[row] = pose

    def _aim_at_start(self, rows: motion.Rows, rng: np.random.Generator) -> None:
        """Send sensors to the positions of their first touches."""
        self._targets[rows] = 0.0
        if self.config.randomize_initial_sensor_pose:
            # Drawn for all cells, and in single precision, as published.
            positions_m = self._motion.random_positions_m(rng, self.num_envs)
            self._targets[rows, :2] = np.asarray(positions_m[rows], np.float32)

    def _aim_as_given(self, row: int, start: motion.SensorStart) -> None:
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

    def touch(self, rows: motion.Rows, rng: np.random.Generator, steps: Int64) -> scene.Readings:
        """Touch in some cells, and let their objects slip."""
        config = self.config
        self._move_to_targets(rows, rng, steps)
        drift = _NO_DRIFT
        if config.perturb_object_pose:
            # One draw for all, as published.
            slip_m = rng.normal(scale=config.translation_perturbation_scale, size=2)
            drift = np.array([*slip_m, rng.normal(scale=config.rotation_perturbation_scale)])
        has_depth = config.depth_in_info or self.camera.sees_depth or self._elastic is not None
        sensors, objects = self._sensors[rows], self.planar_poses[rows]
        draws = self._randomization.touch(len(sensors), rng)
        axes = np.ascontiguousarray(self._axes[rows])
        cells = Cells(self.numbers[rows], draws.lifts_m, axes, sensors, objects)
        touches = self._press(cells, drift, has_depth=has_depth)
        self._met_object[rows] = ~touches.is_bare
        felt: dict[str, AnyArray] = {}
        if self._elastic is not None:
            touches, felt["force"] = self._elastic.press(touches, sensors, axes, self._motion)
        if rows is not motion.EVERY:  # otherwise both are views
            self._sensors[rows], self.planar_poses[rows] = sensors, objects
        images = self.camera.pictures(touches, draws.bases)
        images = self._randomization.add_noise(images, rows, draws)
        self._keep(rows, images)
        poses: AnyArray = self._poses[rows].copy()
        poses[:, :3, 3] = sensors
        info: dict[str, AnyArray] = {"sensor_pose": poses}
        if config.depth_in_info:
            info["depth"] = touches.depths_m
        return scene.Readings({"sensor_pos": touches.positions, "sensor_img": images, **felt}, info)

    def _press(self, cells: Cells, drift: Float64, *, has_depth: bool) -> SensorReadings:
        """Press sensors onto objects, which slip by ``drift``; both are moved."""
        return self._toucher.touch(self._pool, cells, self._motion, drift, with_depth=has_depth)

    def _keep(self, rows: motion.Rows, images: Float32) -> None:
        """Keep the last images for pictures."""
        if rows is motion.EVERY:
            self._felt = images
            return
        self._felt = self._felt.copy()
        self._felt[rows] = images

    def _move_to_targets(self, rows: motion.Rows, rng: np.random.Generator, steps: Int64) -> None:
        """Move sensors to their targets, or to the nearest of some random positions."""
        self._sensors[rows] = self._targets[rows]
        if self.config.snap_touch_positions is None:
            return
        positions_m = self._motion.random_positions_m(rng, self.num_envs, self.config.snap_touch_positions)
        nearest = np.linalg.norm(positions_m - self._targets[:, None, :2], axis=2).argmin(axis=1)
        snapped = positions_m[np.arange(self.num_envs), nearest]
        if not steps.any():  # in single precision, as published
            snapped = snapped.astype(np.float32).astype(np.float64)
        self._sensors[rows, :2] = snapped[rows]

    @property
    def data_points(self) -> tuple[object, ...]:
        """Records of the objects that lie in the cells."""
        return tuple(self._records[int(number)] for number in self.numbers)

    def objects(self) -> scene.SceneObjects:
        """Describe all objects; a default set that is not made yet is made."""
        ids, labels = (self._pool.measure(name).astype(np.int64) for name in ("id", "label"))
        view = MeshView.of(self._records)
        records: object = view.records
        if isinstance(view, PlannedView):
            records = view.make_all()
        if isinstance(records, RecordDataset):
            files = list(map(content_fingerprint, records.files))
        else:
            files = list(map(_fingerprint, view.records))
        return scene.SceneObjects(ids, labels, view.label_names, files)

    @property
    def contacts(self) -> Bool | None:
        """Whether the last touch of each sensor met its object, not only the plate, (num_envs,)."""
        return self._met_object.copy()

    @property
    def object_poses(self) -> Poses:
        """Poses of the objects, metres, cell frame."""
        foot_m = self._pool.measure("foot_m")[self.numbers]
        half = self.planar_poses[:, 2] / 2
        quaternion = np.zeros((self.num_envs, 4))
        quaternion[:, 2], quaternion[:, 3] = np.sin(half), np.cos(half)
        return Poses(np.column_stack([self.planar_poses[:, :2], -foot_m]), quaternion)

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
            self.planar_poses[row],
            self._sensors[row],
            self._targets[row],
            self._felt[row],
            self.config.cell_size,
            self.camera.sensor.window_m,
            self._axes[row, :2, :2],
        )

    def close(self) -> None:
        """End the threads."""
        self._toucher.close()


def _fingerprint(record: MeshRecord) -> JsonDict:
    """Return JSON values that identify a mesh file, or a mesh in memory."""
    digest = hashlib.sha256(np.ascontiguousarray(record.vertices_m).tobytes())
    digest.update(np.ascontiguousarray(record.faces, np.int32).tobytes())
    return {"id": record.id, "label": record.label, "sha256": digest.hexdigest()}


class ElasticGel:
    """Presses an elastic gel onto the surfaces that the sensors of many environments met.

    Parameters
    ----------
    config : Config
        The gel, and the force or depth of a press.
    sensor : Sensor
        The sensor, with the size of depth images.

    Attributes
    ----------
    sensor : Sensor
        The sensor with a window that shows the whole gel.
    """

    def __init__(self, config: Config, sensor: Sensor) -> None:
        depth_m = None
        if config.press_force is None:
            depth_m = sensor.gel_m - sensor.press_m
        assert config.elastic_gel is not None, "the gel of these settings is elastic"
        load = GelLoad(config.press_force, depth_m, gel=config.elastic_gel)
        (self._load,) = loads_of(load, 1, sensor)
        self._shown, self._whole = sensor, WholeGel.of(sensor)
        self.sensor = self._whole.sensor

    def press(
        self, met: SensorReadings, sensors: Float64, axes: Float64, motion: Motion
    ) -> tuple[SensorReadings, Float32]:
        """Press onto what sensors met, depth maps of the whole gel; return what they read, and forces.

        ``sensors`` (n, 3), metres, are moved along their ``axes`` (n, 3, 3), in columns, to where the gel
        stops. Forces (n, 3), newtons, are those on the gel, in the frame of each sensor.
        """
        count, (width, height) = len(sensors), self._shown.size_px
        depths_m = np.empty((count, height, width))
        forces_n = np.empty((count, 3), np.float32)
        for row, depth_m in enumerate(met.depths_m):
            contact = self._whole.press(-depth_m.astype(np.float64), self._load, depths_m[row])
            forces_n[row] = contact.force_n
            stop_m = self._shown.gel_m - contact.depth_m
            sensors[row] += (stop_m - self._shown.press_m) * axes[row, :, 2]
        share = (sensors - motion.low_m) / (motion.high_m - motion.low_m) * 2.0 - 1.0
        readings = SensorReadings(
            self._shown.depth_image(depths_m),
            depths_m.astype(np.float32).view(GelSurface),
            np.clip(share, -1.0, 1.0).astype(np.float32),
            np.zeros(count, np.bool_),  # an elastic gel is solved for touches of the plate, too
        )
        return readings, forces_n


class TouchDraws(NamedTuple):
    """Random numbers for a touch of n sensors.

    ``lifts_m`` (n,) is added to the observed heights, metres; ``bases`` (n,) the number of
    the depth map behind its own; ``rng`` draws the noise, None where nothing is random.
    """

    lifts_m: Float64
    bases: Int64
    rng: np.random.Generator | None


class Randomization:
    """Draws heights, noise, and maps behind those of touches for many sensors.

    As published, each episode and each touch has a generator of its own, spawned from that of the
    environment, whose other draws stay as they are.

    Parameters
    ----------
    config : Config
        Settings.
    shape : tuple of int
        Shape (n, H, W, C) of the images of all sensors.
    bases : int
        Number of depth maps, of which one lies behind that of each touch; 0 for none.
    """

    def __init__(self, config: Config, shape: tuple[int, int, int, int], bases: int) -> None:
        self._std_m = config.penetration_depth_reduction_std
        self._bases = bases
        self._most_m = config.gel_thickness - config.penetration_depth
        self._noise: EpisodeNoise | None = None
        if config.sensor_noise is not None:
            self._noise = EpisodeNoise(config.sensor_noise, shape)
        # Shared by all touches: nothing writes to it.
        self._nothing = TouchDraws(np.zeros(shape[0]), np.zeros(shape[0], np.int64), None)
        self._is_random = bool(self._std_m or bases or self._noise is not None)

    def begin(self, rows: Rows, rng: np.random.Generator) -> None:
        """Draw the values that are constant during an episode of some sensors."""
        if not self._is_random:
            return
        own = rng.spawn(1)[0]
        if self._noise is not None:
            self._noise.begin(rows, own)

    def touch(self, count: int, rng: np.random.Generator) -> TouchDraws:
        """Draw the values that differ from touch to touch, for ``count`` sensors."""
        if not self._is_random and count == len(self._nothing.bases):
            return self._nothing
        draws = TouchDraws(self._nothing.lifts_m[:count], self._nothing.bases[:count], None)
        if not self._is_random:
            return draws
        own = rng.spawn(1)[0]
        if self._std_m:
            lifts_m = np.abs(own.normal(scale=self._std_m, size=count))
            draws = draws._replace(lifts_m=np.minimum(lifts_m, self._most_m))
        if self._bases:
            # From another generator, so that the noise is as published.
            draws = draws._replace(bases=own.spawn(1)[0].integers(self._bases, size=count))
        return draws._replace(rng=own)

    def add_noise(self, images: Float32, rows: Rows, draws: TouchDraws) -> Float32:
        """Return images of some sensors, (n, H, W, C), with noise; works in place."""
        if self._noise is None or draws.rng is None:
            return images
        return self._noise.add(images, rows, draws.rng)
