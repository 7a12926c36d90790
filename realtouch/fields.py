"""The numbers of a stored round: all that touches and clips read beside pictures.

T is the number of touches of the round, N_i the number of frames of touch i. Poses are checked here; counts
and times where they come from, in :mod:`realtouch.touch_columns` and :mod:`realtouch.frame_columns`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dataset_store.records import Row
from realtouch.damage import damaged
from realtouch.frame_columns import (
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
from realtouch.poses import Poses, PoseSequences, bad_pose
from realtouch.schema import Kind
from realtouch.touch_columns import column_of, media_count, per_touch, touch_count, touch_total, vectors

__all__ = [
    "clip_length",
    "clip_lengths",
    "clip_poses",
    "clip_times",
    "column_of",
    "contact_z_m",
    "frame_times",
    "media_count",
    "padded_times",
    "per_touch",
    "pose_sequences",
    "poses",
    "times_of_touches",
    "touch_count",
    "touch_durations",
    "touch_times",
    "touch_total",
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
        cut_touch(row, f"{_POSE_SEQUENCE}.{part}", touch, length, width)
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
        raise damaged(row, name, f"a gel height of {heights[wrong[0]]}; expected metres", int(wrong[0]))
    return heights


def _require_poses(
    row: Row, name: str, positions: NDArray[Any], quaternions: NDArray[Any], touch: int | None = None
) -> None:
    wrong = bad_pose(positions, quaternions)
    if wrong is not None:
        index, problem = wrong
        where = problem if touch is None else f"frame {index}: {problem}"
        raise damaged(row, name, where, index if touch is None else touch)
