"""Poses of the gel: numpy views for speed, rigid transforms for geometry."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tactile_toolkit import read, wording
from tactile_toolkit.value_types import AnyArray, Float64, Floating

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

    from realtouch.touches.pose import Pose


# How far the length of a quaternion may be from one; other data, such as joint angles, fail this.
_LENGTH_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Poses(read.LazySequence["Pose", "Poses"]):
    """Poses of one frame in another: a sequence of rigid transforms, stored as arrays.

    ``translation``, ``rotation``, ``quaternion``, ``matrix``, ``rotvec``, ``angle``, ``inv``, ``single`` and
    ``to_dict`` are those of the published type (package `transformation3d`).

    Frame of the gel poses: metres in the cell frame, origin at the cell centre, x right of the robot, y away
    from it, z up.

    Attributes
    ----------
    position_m : ndarray, shape (n, 3)
        Positions, metres; a read-only view of the stored values in their stored precision.
    quaternion : ndarray, shape (n, 4)
        Orientations x, y, z, w, of length one within 0.001; a view likewise.
    """

    thing = "pose"
    things = "poses"

    position_m: Floating
    quaternion: Floating

    def __len__(self) -> int:
        return len(self.position_m)

    def _item(self, index: int) -> Pose:
        return rigid_transform(self.position_m[index], self.quaternion[index])

    def _several(self, index: Any) -> Poses:
        return Poses(self.position_m[index], self.quaternion[index])

    def __iter__(self) -> Iterator[Pose]:
        return (self[index] for index in range(len(self)))

    @property
    def transform(self) -> Pose:
        """All poses as one rigid transform of length n, for vectorised geometry."""
        return rigid_transform(self.position_m, self.quaternion)

    @property
    def translation(self) -> Floating:
        """Positions, shape (n, 3), metres; the name that rigid transforms use."""
        return self.position_m

    @property
    def rotation(self) -> Rotation:
        """All orientations as one rotation of length n."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_quat(np.array(self.quaternion))

    @property
    def matrix(self) -> Float64:
        """Homogeneous matrices, shape (n, 4, 4)."""
        return self.transform.matrix

    @property
    def rotvec(self) -> Float64:
        """Orientations as axis times angle, radians, shape (n, 3)."""
        return self.transform.rotvec

    @property
    def angle(self) -> Float64:
        """Angles of the rotations, radians, shape (n,), 0 to pi."""
        return self.transform.angle

    @property
    def inv(self) -> Poses:
        """Inverse of each pose."""
        back = self.rotation.inv()
        return Poses(-back.apply(np.array(self.position_m)), back.as_quat())  # scipy takes no read-only view

    @property
    def single(self) -> bool:
        """False: there are several, even where there happens to be one."""
        return False

    def to_dict(self) -> dict[str, list[object]]:
        """Return ``translation`` and ``rotation`` (x, y, z, w) as lists."""
        return self.transform.to_dict()

    def __repr__(self) -> str:
        return f"Poses({len(self)})"


@dataclass(frozen=True, slots=True, eq=False)
class PoseSequences(read.LazySequence[Poses, "PoseSequences"]):
    """Poses over time: one :class:`Poses` per touch, as long as its clip.

    Attributes
    ----------
    position_m : tuple of T ndarrays, shapes (N_i, 3)
        Positions, metres, cell frame; read-only views.
    quaternion : tuple of T ndarrays, shapes (N_i, 4)
        Orientations x, y, z, w; views likewise.
    """

    thing = "touch"
    things = "touches"

    position_m: tuple[Floating, ...]
    quaternion: tuple[Floating, ...]

    def __len__(self) -> int:
        return len(self.position_m)

    def _item(self, index: int) -> Poses:
        return Poses(self.position_m[index], self.quaternion[index])

    def _several(self, index: Any) -> PoseSequences:
        touches = self.checked_indices(index)
        positions = (self.position_m[touch] for touch in touches)
        return PoseSequences(tuple(positions), tuple(self.quaternion[touch] for touch in touches))

    def __repr__(self) -> str:
        poses = wording.with_count(sum(map(len, self.position_m)), "poses")
        return f"PoseSequences({wording.with_count(len(self), 'touches')}, {poses})"


def rigid_transform(position_m: AnyArray, quaternion: AnyArray) -> Pose:
    """Make rigid transforms of positions (..., 3) in metres and quaternions (..., 4) x, y, z, w."""
    from realtouch.touches.pose import Pose  # scipy.spatial, which takes long to import

    return Pose.of(position_m, quaternion)


def bad_pose(position_m: AnyArray, quaternion: AnyArray) -> tuple[int, str] | None:
    """Return the index of the first of n rows that is not a pose, and its problem; None if all are poses."""
    squares = np.einsum("ij,ij->i", quaternion, quaternion)
    with np.errstate(invalid="ignore", over="ignore"):  # infinite values of both signs add up to NaN
        # The sum is finite only if all values are, and is ten times as fast to check.
        is_finite = np.isfinite(position_m.sum())
        unit = np.abs(squares - 1) <= 2 * _LENGTH_TOLERANCE  # False for NaN
    if is_finite and unit.all():
        return None
    finite = np.isfinite(position_m).all(axis=1) & np.isfinite(squares)
    wrong = np.flatnonzero(~finite | ~unit)
    if len(wrong) == 0:
        return None
    index = int(wrong[0])
    if not finite[index]:
        return index, (
            f"a pose that is not finite: position {position_m[index]}, quaternion {quaternion[index]}"
        )
    return index, f"a quaternion of length {float(np.sqrt(squares[index])):.4g}; expected length one"


def pose_of(position_m: object, quaternion: object) -> Pose | Poses:
    """Make the pose of a stored position and quaternion, or the poses of lists of them.

    Raises ValueError for anything other than one or several poses.
    """
    try:
        positions = np.asarray(position_m, np.float64)
        quaternions = np.asarray(quaternion, np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(
            "values that are not numbers, or vectors of several lengths; expected a pose's numbers"
        ) from error
    outer = positions.shape[:-1]
    if len(outer) > 1 or positions.shape != (*outer, 3) or quaternions.shape != (*outer, 4):
        raise ValueError(
            f"position {positions.shape} and quaternion {quaternions.shape}; "
            "expected (3,) and (4,), or (n, 3) and (n, 4)"
        )
    wrong = bad_pose(positions.reshape(-1, 3), quaternions.reshape(-1, 4))
    if wrong is not None:  # one invalid pose makes the metadata of the round unreadable
        raise ValueError(f"pose {wrong[0]}: {wrong[1]}" if outer else wrong[1])
    return Poses(positions, quaternions) if outer else rigid_transform(positions, quaternions)
