"""Columns of a stored round with one entry per frame, cut to the lengths of the clips, and poses.

T is the number of touches of the round, N_i the number of frames of touch i: the stated length of its clip.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realtouch.columns import entries_of, per_touch, vectors
from realtouch.damage import damaged
from realtouch.poses import Poses, PoseSequences, bad_pose
from tactile_toolkit.read.columns import NestedColumn
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.touch.contact import PLATE_COLUMN, PRESS_DEPTH_M, ContactHeight
from tactile_toolkit.touch.schema import POSE_COLUMN, Kind
from tactile_toolkit.touch.video import MAX_CLIP_FRAMES

_NO_TIME = "no time is stored; expected a duration or float seconds"
_SECOND = np.timedelta64(1, "s")
_TOUCH_TIMES = ("touch_start_time_rel", "touch_end_time_rel")


def _as_timedelta(values: NDArray[Any]) -> NDArray[np.timedelta64]:
    """Return times as ``timedelta64``: numbers count seconds and are rounded to nanoseconds."""
    if values.dtype.kind == "m":
        return values
    # Durations arrive as seconds in floats, too.
    nanoseconds = np.round(np.asarray(values, np.float64) * 1e9)
    unknown = ~np.isfinite(nanoseconds)
    # What NaN becomes as an integer differs between processors.
    times = np.where(unknown, 0, nanoseconds).astype(np.int64).astype("timedelta64[ns]")
    times[unknown] = np.timedelta64("NaT", "ns")
    return times


def _as_seconds(values: NDArray[Any]) -> NDArray[np.float64]:
    """Return times (an array, or one of its values) in seconds, float64; unknown ones are NaN."""
    if values.dtype.kind == "m":
        seconds: NDArray[np.float64] = values / _SECOND
        return seconds
    return np.asarray(values, np.float64)


def clip_lengths(row: Row, touch: int | None = None) -> NDArray[np.int64]:
    """Return the number of frames of each clip, shape (T,), or of one alone, (1,).

    Raises IntegrityError for lengths that are missing, negative or beyond the limit.
    """
    values = per_touch(row, "video_length_frames", touch)
    possible = (values >= 0) & (values <= MAX_CLIP_FRAMES)  # False for NaN, which stands for a missing one
    if not possible.all():
        wrong = int(np.argmin(possible))
        problem = f"a clip of {values[wrong]:,} frames; the limit is {MAX_CLIP_FRAMES:,}"
        raise damaged(row, "video_length_frames", problem, (touch or 0) + wrong)
    return values.astype(np.int64, copy=False)


def clip_length(row: Row, touch: int) -> int:
    """Return the number of frames of one clip."""
    return int(clip_lengths(row, touch)[0])


def frame_times(row: Row) -> tuple[NDArray[np.timedelta64], ...]:
    """Return the time stamps of the frames of each touch: T arrays of ``timedelta64``, shapes (N_i,)."""
    return tuple(_as_timedelta(times) for times in cut(row, "time_stamp_rel_seq", 0))


def stamps_s(row: Row, touch: int | None = None) -> list[NDArray[np.float64]] | None:
    """Return the time stamps of each touch, or of one alone: shapes (N_i,), float64, seconds.

    None in data sets without. Raises IntegrityError for stamps that are missing or run backwards.
    """
    if not row.has("time_stamp_rel_seq"):
        return None
    found = [_as_seconds(times) for times in cut(row, "time_stamp_rel_seq", 0, touch)]
    for number, times in enumerate(found, touch or 0):
        # A comparison with NaN is false, so this finds missing times too.
        if not (times[1:] >= times[:-1]).all() or (len(times) and not math.isfinite(times[0])):
            raise damaged(row, "time_stamp_rel_seq", "times that are missing or run backwards", number)
    return found


def touch_durations(row: Row, name: str) -> NDArray[np.timedelta64]:
    """Return one time per touch, shape (T,), ``timedelta64``; IntegrityError, with the touch, without one."""
    times = _as_timedelta(per_touch(row, name))
    unknown = np.isnat(times)
    if unknown.any():
        raise damaged(row, name, _NO_TIME, int(np.argmax(unknown)))
    return times


def times_of_touches(row: Row, touch: int | None = None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the times of first and last contact of all touches, shape (T,), or of one alone, (1,), seconds.

    Raises IntegrityError when a time is missing, or the end lies before the start.
    """
    start_s, end_s = (_as_seconds(per_touch(row, name, touch)) for name in _TOUCH_TIMES)
    in_order = start_s <= end_s  # False for NaN, which stands for a missing time
    if not in_order.all():
        wrong = int(np.argmin(in_order))
        name = _TOUCH_TIMES[0] if math.isnan(start_s[wrong]) else _TOUCH_TIMES[1]
        problem = f"contact from {start_s[wrong]} s to {end_s[wrong]} s; expected an end not before the start"
        raise damaged(row, name, problem, (touch or 0) + wrong)
    return start_s, end_s


def cut(row: Row, name: str, width: int, touch: int | None = None) -> tuple[NDArray[Any], ...]:
    """Return a sequence per touch, or that of one alone, cut to the length of its clip: shapes (N_i, width).

    A width of 0 means scalars, and shapes (N_i,). Raises IntegrityError when there are not T sequences, one
    is too short, or entries are not ``width`` values each.
    """
    if touch is not None:
        return (_cut_touch(row, name, touch, width),)
    lengths = clip_lengths(row)
    column, first, last = entries_of(row, name)
    padded = _padded(column, first, last, width)
    # Published clips are padded to the longest of their round: one view, cut T times.
    if padded is not None and padded.shape[1] >= lengths.max(initial=0):
        return tuple(values[:length] for values, length in zip(padded, lengths.tolist(), strict=True))
    return tuple(_cut_touch(row, name, each, width) for each in range(last - first))


def _cut_touch(row: Row, name: str, touch: int, width: int) -> NDArray[Any]:
    # Counted for a single touch, too: else it would be given the next round's for what is lacking.
    column, first, _ = entries_of(row, name)
    start, stop = column.inside(1, first + touch, first + touch + 1)
    wanted = clip_length(row, touch)
    if wanted > stop - start:
        raise damaged(row, name, f"{stop - start} frames; expected at least {wanted}", touch)
    values = column.flat(2, start, start + wanted) if width else column.values[start : start + wanted]
    if len(values) != wanted * max(width, 1):
        problem = f"{len(values)} values for {wanted} frames; expected {max(width, 1)} each"
        raise damaged(row, name, problem, touch)
    return values.reshape(wanted, width) if width else values


def stored_clip(row: Row, touch: int) -> memoryview:
    """Return the bytes of one clip, without a copy; IntegrityError, with the touch, when none are stored."""
    column = row.group.nested("sensor_video")
    start, stop = column.inside(0, row.index, row.index + 1)
    blob: memoryview | None = column.values[start + touch] if touch < stop - start else None
    if blob is None or len(blob) == 0:
        raise damaged(row, "sensor_video", "no bytes are stored; expected an AVI", touch)
    return blob


def _padded(column: NestedColumn, first: int, last: int, width: int) -> NDArray[Any] | None:
    """View all touches as one array (T, N, width), where they all have N frames of ``width`` values."""
    touches = last - first
    start, stop = column.inside(1, first, last)
    frames = (stop - start) // max(touches, 1)
    flat, starts = column.flat(1, first, last), column.levels[1]
    is_even = isinstance(starts, int) or (np.diff(starts[first : last + 1]) == frames).all()
    if not is_even or len(flat) != touches * frames * max(width, 1):
        return None
    return flat.reshape((touches, frames, width) if width else (touches, frames))


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


def pose_sequences(row: Row, touch: int | None = None) -> PoseSequences:
    """Return the pose of the gel in each frame of each touch of a ``seq`` round, or of one, padding cut off.

    Raises IntegrityError as :func:`poses`, and where a touch has fewer poses than frames.
    """
    positions = cut(row, f"{_POSE_SEQUENCE}.position", 3, touch)
    quaternions = cut(row, f"{_POSE_SEQUENCE}.quaternion", 4, touch)
    # Checked in one go; touch by touch only to find which one is wrong.
    if positions and bad_pose(np.concatenate(positions), np.concatenate(quaternions)) is not None:
        for number, each in enumerate(zip(positions, quaternions, strict=True), touch or 0):
            wrong = bad_pose(*each)
            if wrong is not None:
                raise damaged(row, _POSE_SEQUENCE, f"frame {wrong[0]}: {wrong[1]}", number)
    return PoseSequences(positions, quaternions)


def contact_z_m(row: Row, kind: Kind, touch: int | None = None) -> NDArray[np.float64]:
    """Return the height of the gel at the deepest press of each touch, shape (T,), or of one alone, (1,).

    Metres, cell frame; of a ``single`` round, that is the height of its one pose per touch. Raises
    IntegrityError, which names the touch, for a height that is missing or not finite.
    """
    name = f"{POSE_COLUMN[kind]}.position"
    if kind == "single":
        heights = vectors(row, name, 3, touch)[:, 2].astype(np.float64)
    else:
        # A clip without frames has no height: infinity is refused below.
        heights = np.array([each[:, 2].min(initial=np.inf) for each in cut(row, name, 3, touch)])
    finite = np.isfinite(heights)
    if not finite.all():
        wrong = int(np.argmin(finite))
        problem = f"a gel height of {heights[wrong]}; expected metres"
        raise damaged(row, name, problem, (touch or 0) + wrong)
    return heights


def plate_z_m(row: Row) -> float:
    """Return the known or stored height of the plate in a round, metres, cell frame; NaN without one."""
    if ContactHeight.of(row.group.names).plate == "known":
        return PRESS_DEPTH_M
    stored = row.value(PLATE_COLUMN) if row.has(PLATE_COLUMN) else None
    return math.nan if stored is None else float(stored)
