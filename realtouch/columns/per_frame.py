"""Columns of a stored ``seq`` round with one entry per frame, cut to the lengths of the clips.

T is the number of touches of the round, N_i the number of frames of touch i: the stated length of its clip.
Where a data set states none, sequences of one length for all touches may be padded; the clips tell then.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realtouch.columns.per_touch import column_of, per_touch, require_count, value_of
from realtouch.columns.stored_clips import counted_frames
from realtouch.integrity.damage import damaged, missing_column
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.nested import NestedColumn
from tactile_toolkit.touch.avi import MAX_CLIP_FRAMES

__all__ = [
    "as_seconds",
    "as_timedelta",
    "clip_length",
    "clip_lengths",
    "clip_times",
    "cut",
    "cut_touch",
    "frame_times",
    "padded_times",
    "times_of_touches",
    "touch_durations",
    "touch_times",
]

_NANOSECONDS = 1e9
_SECOND = np.timedelta64(1, "s")


def as_timedelta(values: NDArray[Any]) -> NDArray[np.timedelta64]:
    """Return times as ``timedelta64``.

    Parameters
    ----------
    values : ndarray, any shape
        ``timedelta64`` of any unit (returned as it is), or numbers that count seconds.

    Returns
    -------
    ndarray of timedelta64
        Same shape. Seconds become nanoseconds, rounded to the nearest.
    """
    if values.dtype.kind == "m":
        return values
    nanoseconds = np.round(np.asarray(values, np.float64) * _NANOSECONDS)
    unknown = ~np.isfinite(nanoseconds)
    times = np.where(unknown, 0, nanoseconds).astype(np.int64).astype("timedelta64[ns]")
    times[unknown] = np.timedelta64("NaT")
    return times


def as_seconds(values: NDArray[Any]) -> NDArray[np.float64]:
    """Return times (an array, or one of its values) in seconds, float64; unknown ones are NaN."""
    if values.dtype.kind == "m":
        seconds: NDArray[np.float64] = values / _SECOND
        return seconds
    return np.asarray(values, np.float64)


_TOUCH_TIMES = ("touch_start_time_rel", "touch_end_time_rel")


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
    length = value_of(row, "video_length_frames", touch)
    if not 0 <= length <= MAX_CLIP_FRAMES:
        raise _impossible_length(row, touch, length)
    return int(length)


def frame_times(row: Row) -> tuple[NDArray[np.timedelta64], ...]:
    """Return the time stamps of the frames of each touch: T arrays of ``timedelta64``, shapes (N_i,)."""
    return tuple(as_timedelta(times) for times in cut(row, "time_stamp_rel_seq", 0))


def clip_times(row: Row, touch: int) -> NDArray[np.float64] | None:
    """Return the time stamps of one touch, shape (N_i,), float64, seconds; None in data sets without.

    Raises
    ------
    IntegrityError
        Stamps are missing or run backwards.
    """
    if not row.has("time_stamp_rel_seq"):
        return None
    times = as_seconds(cut_touch(row, "time_stamp_rel_seq", touch, clip_length(row, touch), 0))
    # A comparison with what is not a number is false, so this finds missing times too.
    if not (times[1:] >= times[:-1]).all() or not math.isfinite(times[:1].sum()):
        raise _unordered(row, touch)
    return times


def padded_times(row: Row) -> tuple[NDArray[np.float64], NDArray[np.int64]] | None:
    """Return the time stamps of all touches at once, where they are stored padded to one length.

    Returns
    -------
    times_s : ndarray, shape (T, N), float64
        Seconds; of touch i the first N_i count.
    lengths : ndarray, shape (T,), int64
        N_i.
    None
        In data sets without stamps or lengths, and where clips are not padded to one length.

    Raises
    ------
    IntegrityError
        As :func:`clip_times`.
    """
    if not row.has("time_stamp_rel_seq"):
        return None
    lengths = clip_lengths(row)
    column = column_of(row, "time_stamp_rel_seq")
    first, last = column.inside(0, row.index, row.index + 1)
    require_count(row, "time_stamp_rel_seq", last - first)
    padded = _padded(column, first, last, 0)
    if lengths is None or padded is None or padded.shape[1] < lengths.max(initial=0):
        return None
    times = as_seconds(padded)
    rising = np.ones(times.shape, bool)
    # A comparison with what is not a number is false, so this finds missing times too.
    rising[:, 1:] = times[:, 1:] >= times[:, :-1]
    rising[:, :1] = np.isfinite(times[:, :1])
    rising |= np.arange(times.shape[1]) >= lengths[:, None]
    for touch in np.flatnonzero(~rising.all(axis=1)).tolist():
        raise _unordered(row, touch)
    return times, lengths


def touch_durations(row: Row, name: str) -> NDArray[np.timedelta64]:
    """Return one time per touch, shape (T,), ``timedelta64``.

    Raises
    ------
    IntegrityError
        A time is missing; names the touch.
    """
    times = as_timedelta(per_touch(row, name))
    for touch in np.flatnonzero(np.isnat(times)).tolist():
        raise _no_time(row, name, touch)
    return times


def touch_times(row: Row, touch: int) -> tuple[float, float]:
    """Return the times of first and last contact of one touch, seconds.

    Raises
    ------
    IntegrityError
        A time is missing, or the end lies before the start.
    """
    start_s, end_s = (_touch_time(row, name, touch) for name in _TOUCH_TIMES)
    if not start_s <= end_s:
        raise _reversed(row, touch, start_s, end_s)
    return start_s, end_s


def times_of_touches(row: Row) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the times of first and last contact of all touches, each of shape (T,), float64, seconds.

    Raises
    ------
    IntegrityError
        As :func:`touch_times`.
    """
    start_s, end_s = (as_seconds(per_touch(row, name)) for name in _TOUCH_TIMES)
    for touch in np.flatnonzero(~(start_s <= end_s)).tolist():
        touch_times(row, touch)  # says what is wrong; a comparison with what is not a number is false too
    return start_s, end_s


def _touch_time(row: Row, name: str, touch: int) -> float:
    time_s = float(as_seconds(value_of(row, name, touch)))
    if math.isnan(time_s):
        raise _no_time(row, name, touch)
    return time_s


def _no_time(row: Row, name: str, touch: int) -> Exception:
    return damaged(row, name, "no time is stored; expected a duration or float seconds", touch)


def _unordered(row: Row, touch: int) -> Exception:
    return damaged(row, "time_stamp_rel_seq", "times that are missing or run backwards", touch)


def _reversed(row: Row, touch: int, start_s: float, end_s: float) -> Exception:
    problem = f"contact from {start_s} s to {end_s} s; expected an end not before the start"
    return damaged(row, "touch_end_time_rel", problem, touch)


def cut(row: Row, name: str, width: int) -> tuple[NDArray[Any], ...]:
    """Return a sequence per touch, cut to the length of its clip.

    Parameters
    ----------
    row : Row
        The round.
    name : str
        Column.
    width : int
        Values of each entry; 0 means scalars.

    Returns
    -------
    tuple of ndarray
        T arrays of shape (N_i, width) or (N_i,).

    Raises
    ------
    IntegrityError
        There are not T sequences, or one is too short.
    InputError
        As :func:`cut_touch`.
    """
    column = column_of(row, name)
    lengths = clip_lengths(row)
    first, last = column.inside(0, row.index, row.index + 1)
    require_count(row, name, last - first)
    if lengths is None and _same_length(column, first, last):
        lengths = np.array([_length_by_clip(row, touch) for touch in range(last - first)], np.int64)
    padded = _padded(column, first, last, width)
    if padded is not None and lengths is not None and padded.shape[1] >= lengths.max(initial=0):
        return tuple(map(_head, padded, lengths.tolist()))
    return tuple(
        cut_touch(row, name, touch, None if lengths is None else int(lengths[touch]), width)
        for touch in range(last - first)
    )


def cut_touch(row: Row, name: str, touch: int, length: int | None, width: int) -> NDArray[Any]:
    """Return the sequence of one touch: ``length`` entries, or as many as its clip has; see :func:`cut`.

    Raises
    ------
    IntegrityError
        Fewer are stored, or they are not ``width`` values each.
    InputError
        Nothing tells padding from frames: neither a stated length nor the clip is there.
    """
    column = column_of(row, name)
    all_of_round = column.inside(0, row.index, row.index + 1)
    first = all_of_round[0] + touch
    start, stop = column.inside(1, first, first + 1)
    if length is None and _same_length(column, *all_of_round):
        length = _length_by_clip(row, touch)
    wanted = stop - start if length is None else length
    if wanted > stop - start:
        raise damaged(row, name, f"{stop - start} frames; expected at least {wanted}", touch)
    values = column.flat(2, start, start + wanted) if width else column.values[start : start + wanted]
    if len(values) != wanted * max(width, 1):
        problem = f"{len(values)} values for {wanted} frames; expected {max(width, 1)} each"
        raise damaged(row, name, problem, touch)
    return values.reshape(wanted, width) if width else values


def _length_by_clip(row: Row, touch: int) -> int:
    """Count the frames of a clip, in a data set that states no lengths."""
    try:
        return counted_frames(row, touch)
    except KeyError as error:
        raise missing_column(row, "video_length_frames") from error


def _head(values: NDArray[Any], length: int) -> NDArray[Any]:
    return values[:length]


def _padded(column: NestedColumn, first: int, last: int, width: int) -> NDArray[Any] | None:
    """View all touches as one array (T, N, width), where they all have N frames of ``width`` values."""
    touches = last - first
    start, stop = column.inside(1, first, last)
    frames = (stop - start) // max(touches, 1)
    flat = column.flat(1, first, last)
    if not _same_length(column, first, last) or len(flat) != touches * frames * max(width, 1):
        return None
    return flat.reshape((touches, frames, width) if width else (touches, frames))


def _same_length(column: NestedColumn, first: int, last: int) -> bool:
    """Tell whether all touches have equally many entries, so that some may be padding."""
    starts = column.levels[1]
    if isinstance(starts, int):
        return True
    lengths = np.diff(starts[first : last + 1])
    return bool((lengths == lengths[:1]).all())


def _impossible_length(row: Row, touch: int, length: Any) -> Exception:
    problem = f"a clip of {length:,} frames; the limit is {MAX_CLIP_FRAMES:,}"
    return damaged(row, "video_length_frames", problem, touch)
