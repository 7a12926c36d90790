"""Columns of a stored ``seq`` round with one entry per frame, cut to the lengths of the clips.

T is the number of touches of the round, N_i the number of frames of touch i: the stated length of its clip.
Where a data set states none, sequences of one length for all touches may be padded; the clips tell then.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realtouch.columns.per_touch import entries_of, per_touch
from realtouch.damage import damaged, missing_column
from tactile_toolkit.read.columns import NestedColumn
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.touch.video import MAX_CLIP_FRAMES, Avi, NoIndexError, ffmpeg_count

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


def clip_lengths(row: Row, touch: int | None = None) -> NDArray[np.int64] | None:
    """Return the number of frames of each clip, shape (T,), or of one alone, (1,); None if none are stated.

    Raises IntegrityError for lengths that are missing, negative or beyond the limit.
    """
    if not row.has("video_length_frames"):
        return None
    values = per_touch(row, "video_length_frames", touch)
    possible = (values >= 0) & (values <= MAX_CLIP_FRAMES)  # False for NaN, which stands for a missing one
    if not possible.all():
        wrong = int(np.argmin(possible))
        problem = f"a clip of {values[wrong]:,} frames; the limit is {MAX_CLIP_FRAMES:,}"
        raise damaged(row, "video_length_frames", problem, (touch or 0) + wrong)
    return values.astype(np.int64, copy=False)


def clip_length(row: Row, touch: int) -> int | None:
    """Return the number of frames of one clip; None where it is not stated."""
    lengths = clip_lengths(row, touch)
    return None if lengths is None else int(lengths[0])


def frame_times(row: Row) -> tuple[NDArray[np.timedelta64], ...]:
    """Return the time stamps of the frames of each touch: T arrays of ``timedelta64``, shapes (N_i,)."""
    return tuple(_as_timedelta(times) for times in cut(row, "time_stamp_rel_seq", 0))


def clip_times(row: Row, touch: int) -> NDArray[np.float64] | None:
    """Return the time stamps of one touch, shape (N_i,), float64, seconds; None in data sets without.

    Raises IntegrityError for stamps that are missing or run backwards.
    """
    if not row.has("time_stamp_rel_seq"):
        return None
    times = _as_seconds(cut_touch(row, "time_stamp_rel_seq", touch, clip_length(row, touch), 0))
    # A comparison with NaN is false, so this finds missing times too.
    if not (times[1:] >= times[:-1]).all() or not math.isfinite(times[:1].sum()):
        raise _unordered(row, touch)
    return times


def padded_times(row: Row) -> tuple[NDArray[np.float64], NDArray[np.int64]] | None:
    """Return the time stamps of all touches at once, where they are stored padded to one length N.

    That is an array of shape (T, N), float64, seconds, and the lengths N_i, shape (T,), int64: of touch i
    the first N_i count. None in data sets without stamps or lengths, and where clips are not padded to one
    length. Raises IntegrityError as :func:`clip_times`.
    """
    if not row.has("time_stamp_rel_seq"):
        return None
    lengths = clip_lengths(row)
    padded = _padded(*entries_of(row, "time_stamp_rel_seq"), 0)
    if lengths is None or padded is None or padded.shape[1] < lengths.max(initial=0):
        return None
    times = _as_seconds(padded)
    rising = np.ones(times.shape, bool)
    # A comparison with NaN is false, so this finds missing times too.
    rising[:, 1:] = times[:, 1:] >= times[:, :-1]
    rising[:, :1] = np.isfinite(times[:, :1])
    rising |= np.arange(times.shape[1]) >= lengths[:, None]
    whole = rising.all(axis=1)
    if not whole.all():
        raise _unordered(row, int(np.argmin(whole)))
    return times, lengths


def _unordered(row: Row, touch: int) -> Exception:
    return damaged(row, "time_stamp_rel_seq", "times that are missing or run backwards", touch)


def touch_durations(row: Row, name: str) -> NDArray[np.timedelta64]:
    """Return one time per touch, shape (T,), ``timedelta64``; IntegrityError, with the touch, without one."""
    times = _as_timedelta(per_touch(row, name))
    unknown = np.isnat(times)
    if unknown.any():
        raise _no_time(row, name, int(np.argmax(unknown)))
    return times


def times_of_touches(row: Row, touch: int | None = None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the times of first and last contact of all touches, shape (T,), or of one alone, (1,), seconds.

    Raises IntegrityError when a time is missing, or the end lies before the start.
    """
    start_s, end_s = (_as_seconds(per_touch(row, name, touch)) for name in _TOUCH_TIMES)
    in_order = start_s <= end_s  # False for NaN, which stands for a missing time
    if not in_order.all():
        wrong = int(np.argmin(in_order))
        times = dict(zip(_TOUCH_TIMES, (start_s[wrong], end_s[wrong]), strict=True))
        for name, time_s in times.items():
            if math.isnan(time_s):
                raise _no_time(row, name, (touch or 0) + wrong)
        problem = f"contact from {start_s[wrong]} s to {end_s[wrong]} s; expected an end not before the start"
        raise damaged(row, "touch_end_time_rel", problem, (touch or 0) + wrong)
    return start_s, end_s


def touch_times(row: Row, touch: int) -> tuple[float, float]:
    """Return the times of first and last contact of one touch, seconds; see :func:`times_of_touches`."""
    start_s, end_s = times_of_touches(row, touch)
    return float(start_s[0]), float(end_s[0])


def _no_time(row: Row, name: str, touch: int) -> Exception:
    return damaged(row, name, "no time is stored; expected a duration or float seconds", touch)


def cut(row: Row, name: str, width: int) -> tuple[NDArray[Any], ...]:
    """Return a sequence per touch, cut to the length of its clip: T arrays of shape (N_i, width).

    A width of 0 means scalars, and shapes (N_i,). Raises IntegrityError when there are not T sequences, or
    one is too short, InputError as :func:`cut_touch`.
    """
    lengths = clip_lengths(row)
    column, first, last = entries_of(row, name)
    padded = _padded(column, first, last, width)
    # Published clips are padded to the longest of their round: one view, cut T times.
    if padded is not None and lengths is not None and padded.shape[1] >= lengths.max(initial=0):
        return tuple(values[:length] for values, length in zip(padded, lengths.tolist(), strict=True))
    return tuple(
        cut_touch(row, name, touch, None if lengths is None else int(lengths[touch]), width)
        for touch in range(last - first)
    )


def cut_touch(row: Row, name: str, touch: int, length: int | None, width: int) -> NDArray[Any]:
    """Return the sequence of one touch: ``length`` entries, or as many as its clip has; see :func:`cut`.

    Raises IntegrityError when there are not T sequences, this one is shorter, or entries are not ``width``
    values each; InputError when nothing tells padding from frames: neither a stated length nor the clip.
    """
    # Counted for a single touch, too: else it would be given the next round's for what is lacking.
    column, *all_of_round = entries_of(row, name)
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
    """Count the frames of a clip, decoding none, in a data set that states no lengths."""
    if not row.has("sensor_video"):
        raise missing_column(row, "video_length_frames")
    data = stored_clip(row, touch)
    try:
        try:
            return len(Avi(data).index())
        except NoIndexError:
            return ffmpeg_count(data)
    except ValueError as error:
        raise damaged(row, "sensor_video", str(error), touch) from error


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
    flat = column.flat(1, first, last)
    if not _same_length(column, first, last) or len(flat) != touches * frames * max(width, 1):
        return None
    return flat.reshape((touches, frames, width) if width else (touches, frames))


def _same_length(column: NestedColumn, first: int, last: int) -> bool:
    """Return whether all touches have equally many entries, so that some may be padding."""
    starts = column.levels[1]
    if isinstance(starts, int):
        return True
    lengths = np.diff(starts[first : last + 1])
    return bool((lengths == lengths[:1]).all())
