"""The numbers of a stored round: all that touches and clips read beside pictures.

T is the number of touches of the round, N_i the number of frames of touch i. Poses are checked here; counts
and times where they come from, in :mod:`realtouch.columns.per_touch` and :mod:`realtouch.columns.per_frame`.
"""

from __future__ import annotations

import math
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from realtouch.columns.per_frame import (
    clip_length,
    clip_lengths,
    clip_times,
    cut,
    cut_touch,
    frame_times,
    padded_times,
    times_of_touches,
    touch_durations,
    touch_times,
)
from realtouch.columns.per_touch import (
    column_of,
    media_count,
    per_touch,
    require_count,
    touch_count,
    touch_total,
    vector_of,
    vectors,
)
from realtouch.integrity.damage import damaged
from realtouch.poses import Poses, PoseSequences, bad_pose, rigid_transform
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.touch.schema import PLATE_COLUMN, Kind

if TYPE_CHECKING:
    from realtouch.poses import Pose

__all__ = [
    "clip_length",
    "clip_lengths",
    "clip_poses",
    "clip_times",
    "column_of",
    "contact_z_m",
    "frame_times",
    "known_contact_z_m",
    "media_count",
    "padded_times",
    "per_touch",
    "plate_z_m",
    "pose_sequences",
    "poses",
    "times_of_touches",
    "touch_contact_z_m",
    "touch_count",
    "touch_durations",
    "touch_pose",
    "touch_times",
    "touch_total",
    "vector_of",
    "vectors",
]

_POSE = "gel_pose_cell_frame"
_POSE_SEQUENCE = "gel_pose_cell_frame_seq"


def poses(row: Row) -> Poses:
    """Return the pose of the gel in each touch of a ``single`` round, T poses.

    Raises
    ------
    IntegrityError
        A position or quaternion is missing, not finite or of length zero; names the touch.
    """
    positions, quaternions = vectors(row, f"{_POSE}.position", 3), vectors(row, f"{_POSE}.quaternion", 4)
    _require_poses(row, _POSE, positions, quaternions)
    return Poses(positions, quaternions)


def touch_pose(row: Row, touch: int) -> Pose:
    """Return the pose of the gel in one touch of a ``single`` round; looks at no other touch.

    Raises
    ------
    IntegrityError
        As :func:`poses`, of this touch.
    """
    position = vector_of(row, f"{_POSE}.position", touch, 3)
    quaternion = vector_of(row, f"{_POSE}.quaternion", touch, 4)
    wrong = bad_pose(position[None], quaternion[None])
    if wrong is not None:
        raise damaged(row, _POSE, wrong[1], touch)
    return rigid_transform(position, quaternion)


def pose_sequences(row: Row) -> PoseSequences:
    """Return the pose of the gel in each frame of each touch of a ``seq`` round, padding cut off.

    Raises
    ------
    IntegrityError
        As :func:`poses`, or a touch has fewer poses than frames.
    """
    positions, quaternions = (
        cut(row, f"{_POSE_SEQUENCE}.{part}", width) for part, width in (("position", 3), ("quaternion", 4))
    )
    joined_positions, joined_quaternions = (
        np.concatenate(part or (np.empty((0, 1)),)) for part in (positions, quaternions)
    )
    if bad_pose(joined_positions, joined_quaternions) is not None:
        for touch, (position, quaternion) in enumerate(zip(positions, quaternions, strict=True)):
            _require_poses(row, _POSE_SEQUENCE, position, quaternion, touch)
    return PoseSequences(positions, quaternions)


def clip_poses(row: Row, touch: int) -> Poses:
    """Return the poses of one touch of a ``seq`` round, N_i poses; see :func:`pose_sequences`."""
    length = clip_length(row, touch)
    parts = [
        _frames_of(row, f"{_POSE_SEQUENCE}.{part}", touch, length, width)
        for part, width in (("position", 3), ("quaternion", 4))
    ]
    _require_poses(row, _POSE_SEQUENCE, parts[0], parts[1], touch)
    return Poses(parts[0], parts[1])


def contact_z_m(row: Row, kind: Kind) -> NDArray[np.float64]:
    """Return the height of the gel at the deepest press of each touch, shape (T,), metres, cell frame.

    Parameters
    ----------
    row : Row
        A round; of a ``single`` one, the height of its one pose per touch is taken.
    kind : "seq" or "single"
        What it holds.

    Raises
    ------
    IntegrityError
        A height is missing or not finite; names the touch.
    """
    if kind == "seq":
        name = f"{_POSE_SEQUENCE}.position"
        heights = np.array([touch[:, 2].min(initial=np.inf) for touch in cut(row, name, 3)])
    else:
        name = f"{_POSE}.position"
        heights = vectors(row, name, 3)[:, 2].astype(np.float64)
    wrong = np.flatnonzero(~np.isfinite(heights))
    if len(wrong):
        raise _no_height(row, name, int(wrong[0]), float(heights[wrong[0]]))
    return heights


def plate_z_m(row: Row) -> float:
    """Return the stored height of the plate in a round, metres, cell frame; not a number without one."""
    stored = row.value(PLATE_COLUMN) if row.has(PLATE_COLUMN) else None
    return math.nan if stored is None else float(stored)


def touch_contact_z_m(row: Row, kind: Kind, touch: int) -> float:
    """Return what :func:`contact_z_m` says of one touch, looking at no other."""
    if kind == "seq":
        name = f"{_POSE_SEQUENCE}.position"
        frames = _frames_of(row, name, touch, clip_length(row, touch), 3)
        height = float(frames[:, 2].min(initial=np.inf))
    else:
        name = f"{_POSE}.position"
        height = float(vector_of(row, name, touch, 3)[2])
    if not np.isfinite(height):
        raise _no_height(row, name, touch, height)
    return height


def known_contact_z_m(row: Row, kind: Kind) -> NDArray[np.float64]:
    """Return what :func:`contact_z_m` says of each touch; not a number where it cannot be read."""
    try:
        return contact_z_m(row, kind)
    except IntegrityError:
        heights = np.full(touch_total(row), np.nan)
    for touch in range(len(heights)):
        with suppress(IntegrityError):
            heights[touch] = touch_contact_z_m(row, kind, touch)
    return heights


def _frames_of(row: Row, name: str, touch: int, length: int | None, width: int) -> NDArray[Any]:
    require_count(row, name, touch_count(row, name))  # else the next row would be read for what is lacking
    return cut_touch(row, name, touch, length, width)


def _no_height(row: Row, name: str, touch: int, height: float) -> IntegrityError:
    return damaged(row, name, f"a gel height of {height}; expected metres", touch)


def _require_poses(
    row: Row, name: str, positions: NDArray[Any], quaternions: NDArray[Any], touch: int | None = None
) -> None:
    wrong = bad_pose(positions, quaternions)
    if wrong is not None:
        index, problem = wrong
        where = problem if touch is None else f"frame {index}: {problem}"
        raise damaged(row, name, where, index if touch is None else touch)
