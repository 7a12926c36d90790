"""The numbers of a stored round, read as numpy views and checked where they are read.

T is the number of touches of the round, N_i the number of frames of touch i.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dataset_store.records import Row
from realtouch.avi import MAX_CLIP_FRAMES
from realtouch.damage import damaged, missing_column
from realtouch.durations import as_seconds, as_timedelta
from realtouch.nested import NestedColumn, nested_column
from realtouch.poses import Poses, PoseSequences, bad_pose
from realtouch.schema import Kind

__all__ = [
    "clip_length",
    "clip_lengths",
    "clip_poses",
    "clip_times",
    "column_of",
    "contact_z_m",
    "frame_times",
    "media_count",
    "per_touch",
    "pose_sequences",
    "poses",
    "touch_count",
    "touch_durations",
    "touch_times",
    "touch_total",
    "vectors",
]

_POSE = "gel_pose_cell_frame"
_POSE_SEQUENCE = "gel_pose_cell_frame_seq"


def column_of(row: Row, name: str) -> NestedColumn:
    """Return the column of a row.

    Raises
    ------
    InputError
        The data set has no such column.
    """
    try:
        return nested_column(row.group, name)
    except KeyError as error:
        raise missing_column(row, name) from error


def touch_count(row: Row, name: str) -> int:
    """Return for how many touches a row holds values of a column."""
    start, stop = column_of(row, name).inside(0, row.index, row.index + 1)
    return stop - start


def media_count(row: Row, name: str) -> int:
    """Return for how many touches a row holds images or clips.

    Raises
    ------
    IntegrityError
        There are not T of them.
    """
    count = touch_count(row, name)
    _require_count(row, name, count)
    return count


def touch_total(row: Row) -> int:
    """Return T: the number of intended positions, or else of images or clips."""
    for name in ("pos_in_cell", "sensor_image", "sensor_video"):
        if row.has(name):
            return touch_count(row, name)
    raise missing_column(row, "pos_in_cell")


def per_touch(row: Row, name: str) -> NDArray[Any]:
    """Return one value per touch, shape (T,).

    Raises
    ------
    IntegrityError
        There are not T values.
    """
    values = column_of(row, name).flat(0, row.index, row.index + 1)
    _require_count(row, name, len(values))
    return values


def vectors(row: Row, name: str, width: int) -> NDArray[np.floating]:
    """Return one vector per touch, shape (T, width), a view.

    Raises
    ------
    IntegrityError
        There are not T vectors of ``width`` values.
    """
    values = column_of(row, name).flat(0, row.index, row.index + 1)
    touches = touch_count(row, name)
    _require_count(row, name, touches)
    if len(values) != touches * width:
        problem = f"{len(values)} values for {touches} touches; expected {width} each"
        raise damaged(row, name, problem)
    return values.reshape(touches, width)


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


def clip_lengths(row: Row) -> NDArray[np.int64] | None:
    """Return the number of frames of each clip, shape (T,), int64; None in data sets that do not say.

    Raises
    ------
    IntegrityError
        A length is missing or negative.
    """
    if not row.has("video_length_frames"):
        return None
    values = per_touch(row, "video_length_frames")
    if not (values.min(initial=0) >= 0 and values.max(initial=0) <= MAX_CLIP_FRAMES):
        touch = int(np.flatnonzero(~((values >= 0) & (values <= MAX_CLIP_FRAMES)))[0])
        raise _impossible_length(row, touch, values[touch])
    return values.astype(np.int64, copy=False)


def clip_length(row: Row, touch: int) -> int | None:
    """Return the number of frames of one clip, as :func:`clip_lengths`; None where it is not said."""
    if not row.has("video_length_frames"):
        return None
    length = _value_of(row, "video_length_frames", touch)
    if not 0 <= length <= MAX_CLIP_FRAMES:
        raise _impossible_length(row, touch, length)
    return int(length)


def _impossible_length(row: Row, touch: int, length: Any) -> Exception:
    problem = f"a clip of {length:,} frames; the limit is {MAX_CLIP_FRAMES:,}"
    return damaged(row, "video_length_frames", problem, touch)


def _value_of(row: Row, name: str, touch: int) -> Any:
    """Return one value of a column with one per touch, without looking at the others."""
    column = column_of(row, name)
    start, stop = column.inside(0, row.index, row.index + 1)
    if not touch < stop - start:
        _require_count(row, name, stop - start)
    return column.values[start + touch]


def pose_sequences(row: Row) -> PoseSequences:
    """Return the pose of the gel in each frame of each touch of a ``seq`` round, padding cut off.

    Raises
    ------
    IntegrityError
        As :func:`poses`, or a touch has fewer poses than frames.
    """
    positions, quaternions = (
        _cut(row, f"{_POSE_SEQUENCE}.{part}", width) for part, width in (("position", 3), ("quaternion", 4))
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
        _cut_touch(row, f"{_POSE_SEQUENCE}.{part}", touch, length, width)
        for part, width in (("position", 3), ("quaternion", 4))
    ]
    _require_poses(row, _POSE_SEQUENCE, parts[0], parts[1], touch)
    return Poses(parts[0], parts[1])


def frame_times(row: Row) -> tuple[NDArray[np.timedelta64], ...]:
    """Return the time stamps of the frames of each touch: T arrays of ``timedelta64``, shapes (N_i,)."""
    return tuple(as_timedelta(times) for times in _cut(row, "time_stamp_rel_seq", 0))


def clip_times(row: Row, touch: int) -> NDArray[np.float64] | None:
    """Return the time stamps of one touch, shape (N_i,), float64, seconds; None in data sets without.

    Raises
    ------
    IntegrityError
        Stamps are missing or run backwards.
    """
    if not row.has("time_stamp_rel_seq"):
        return None
    times = as_seconds(_cut_touch(row, "time_stamp_rel_seq", touch, clip_length(row, touch), 0))
    # A comparison with what is not a number is false, so this finds missing times too.
    if not (times[1:] >= times[:-1]).all() or not math.isfinite(times[:1].sum()):
        raise damaged(row, "time_stamp_rel_seq", "times that are missing or run backwards", touch)
    return times


def touch_durations(row: Row, name: str) -> NDArray[np.timedelta64]:
    """Return one time per touch, shape (T,), ``timedelta64``."""
    return as_timedelta(per_touch(row, name))


def touch_times(row: Row, touch: int) -> tuple[float, float]:
    """Return the times of first and last contact of one touch, seconds.

    Raises
    ------
    IntegrityError
        A time is missing, or the end lies before the start.
    """
    start_s, end_s = (
        float(as_seconds(_value_of(row, name, touch)))
        for name in ("touch_start_time_rel", "touch_end_time_rel")
    )
    if not start_s <= end_s:
        problem = f"contact from {start_s} s to {end_s} s; expected an end not before the start"
        raise damaged(row, "touch_end_time_rel", problem, touch)
    return start_s, end_s


def _cut(row: Row, name: str, width: int) -> tuple[NDArray[Any], ...]:
    """Return a sequence per touch, cut to the length of its clip; ``width`` 0 means scalars."""
    column = column_of(row, name)
    lengths = clip_lengths(row)
    first, last = column.inside(0, row.index, row.index + 1)
    _require_count(row, name, last - first)
    padded = _padded(column, first, last, width)
    if padded is not None and lengths is not None and padded.shape[1] >= lengths.max(initial=0):
        return tuple(map(_head, padded, lengths.tolist()))
    return tuple(
        _cut_touch(row, name, touch, None if lengths is None else int(lengths[touch]), width)
        for touch in range(last - first)
    )


def _head(values: NDArray[Any], length: int) -> NDArray[Any]:
    return values[:length]


def _padded(column: NestedColumn, first: int, last: int, width: int) -> NDArray[Any] | None:
    """View all touches as one array (T, N, width), where they all have N frames of ``width`` values."""
    touches = last - first
    start, stop = column.inside(1, first, last)
    frames, rest = divmod(stop - start, max(touches, 1))
    flat = column.flat(1, first, last)
    starts = column.levels[1]
    even = isinstance(starts, int) or bool((np.diff(starts[first : last + 1]) == frames).all())
    if rest or not even or len(flat) != touches * frames * max(width, 1):
        return None
    return flat.reshape((touches, frames, width) if width else (touches, frames))


def _cut_touch(row: Row, name: str, touch: int, length: int | None, width: int) -> NDArray[Any]:
    column = column_of(row, name)
    first = column.inside(0, row.index, row.index + 1)[0] + touch
    start, stop = column.inside(1, first, first + 1)
    wanted = stop - start if length is None else length
    if wanted > stop - start:
        raise damaged(row, name, f"{stop - start} frames; expected at least {wanted}", touch)
    values = column.flat(2, start, start + wanted) if width else column.values[start : start + wanted]
    if len(values) != wanted * max(width, 1):
        problem = f"{len(values)} values for {wanted} frames; expected {max(width, 1)} each"
        raise damaged(row, name, problem, touch)
    return values.reshape(wanted, width) if width else values


def _require_count(row: Row, name: str, found: int) -> None:
    expected = touch_total(row)
    if found != expected:
        raise damaged(row, name, f"{found} touches; expected {expected} as in 'pos_in_cell'")


def _require_poses(
    row: Row, name: str, positions: NDArray[Any], quaternions: NDArray[Any], touch: int | None = None
) -> None:
    wrong = bad_pose(positions, quaternions)
    if wrong is not None:
        index, problem = wrong
        where = problem if touch is None else f"frame {index}: {problem}"
        raise damaged(row, name, where, index if touch is None else touch)


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
        heights = np.array([touch[:, 2].min(initial=np.inf) for touch in _cut(row, name, 3)])
    else:
        name = f"{_POSE}.position"
        heights = vectors(row, name, 3)[:, 2].astype(np.float64)
    wrong = np.flatnonzero(~np.isfinite(heights))
    if len(wrong):
        raise damaged(row, name, f"a gel height of {heights[wrong[0]]}; expected metres", int(wrong[0]))
    return heights
