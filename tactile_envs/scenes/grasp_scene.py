"""Scenes of grasps: digits between two gels, which are lifted while their mass is unknown.

Needs the extra ``mujoco``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import ap_gym
import gymnasium as gym
import numpy as np
from scipy.spatial.transform import Rotation

from realtouch import Poses
from tactile_envs import motion, object_sets, tasks
from tactile_envs.config import GRIP, Action, GraspConfig
from tactile_envs.drawing import EnvDrawing
from tactile_envs.scenes import mesh_scene, scene
from tactile_envs.touch_kernels import SensorReadings
from tactile_sim.elastic.contact import Gel, GelSurface
from tactile_sim.hand import STEP_S, Hand
from tactile_sim.sets.grasp_options import MAX_SLIDE_M
from tactile_sim.sets.grasps import CLOSED_S, LIFT_M, drawn_pose
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh
from tactile_toolkit.value_types import AnyArray, Bool, Float32, Float64, Int64

STEPS = 10
"""Steps of the simulation in a step of the environment, 20 ms."""
START_N, LEAST_N, MOST_N = 0.5, 0.1, 4.0
"""Force of each finger at the start of an episode, and its limits, newtons."""
GRIP_STEP_N = 0.25
"""Greatest change of the force in a step, newtons."""
COST_PER_N = 0.1
"""Cost of a step for each newton of grip; a step in which the digit is not held costs 1."""
_LOADED = 0.75  # of an episode: then the support is gone


class Lift(NamedTuple):
    """A hand, the mass of its digit, and the pose of that in the frame of the left gel as this closed."""

    hand: Hand
    mass_kg: float
    closed: Float64

    @property
    def is_held(self) -> bool:
        """Whether both gels touch the digit, which has not slipped."""
        gel = self.hand.gels[0]
        moved_m = (np.linalg.inv(gel.pose) @ self.hand.solid_pose @ np.linalg.inv(self.closed))[:2, 3]
        return self.hand.is_holding and math.hypot(*moved_m) < MAX_SLIDE_M


class GraspScene(mesh_scene.MeshScene):
    """Digits that hang between two gels, below the point where these have gripped them.

    Parameters are those of :class:`~tactile_envs.scenes.mesh_scene.MeshScene`.
    """

    config: GraspConfig

    def __init__(
        self,
        config: GraspConfig,
        records: object_sets.Objects,
        num_envs: int,
        threads: int,
        camera: scene.Camera,
    ) -> None:
        super().__init__(config, records, num_envs, threads, camera)
        width, height = config.sensor_output_size
        most = np.full(3, np.inf, np.float32)
        self.action_parts = {GRIP: gym.spaces.Box(-1.0, 1.0, (1,))}
        self.observation_parts = {
            "sensor_img": ap_gym.ImageSpace(2 * width, height, camera.channels, dtype=np.float32),
            "force": gym.spaces.Box(-most, most),
        }
        self._lifts: dict[int, Lift] = {}
        self.grips_n = np.zeros(num_envs)
        self._shares = np.zeros(num_envs)

    def begin(self, rows: motion.Rows, rng: np.random.Generator, options: motion.ResetOptions) -> None:
        """Put the next digits between some fingers, and close these."""
        if any(value is not None for value in (*options.poses, *options.starts)):
            raise InputError("poses of digits and sensors are drawn; expected no such option of reset()")
        super().begin(rows, rng, options)
        low_kg, high_kg = self.config.mass_kg
        for row in np.arange(self.num_envs)[rows].tolist():
            record = self._records[int(self.numbers[row])]
            digit = Mesh(record.vertices_m, record.faces)
            mass_kg = float(rng.uniform(low_kg, high_kg))
            pose = drawn_pose(digit, rng, hangs=True)
            hand = Hand(digit, pose, mass_kg, self.camera.sensor, Gel(friction=self.config.friction))
            for _ in range(round(CLOSED_S / STEP_S)):
                hand.move(START_N, 0.0, 1.0)
            self._lifts[row] = Lift(hand, mass_kg, np.linalg.inv(hand.gels[0].pose) @ hand.solid_pose)
            self.grips_n[row], self._shares[row] = START_N, 0.0

    def checked_action(self, action: Action) -> Action:
        """Return the arrays of an action of all hands; InputError or ValueError if it cannot be used."""
        return {GRIP: motion.require_move(action, GRIP, self.num_envs, 1)}

    def aim(self, action: Action, rows: motion.Rows) -> Float32:
        """Change grips, and lift some hands for 20 ms; return the costs, (num_envs,)."""
        costs = np.zeros(self.num_envs, np.float32)
        changes = np.clip(action[GRIP][:, 0].astype(np.float64), -1.0, 1.0)
        loads = _LOADED * self.config.step_limit * STEPS
        for row in np.arange(self.num_envs)[rows].tolist():
            lift = self._lifts[row]
            self.grips_n[row] = np.clip(self.grips_n[row] + GRIP_STEP_N * changes[row], LEAST_N, MOST_N)
            for _ in range(STEPS):
                self._shares[row] = min(self._shares[row] + 1.0 / loads, 1.0)
                if lift.hand.is_holding:  # a digit that was lost stays where it was
                    share = float(self._shares[row])
                    lift.hand.move(float(self.grips_n[row]), LIFT_M * share, 1.0 - share)
            regularization = self.config.action_regularization * changes[row] ** 2
            costs[row] = -regularization - COST_PER_N * self.grips_n[row] - (not lift.is_held)
        return costs

    def touch(self, rows: motion.Rows, rng: np.random.Generator, steps: Int64) -> scene.Readings:
        """Show what the gels of some hands feel."""
        lifts = [self._lifts[row] for row in np.arange(self.num_envs)[rows].tolist()]
        gels = [gel for lift in lifts for gel in lift.hand.gels]
        depths_m: Float64 = np.array([gel.depth_m for gel in gels])
        readings = SensorReadings(
            self.camera.sensor.depth_image(depths_m),
            depths_m.astype(np.float32).view(GelSurface),
            np.zeros((len(gels), 3), np.float32),
            np.zeros(len(gels), np.bool_),
        )
        images = self.camera.pictures(readings, np.zeros(len(gels), np.int64))
        images = np.concatenate([images[::2], images[1::2]], axis=2)
        forces = np.array([gel.wrench[:3] for gel in gels]).reshape(-1, 2, 3)
        bearing = np.hypot(forces[..., 0], forces[..., 1]).argmax(axis=1)
        felt = {"sensor_img": images, "force": forces[np.arange(len(forces)), bearing].astype(np.float32)}
        self._keep(rows, images)
        poses = np.array([lift.hand.solid_pose for lift in lifts])
        turns_rad = np.arctan2(poses[:, 2, 0], poses[:, 1, 0])
        self.planar_poses[rows] = np.column_stack([poses[:, 1:3, 3], turns_rad])
        return scene.Readings(felt, {"sensor_pose": np.array([lift.hand.gels[0].pose for lift in lifts])})

    @property
    def masses_kg(self) -> Float64:
        """Masses of the digits, (num_envs,), kilograms."""
        return np.array([self._lifts[row].mass_kg for row in range(self.num_envs)])

    @property
    def contacts(self) -> Bool | None:
        """Whether both gels of each hand touch the digit, (num_envs,)."""
        return np.array([self._lifts[row].hand.is_holding for row in range(self.num_envs)])

    @property
    def is_held(self) -> Bool:
        """Whether each digit is held and has not slipped, (num_envs,)."""
        return np.array([self._lifts[row].is_held for row in range(self.num_envs)])

    @property
    def object_poses(self) -> Poses:
        """Poses of the digits, metres; the origin is between the fingers as they close, z is up."""
        return _poses([self._lifts[row].hand.solid_pose for row in range(self.num_envs)])

    @property
    def target_poses(self) -> Poses:
        """Poses of the left gels, metres."""
        return _poses([self._lifts[row].hand.gels[0].pose for row in range(self.num_envs)])

    def drawing(self, row: int) -> EnvDrawing:
        """Return the content of a picture of one hand: the digit from the side, and the frame of the gels."""
        hand_m = np.array([0.0, self._lifts[row].hand.gels[0].pose[2, 3], 1.0])
        return EnvDrawing(
            self._pool,
            int(self.numbers[row]),
            self.planar_poses[row],
            hand_m,
            hand_m,
            self._felt[row],
            self.config.cell_size,
            self.camera.sensor.window_m,
        )


def _poses(matrices: list[Float64]) -> Poses:
    poses = np.array(matrices)
    return Poses(poses[:, :3, 3], Rotation.from_matrix(poses[:, :3, :3]).as_quat())


class LiftedMass(tasks.Regression):
    """Mass of a digit, in standard deviations from the mean of all; metrics also state whether it is held."""

    def __init__(self, lifted: GraspScene) -> None:
        self._scene = lifted
        low_kg, high_kg = lifted.config.mass_kg
        self._mean_kg, self._std_kg = (low_kg + high_kg) / 2, (high_kg - low_kg) / math.sqrt(12.0)
        super().__init__(gym.spaces.Box(-math.sqrt(3.0), math.sqrt(3.0), (1,)), 1.0)

    def targets(self, chosen: Int64, objects: Float64) -> Float64:
        """Return normalized masses, shape (n, 1)."""
        return ((self._scene.masses_kg - self._mean_kg) / self._std_kg)[:, None]

    def other_metrics(self, predictions: AnyArray, targets: AnyArray) -> dict[str, AnyArray]:
        """Return whether digits are held, the force of each finger in newtons, and the error in grams."""
        error_g = np.abs(targets - predictions)[:, 0] * self._std_kg * 1e3
        held = self._scene.is_held.astype(np.float32)
        return {"held": held, "grip_n": self._scene.grips_n.copy(), "abs_error_g": error_g}
