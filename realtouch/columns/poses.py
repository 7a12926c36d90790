"""The poses of a stored round, checked, and the heights at which the gel stopped.

T is the number of touches of the round, N_i the number of frames of touch i.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from realtouch.columns.per_frame import clip_length, cut, cut_touch
from realtouch.columns.per_touch import readable, vectors
from realtouch.damage import damaged
from realtouch.poses import Poses, PoseSequences, bad_pose
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.touch.contact import PLATE_COLUMN, PRESS_DEPTH_M, ContactHeight
from tactile_toolkit.touch.schema import POSE_COLUMN, Kind

if TYPE_CHECKING:
    from realtouch.pose import Pose


_POSE, _POSE_SEQUENCE = POSE_COLUMN["single"], POSE_COLUMN["seq"]


def poses(row: Row, touch: int | None = None) -> Poses:
    """Return the pose of the gel in each touch of a ``single`` round, T poses, or that of one alone.

    Raises IntegrityError, which names the touch, for a position or quaternion that is missing, not finite or
    of length zero.
    """
    positions = vectors(row, f"{_POSE}.position", 3, touch)
    quaternions = vectors(row, f"{_POSE}.quaternion", 4, touch)
    wrong = bad_pose(positions, quaternions)
    if wrong is not None:
        raise damaged(row, _POSE, wrong[1], (touch or 0) + wrong[0])
    return Poses(positions, quaternions)


def touch_pose(row: Row, touch: int) -> Pose:
    """Return the pose of the gel in one touch of a ``single`` round; looks at no other."""
    return poses(row, touch)[0]


def pose_sequences(row: Row) -> PoseSequences:
    """Return the pose of the gel in each frame of each touch of a ``seq`` round, padding cut off.

    Raises IntegrityError as :func:`poses`, and where a touch has fewer poses than frames.
    """
    positions = cut(row, f"{_POSE_SEQUENCE}.position", 3)
    quaternions = cut(row, f"{_POSE_SEQUENCE}.quaternion", 4)
    # Checked in one go; touch by touch only to find which one is wrong.
    if positions and bad_pose(np.concatenate(positions), np.concatenate(quaternions)) is not None:
        for touch, (position, quaternion) in enumerate(zip(positions, quaternions, strict=True)):
            _require_frames(row, touch, position, quaternion)
    return PoseSequences(positions, quaternions)


def clip_poses(row: Row, touch: int) -> Poses:
    """Return the poses of one touch of a ``seq`` round, N_i poses; see :func:`pose_sequences`."""
    length = clip_length(row, touch)
    position = cut_touch(row, f"{_POSE_SEQUENCE}.position", touch, length, 3)
    quaternion = cut_touch(row, f"{_POSE_SEQUENCE}.quaternion", touch, length, 4)
    _require_frames(row, touch, position, quaternion)
    return Poses(position, quaternion)


def _require_frames(row: Row, touch: int, position: NDArray[Any], quaternion: NDArray[Any]) -> None:
    wrong = bad_pose(position, quaternion)
    if wrong is not None:
        frame, problem = wrong
        raise damaged(row, _POSE_SEQUENCE, f"frame {frame}: {problem}", touch)


def contact_z_m(row: Row, kind: Kind, touch: int | None = None) -> NDArray[np.float64]:
    """Return the height of the gel at the deepest press of each touch, shape (T,), or of one alone, (1,).

    Metres, cell frame; of a ``single`` round, that is the height of its one pose per touch. Raises
    IntegrityError, which names the touch, for a height that is missing or not finite.
    """
    name = f"{POSE_COLUMN[kind]}.position"
    if kind == "single":
        heights = vectors(row, name, 3, touch)[:, 2].astype(np.float64)
    else:
        one = None if touch is None else cut_touch(row, name, touch, clip_length(row, touch), 3)
        frames = cut(row, name, 3) if one is None else (one,)
        # A clip without frames has no height: infinity is refused below.
        heights = np.array([each[:, 2].min(initial=np.inf) for each in frames])
    finite = np.isfinite(heights)
    if not finite.all():
        wrong = int(np.argmin(finite))
        problem = f"a gel height of {heights[wrong]}; expected metres"
        raise damaged(row, name, problem, (touch or 0) + wrong)
    return heights


def touch_contact_z_m(row: Row, kind: Kind, touch: int) -> float:
    """Return what :func:`contact_z_m` says of one touch, looking at no other."""
    return float(contact_z_m(row, kind, touch)[0])


def known_contact_z_m(row: Row, kind: Kind) -> NDArray[np.float64]:
    """Return what :func:`contact_z_m` says of each touch; NaN where it cannot be read."""
    return readable(row, lambda row, touch: contact_z_m(row, kind, touch))


def plate_z_m(row: Row) -> float:
    """Return the known or stored height of the plate in a round, metres, cell frame; NaN without one."""
    if ContactHeight.of(row.group.names).plate == "known":
        return PRESS_DEPTH_M
    stored = row.value(PLATE_COLUMN) if row.has(PLATE_COLUMN) else None
    return math.nan if stored is None else float(stored)
