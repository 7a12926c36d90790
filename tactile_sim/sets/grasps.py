"""Data sets of lift attempts: a solid between two gels, which hold it or let it slip.

Needs the extra ``mujoco``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation

from tactile_sim.elastic.contact import ElasticContact, GelSurface
from tactile_sim.hand import STEP_S, UPRIGHT, Hand
from tactile_sim.press.pressable import Pressable
from tactile_sim.press.pressing import Pressed, inverse_times
from tactile_sim.sets import round_press
from tactile_sim.sets.generation import SyntheticRound, TouchGenerator, encoded_images, synthetic_schema
from tactile_sim.sets.grasp_options import MAX_SLIDE_M, MAX_TURN_DEG, MOMENTS_S, GraspSpec
from tactile_sim.sets.round_plan import keyed_rng
from tactile_toolkit.errors import ItemError
from tactile_toolkit.mesh import Mesh, MeshLike
from tactile_toolkit.value_types import Float64, JsonDict

RESULTS = ("slip", "hold")
"""Names of the classes of an attempt."""
CLOSED_S, LIFTED_S, LIFT_M = 0.1, 0.4, 0.01
"""When the grip is closed and the hand begins to rise, when it is up, seconds, and how high, metres."""
_FLAT = 0.99  # cosine of the greatest slope of a face to grip
_TYPES: Mapping[str, pa.DataType] = {
    "extra.finger": pa.list_(pa.int64()),
    "extra.time_s": pa.list_(pa.float32()),
    "extra.in_contact": pa.list_(pa.bool_()),
    "extra.mass_kg": pa.list_(pa.float32()),
    "extra.friction": pa.list_(pa.float32()),
    "extra.grip_n": pa.list_(pa.float32()),
}


def _flat_areas(solid: Mesh) -> Float64:
    """Return the area of each face on the flat upper side of a solid, square metres; 0 of other faces.

    ItemError if there are none.
    """
    corners_m = solid.vertices_m[solid.faces]
    normals = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0]) / 2
    areas_m2 = np.where(normals[:, 2] > _FLAT * np.linalg.norm(normals, axis=1), normals[:, 2], 0.0)
    if not areas_m2.any():
        raise ItemError(
            "not-flat", "nothing of its upper side is flat; expected a face to grip, as of a digit"
        )
    return areas_m2


def drawn_pose(solid: Mesh, rng: np.random.Generator, *, hangs: bool = False) -> Float64:
    """Return a pose (4, 4) of a flat solid between two fingers that close along x.

    It stands upright at a random angle, or ``hangs`` with its middle below them; its middle plane is between
    them, and the point between them is uniform on its flat upper side. ItemError if it has none.
    """
    areas = np.cumsum(_flat_areas(solid))
    angle_rad, share = (2 * math.pi, areas[-1]) * rng.random(2)
    face = int(np.searchsorted(areas, share))
    point_m = rng.dirichlet(np.ones(3)) @ solid.vertices_m[solid.faces[face]]
    point_m[2] = (solid.vertices_m[:, 2].min() + solid.vertices_m[:, 2].max()) / 2
    if hangs:
        arm_m = solid.vertices_m.mean(axis=0) - point_m
        angle_rad = -math.pi / 2 - math.atan2(arm_m[1], arm_m[0])
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("x", angle_rad).as_matrix() @ UPRIGHT
    pose[:3, 3] = -pose[:3, :3] @ point_m
    return pose


class GelFrame(NamedTuple):
    """What one gel shows at one moment of an attempt; poses (4, 4) are in the frame of the world."""

    time_s: float
    finger: int
    depth_m: Float64
    contact: ElasticContact
    gel_pose: Float64
    solid_pose: Float64


def lift(hand: Hand, grip_n: float) -> Iterator[GelFrame]:
    """Close a hand, lift it, and yield what its gels show at :data:`MOMENTS_S`.

    The support yields as the hand rises. After a gel has lost the solid, nothing moves any more.
    """
    step, is_lost = 0, False
    for moment_s in MOMENTS_S:
        while step * STEP_S < moment_s - STEP_S / 2 and not is_lost:
            time_s = step * STEP_S
            lifted = min(max(time_s - CLOSED_S, 0.0) / (LIFTED_S - CLOSED_S), 1.0)
            hand.move(grip_n, LIFT_M * lifted, 1.0 - lifted)
            step += 1
            is_lost = time_s > CLOSED_S and not hand.is_holding
        for finger, gel in enumerate(hand.gels):
            yield GelFrame(moment_s, finger, gel.depth_m, gel.contact, gel.pose, hand.solid_pose)


@dataclass(frozen=True)
class GraspGenerator(TouchGenerator):
    """Makes lift attempts: a row is an attempt, its touches are what the gels show at some moments."""

    spec: GraspSpec
    operation: ClassVar[str] = "grasp"

    def schema(self, split: str) -> pa.Schema:
        """Return the Arrow schema of a shard."""
        types = {**round_press.further_types(self.spec), **_TYPES}
        del types["plate_z_m"]  # there is no plate
        return synthetic_schema(RESULTS, types)

    def prepare(self, solid: MeshLike) -> Pressable:
        """Return a solid in the form that is lifted; InputError if there is nothing to grip."""
        _flat_areas(Mesh.of(solid))
        return super().prepare(solid)

    def make_round(self, solid: Pressable, key: tuple[str, int, int], label: int) -> SyntheticRound:
        """Make the row of an attempt; ``key`` is its split, object and number. The label is its result."""
        spec, sensor = self.spec, round_press.depth_sensor(self.spec)
        rng = keyed_rng(spec.seed, *key, "grasp")
        spans = np.array([spec.force_n, spec.mass_kg, spec.friction])
        grip_n, mass_kg, friction = (spans[:, 0] + rng.random(3) * np.ptp(spans, axis=1)).tolist()
        body = Mesh(solid.vertices_m, solid.faces)
        hand = Hand(body, drawn_pose(body, rng), mass_kg, sensor, spec.gel(friction))
        frames = [frame for frame in lift(hand, grip_n) if frame.finger < spec.fingers]
        gel_poses, solid_poses = (
            np.array([getattr(frame, name) for frame in frames]) for name in ("gel_pose", "solid_pose")
        )
        poses = inverse_times(gel_poses, solid_poses).reshape(len(MOMENTS_S), spec.fingers, 4, 4)
        motions = (poses @ np.linalg.inv(poses[MOMENTS_S.index(CLOSED_S)])).reshape(-1, 4, 4)
        slides_m, turns_rad = motions[:, :2, 3], np.arctan2(motions[:, 1, 0], motions[:, 0, 0])
        is_still = np.hypot(*slides_m[-1]) < MAX_SLIDE_M and abs(turns_rad[-1]) < math.radians(MAX_TURN_DEG)
        depth_m: Float64 = np.array([frame.depth_m for frame in frames])
        contacts = tuple(frame.contact for frame in frames)
        pressed = Pressed(depth_m.view(GelSurface), sensor.depth_image(depth_m), gel_poses[:, 2, 3], contacts)
        assert spec.press is not None
        motion = slides_m, turns_rad
        felt: JsonDict = round_press.elastic_values(spec.press, pressed, motion, sensor, spec.size_px)
        facts = {"mass_kg": mass_kg, "friction": friction, "grip_n": grip_n}
        further: JsonDict = {name: np.full(len(frames), value, np.float32) for name, value in facts.items()}
        quaternions = Rotation.from_matrix(solid_poses[:, :3, :3]).as_quat(canonical=True)
        return SyntheticRound(
            id=f"{key[1]}-{key[2]}",
            label=int(is_still and hand.is_holding),
            object_id=key[1],
            moved_position_m=solid_poses[:, :3, 3],
            moved_quaternion=quaternions,
            positions_m=gel_poses[:, :2, 3],
            gel_position_m=gel_poses[:, :3, 3],
            gel_quaternion=Rotation.from_matrix(gel_poses[:, :3, :3]).as_quat(canonical=True),
            images=encoded_images(spec, round_press.images_of_round(spec, pressed, sensor, key)),
            object_position_m=solid_poses[:, :3, 3],
            object_quaternion=quaternions,
            finger=np.array([frame.finger for frame in frames]),
            time_s=np.array([frame.time_s for frame in frames], np.float32),
            in_contact=felt["force_n"][:, 2] > 0.0,
            **further,
            **felt,
        )

    def statistics(self, rows: Sequence[SyntheticRound]) -> Mapping[str, int]:
        """Count the touches, those with contact, and the attempts that held."""
        return {
            "touches": sum(len(row.images) for row in rows),
            "on_object": sum(int(np.sum(row.in_contact)) for row in rows if row.in_contact is not None),
            "held": sum(row.label for row in rows),
        }
