"""Columns of a stored round, with one entry per touch or per frame, and its metadata; checked on reading.

T is the number of touches of the round, N_i the number of frames of touch i: the stated length of its clip,
to which entries per frame are cut.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from realtouch.contact import PLATE_COLUMN, ContactHeight
from realtouch.poses import Poses, PoseSequences, bad_pose, rigid_transform
from realtouch.schema import PER_TOUCH_COLUMNS, POSE_COLUMN
from realtouch.video import MAX_CLIP_FRAMES
from tactile_toolkit.array_types import AnyArray, Bool, Float64, Floating, Int64
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.read import (
    NestedColumn,
    Row,
    RowGroup,
    RowSource,
    all_blocks,
    checked_index,
    whole_number,
    whole_numbers,
)
from tactile_toolkit.touch import MEDIA_COLUMN, PRESS_DEPTH_M, Kind

# The first of these that is there says how many touches a round has; poses only where they were read alone.
_COUNTED = (
    "pos_in_cell",
    "sensor_image",
    "sensor_video",
    "gel_pose_cell_frame.position",
    "gel_pose_cell_frame_seq.position",
)
_UNREADABLE = (ValueError, pa.ArrowException)
_NEXT = "run `realtouch verify` to list everything that is wrong, then download or convert again"
_NO_TIME = "no time is stored; expected a duration or float seconds"
_TOO_LONG = f"a clip of {{:,}} frames; expected an integer of 0 to {MAX_CLIP_FRAMES:,}"
_SECOND = np.timedelta64(1, "s")
_CONTACT_START, _CONTACT_END = "touch_start_time_rel", "touch_end_time_rel"
_POSE, _POSE_SEQUENCE = POSE_COLUMN["single"], POSE_COLUMN["seq"]


def stored_rows(shards: Iterable[RowSource], columns: Sequence[str] | None = None) -> Iterator[TouchRow]:
    """Yield all rows of some files, with all columns or those named; a block of them is in memory."""
    return rows_of(all_blocks(shards, columns))


def rows_of(blocks: Iterable[RowGroup]) -> Iterator[TouchRow]:
    """Yield the rows of some blocks."""
    return (TouchRow(block, row) for block in blocks for row in range(len(block.table)))


def _as_timedelta(values: AnyArray) -> NDArray[np.timedelta64]:
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


def _as_seconds(values: AnyArray) -> Float64:
    """Return times (an array, or one of its values) in seconds, float64; unknown ones are NaN."""
    if values.dtype.kind == "m":
        seconds: Float64 = values / _SECOND
        return seconds
    return np.asarray(values, np.float64)


def _padded(column: NestedColumn, first: int, last: int, width: int) -> AnyArray | None:
    """View all touches as one array (T, N, width), where they all have N frames of ``width`` values."""
    touches = last - first
    start, stop = column.inside(1, first, last)
    frames = (stop - start) // max(touches, 1)
    flat, starts = column.flat(1, first, last), column.levels[1]
    is_even = isinstance(starts, int) or (np.diff(starts[first : last + 1]) == frames).all()
    if not is_even or len(flat) != touches * frames * max(width, 1):
        return None
    return flat.reshape((touches, frames, width) if width else (touches, frames))


@dataclass(frozen=True, slots=True)
class Damage:
    """One thing that is wrong with a stored round.

    Attributes
    ----------
    file : str
        Parquet file.
    row : int or None
        Row in that file, the first one where the problem names several; None when all of the file is meant.
    touch : int or None
        Touch of the round; None when all of the round is meant.
    field : str
        Column; empty when no single one is meant.
    problem : str
        What was found, and what was expected.
    """

    file: str
    row: int | None
    touch: int | None
    field: str
    problem: str

    def __str__(self) -> str:
        parts = [repr(self.file)]
        parts += [f"row {self.row}"] if self.row is not None else []
        parts += [f"touch {self.touch}"] if self.touch is not None else []
        parts += [f"field {self.field!r}"] if self.field else []
        return f"{', '.join(parts)}: {self.problem}"


class DamagedRoundError(IntegrityError):
    """An :class:`IntegrityError` that carries its :class:`Damage`; internal, catch ``IntegrityError``."""

    def __init__(self, damage: Damage) -> None:
        super().__init__(damage, next=_NEXT)
        self.damage = damage

    def __reduce__(self) -> tuple[object, ...]:
        return (DamagedRoundError, (self.damage,))


class TouchRow(Row):
    """A stored round, which reads its columns: each is checked where it is read.

    T is the number of touches of the round, N_i the number of frames of touch i: the stated length of its
    clip, to which entries per frame are cut.
    """

    __slots__ = ()

    @property
    def kind(self) -> Kind:
        """Whether it has clips or images."""
        return "seq" if self.has(MEDIA_COLUMN["seq"]) else "single"

    @property
    def has_poses(self) -> bool:
        """Whether it has poses of the gel."""
        return self.has(f"{POSE_COLUMN[self.kind]}.position")

    def damaged(self, field: str, problem: str, touch: int | None = None) -> DamagedRoundError:
        """Return the error for a field that cannot be used."""
        return DamagedRoundError(Damage(self.path, self.number, touch, field, problem))

    @contextmanager
    def naming(self, field: str, touch: int | None = None, where: str = "") -> Iterator[None]:
        """Turn a ValueError into damage of a field."""
        try:
            yield
        except ValueError as error:
            raise self.damaged(field, f"{where}{error}", touch) from error

    def missing_column(self, field: str) -> InputError:
        """Return the error for a column that was asked for and that the data set does not have."""
        return InputError(
            f"{self.path!r} has no column {field!r}",
            next="use a data set that has it, such as the `seq` or the `single` form of the same touches",
        )

    def column_of(self, name: str) -> NestedColumn:
        """Return the column of a row; InputError when the data set has no column of that name."""
        try:
            return self.group.nested(name)
        except KeyError as error:
            raise self.missing_column(name) from error

    def touch_total(self) -> int:
        """Return T: the number of intended positions, or else of images or clips, or of poses read alone."""
        # Once for a block of rows: this is asked for each touch.
        name = next(filter(self.has, _COUNTED), _COUNTED[0])
        starts = self.group.once("starts of touches", lambda: self.column_of(name).levels[0])
        return starts if isinstance(starts, int) else int(starts[self.index + 1] - starts[self.index])

    def entries_of(self, name: str, touch: int | None = None) -> tuple[NestedColumn, int, int]:
        """Return a column and the range of its entries that are the round's, or one touch's.

        Raises IntegrityError unless there are T, IndexError when it has no such touch.
        """
        column = self.column_of(name)
        start, stop = column.inside(0, self.index, self.index + 1)
        expected = self.touch_total()
        if stop - start != expected:
            raise self.damaged(name, f"{stop - start} touches; expected {expected} as in 'pos_in_cell'")
        if touch is None:
            return column, start, stop
        first = start + checked_index(touch, expected, "touch", "touches")
        return column, first, first + 1

    def require_touches(self) -> None:
        """Refuse a round whose columns differ in their number of touches; IntegrityError, with the column."""
        for name in PER_TOUCH_COLUMNS:
            if self.has(name):
                self.entries_of(name)

    def _require_each(self, name: str, good: Bool, touch: int | None, problem: str, *found: AnyArray) -> None:
        """Refuse entries of touches that are not all good; IntegrityError for the first that is not.

        ``touch`` is the number of the first entry; what was ``found`` in its place is put into ``problem``.
        """
        if not good.all():
            wrong = int(np.argmin(good))
            raise self.damaged(name, problem.format(*(each[wrong] for each in found)), (touch or 0) + wrong)

    def per_touch(self, name: str, touch: int | None = None) -> AnyArray:
        """Return one value per touch, shape (T,), or one alone, (1,); IntegrityError unless there are T."""
        column, start, stop = self.entries_of(name, touch)
        values: AnyArray = column.values[start:stop]
        return values

    def vectors(self, name: str, width: int, touch: int | None = None) -> Floating:
        """Return one vector per touch, shape (T, width), or that of one alone, (1, width), a view.

        Raises IntegrityError for other numbers of values.
        """
        column, start, stop = self.entries_of(name, touch)
        values = column.flat(1, start, stop)
        touches = stop - start
        if len(values) != touches * width:
            problem = f"{len(values)} values for {touches} touches; expected {width} each"
            if touch is not None:
                problem = f"{len(values)} values; expected {width}"
            raise self.damaged(name, problem, touch)
        return values.reshape(touches, width)

    def intended_positions(self, touch: int | None = None) -> Floating:
        """Return where each touch was meant to be, shape (T, 2), or one alone, (1, 2), a view.

        Metres, cell frame. Raises IntegrityError, which names the touch, for a position that is missing or
        not finite.
        """
        positions = self.vectors("pos_in_cell", 2, touch)
        # One sum shows any value that is not finite, and costs a tenth of looking at each.
        if not np.isfinite(positions.sum()):
            finite = np.asarray(np.isfinite(positions).all(axis=1))
            self._require_each("pos_in_cell", finite, touch, "a position {}; expected metres", positions)
        return positions

    def readable(self, read: Callable[[int | None], AnyArray], shape: tuple[int, ...] = ()) -> Float64:
        """Return what is read of all touches, shape (T, ...), float64; NaN where a touch is damaged."""
        try:
            return read(None).astype(np.float64)
        except IntegrityError:
            # One by one only where something is damaged: all at once is many times as fast.
            known = np.full((self.touch_total(), *shape), np.nan)
        for touch in range(len(known)):
            with suppress(IntegrityError):
                known[touch] = read(touch)[0]
        return known

    def clip_lengths(self) -> Int64:
        """Return the number of frames of each clip, shape (T,).

        Raises IntegrityError for lengths that are missing, negative or beyond the limit.
        """
        values = self.per_touch("video_length_frames")
        # False for NaN, which stands for a missing one.
        possible = (values >= 0) & (values <= MAX_CLIP_FRAMES) & whole_numbers(values)
        self._require_each("video_length_frames", possible, None, _TOO_LONG, values)
        return values.astype(np.int64, copy=False)

    def clip_length(self, touch: int) -> int:
        """Return the number of frames of one clip; raises as :func:`clip_lengths`."""
        column, place, _ = self.entries_of("video_length_frames", touch)
        frames = column.values[place]
        if not (0 <= frames <= MAX_CLIP_FRAMES and int(frames) == frames):
            raise self.damaged("video_length_frames", _TOO_LONG.format(frames), touch)
        return int(frames)

    def frame_times(self) -> tuple[NDArray[np.timedelta64], ...]:
        """Return the time stamps of the frames of each touch: T arrays of ``timedelta64``, shapes (N_i,)."""
        return tuple(_as_timedelta(times) for times in self.cut("time_stamp_rel_seq", 0))

    def stamps_s(self, touch: int | None = None) -> list[Float64] | None:
        """Return the time stamps of each touch, or of one alone: shapes (N_i,), float64, seconds.

        None in data sets without. Raises IntegrityError for stamps that are missing or run backwards.
        """
        if not self.has("time_stamp_rel_seq"):
            return None
        found = [_as_seconds(times) for times in self.cut("time_stamp_rel_seq", 0, touch)]
        if touch is None:
            # In one go; touch by touch only to find which one is wrong.
            joined = np.concatenate([np.zeros(0), *found])
            falls = np.flatnonzero(joined[1:] < joined[:-1]) + 1
            if np.isfinite(joined).all() and np.isin(falls, np.cumsum(list(map(len, found)))).all():
                return found
        for number, times in enumerate(found, touch or 0):
            # A comparison with NaN is false, so this finds missing times too.
            if not (times[1:] >= times[:-1]).all() or (len(times) and not math.isfinite(times[0])):
                raise self.damaged("time_stamp_rel_seq", "times that are missing or run backwards", number)
        return found

    def touch_durations(self, name: str) -> NDArray[np.timedelta64]:
        """Return one time per touch, shape (T,), ``timedelta64``; IntegrityError for a touch without."""
        times = _as_timedelta(self.per_touch(name))
        self._require_each(name, ~np.isnat(times), None, _NO_TIME)
        return times

    def times_of_touches(self, touch: int | None = None) -> tuple[Float64, Float64]:
        """Return the times of first and last contact of all touches, (T,), or of one alone, (1,), seconds.

        Raises IntegrityError when a time is missing, or the end lies before the start.
        """
        start_s, end_s = (_as_seconds(self.per_touch(name, touch)) for name in (_CONTACT_START, _CONTACT_END))

        problem = "contact from {} s to {} s; expected an end not before the start"
        self._require_each(_CONTACT_START, ~np.isnan(start_s), touch, problem, start_s, end_s)
        # False for an end of NaN, which is missing.
        self._require_each(_CONTACT_END, start_s <= end_s, touch, problem, start_s, end_s)
        return start_s, end_s

    def cut(self, name: str, width: int, touch: int | None = None) -> tuple[AnyArray, ...]:
        """Return a sequence per touch, or of one alone, cut to the length of its clip: shapes (N_i, width).

        A width of 0 means scalars, and shapes (N_i,). Raises IntegrityError when there are not T sequences,
        one is too short, or entries are not ``width`` values each.
        """
        if touch is not None:
            return (self._cut_touch(name, touch, width),)
        lengths = self.clip_lengths()
        column, first, last = self.entries_of(name)
        padded = _padded(column, first, last, width)
        # Published clips are padded to the longest of their round: one view, cut T times.
        if padded is not None and padded.shape[1] >= lengths.max(initial=0):
            return tuple(values[:length] for values, length in zip(padded, lengths.tolist(), strict=True))
        return tuple(self._cut_touch(name, each, width) for each in range(last - first))

    def _cut_touch(self, name: str, touch: int, width: int) -> AnyArray:
        # Counted for a single touch, too: else it would be given the next round's for what is lacking.
        column, first, _ = self.entries_of(name)
        start, stop = column.inside(1, first + touch, first + touch + 1)
        wanted = self.clip_length(touch)
        if wanted > stop - start:
            raise self.damaged(name, f"{stop - start} frames; expected at least {wanted}", touch)
        values = column.flat(2, start, start + wanted) if width else column.values[start : start + wanted]
        if len(values) != wanted * max(width, 1):
            problem = f"{len(values)} values for {wanted} frames; expected {max(width, 1)} each"
            raise self.damaged(name, problem, touch)
        return values.reshape(wanted, width) if width else values

    def stored_clip(self, touch: int) -> memoryview:
        """Return the bytes of one clip, without a copy; IntegrityError when none are stored."""
        column = self.group.nested("sensor_video")
        start, stop = column.inside(0, self.index, self.index + 1)
        blob: memoryview | None = column.values[start + touch] if touch < stop - start else None
        if blob is None or len(blob) == 0:
            raise self.damaged("sensor_video", "no bytes are stored; expected an AVI", touch)
        return blob

    def poses(self, touch: int | None = None) -> Poses:
        """Return the pose of the gel in each touch of a ``single`` round, T poses, or that of one alone.

        Raises IntegrityError, which names the touch, for a position or quaternion that is missing, not finite
        or of length zero.
        """
        positions = self.vectors(f"{_POSE}.position", 3, touch)
        quaternions = self.vectors(f"{_POSE}.quaternion", 4, touch)
        wrong = bad_pose(positions, quaternions)
        if wrong is not None:
            raise self.damaged(_POSE, wrong[1], (touch or 0) + wrong[0])
        return Poses(positions, quaternions)

    def pose_sequences(self, touch: int | None = None) -> PoseSequences:
        """Return the pose of the gel in each frame of each touch of a ``seq`` round, or of one; no padding.

        Raises IntegrityError as :func:`poses`, and where a touch has fewer poses than frames.
        """
        positions = self.cut(f"{_POSE_SEQUENCE}.position", 3, touch)
        quaternions = self.cut(f"{_POSE_SEQUENCE}.quaternion", 4, touch)
        # Checked in one go; touch by touch only to find which one is wrong.
        if positions and bad_pose(np.concatenate(positions), np.concatenate(quaternions)) is not None:
            for number, each in enumerate(zip(positions, quaternions, strict=True), touch or 0):
                wrong = bad_pose(*each)
                if wrong is not None:
                    raise self.damaged(_POSE_SEQUENCE, f"frame {wrong[0]}: {wrong[1]}", number)
        return PoseSequences(positions, quaternions)

    def contact_z_m(self, kind: Kind, touch: int | None = None) -> Float64:
        """Return the height of the gel at the deepest press of each touch, shape (T,), or of one alone, (1,).

        Metres, cell frame; of a ``single`` round, that is the height of its one pose per touch. Raises
        IntegrityError, which names the touch, for a height that is missing or not finite.
        """
        name = f"{POSE_COLUMN[kind]}.position"
        if kind == "single":
            heights = self.vectors(name, 3, touch)[:, 2].astype(np.float64)
        else:
            # A clip without frames has no height: infinity is refused below.
            heights = np.array([each[:, 2].min(initial=np.inf) for each in self.cut(name, 3, touch)])
        finite = np.isfinite(heights)
        self._require_each(name, finite, touch, "a gel height of {}; expected metres", heights)
        return heights

    def stored_plate_z_m(self) -> float:
        """Return the stored height of the plate in a round, metres, cell frame; NaN without one."""
        stored = self.value(PLATE_COLUMN) if self.has(PLATE_COLUMN) else None
        return math.nan if stored is None else float(stored)

    def plate_z_m(self) -> float:
        """Return the known or stored height of the plate in a round, metres, cell frame; NaN without one."""
        is_known = ContactHeight.of(self.group.names).plate == "known"
        return PRESS_DEPTH_M if is_known else self.stored_plate_z_m()

    def plain_value(self, name: str) -> Any:
        """Return a field as numpy's scalar or Python's object.

        Raises InputError when the data set has no such column, IntegrityError when no value is stored, or
        text that is not Unicode.
        """
        try:
            value = self.value(name)
        except KeyError as error:
            raise self.missing_column(name) from error
        except _UNREADABLE:  # one such value spoils the column of its whole block
            value = self.stored_value(name)
        if value is None:
            raise self.damaged(name, "no value is stored")
        return value

    def integer(self, name: str) -> int:
        """Return a field as an int from 0 to below 2**63; IntegrityError for others, else as plain_value."""
        value = self.plain_value(name)
        if not isinstance(value, np.signedinteger):
            value = self.stored_value(name)  # a null next to it made numpy's column inexact
        number = whole_number(value)
        if number is None or number < 0:
            found = "no value is stored" if value is None else f"the value is {value}"
            raise self.damaged(name, f"{found}; expected an integer of 0 or more, below 2**63")
        return number

    def name(self) -> str:
        """Return the id, text or an integer, as text; raises as :meth:`integer`."""
        value = self.plain_value("id")
        return value if isinstance(value, str) else str(self.integer("id"))

    def label_value(self, names: Sequence[str] | None = None) -> int:
        """Return the class, -1 where it is not known, as `datasets` has it.

        Raises IntegrityError where it is not one of the classes, if those are named.
        """
        if self.plain_value("label") == -1:
            return -1
        label = self.integer("label")
        if names is not None and label >= len(names):
            limit = f"expected less than {len(names)}, the number of named classes"
            raise self.damaged("label", f"the value is {label}; {limit}")
        return label

    def stored_value(self, name: str) -> Any:
        """Return a field of any type as Python's objects, looking at no other row.

        Raises IntegrityError for text that is not Unicode.
        """
        try:
            return self.group.arrow(name)[self.index].as_py()
        except _UNREADABLE as error:
            raise self.damaged(name, f"a value that cannot be read ({error})") from error

    def has_info(self) -> bool:
        """Return whether a round has metadata."""
        return self.has("info") or any(name.startswith("info.") for name in self.group.names)

    def read_info(self) -> dict[str, Any]:
        """Read the metadata of a round; InputError when the data set does not store it.

        Raises IntegrityError for a pose that is not one, or one name for a value and for a group of values.
        """
        if not self.has_info():
            raise self.missing_column("info")
        nested: dict[str, Any] = {}
        for name in self.group.names:
            if not name.startswith("info."):
                continue
            # The published sets store the struct `info` as flat columns with dotted names.
            *outer, last = name.split(".")[1:]
            group: Any = nested
            for part in outer:
                if isinstance(group, dict):
                    group = group.setdefault(part, {})
            if not isinstance(group, dict) or last in group:
                raise self.damaged(name, "the name of a value and of a group of values; expected one of them")
            group[last] = self.stored_value(name)
        return {key: self._with_poses(value, f"info.{key}") for key, value in nested.items()}

    def _with_poses(self, value: Any, name: str) -> Any:
        """Put poses in place of groups of a position and a quaternion."""
        if not isinstance(value, dict):
            return value
        if value.keys() == {"position", "quaternion"}:
            return self._pose(value, name)
        return {key: self._with_poses(each, f"{name}.{key}") for key, each in value.items()}

    def _pose(self, values: dict[str, Any], name: str) -> Any:
        """Make the pose, or the poses where there is one per touch."""
        try:
            position = np.asarray(values["position"], np.float64)
            quaternion = np.asarray(values["quaternion"], np.float64)
        except (TypeError, ValueError) as error:
            problem = "values that are not numbers, or vectors of several lengths; expected a pose's numbers"
            raise self.damaged(name, problem) from error
        outer = position.shape[:-1]
        if len(outer) > 1 or position.shape != (*outer, 3) or quaternion.shape != (*outer, 4):
            found = f"position {position.shape} and quaternion {quaternion.shape}"
            raise self.damaged(name, f"{found}; expected (3,) and (4,), or (n, 3) and (n, 4)")
        wrong = bad_pose(position.reshape(-1, 3), quaternion.reshape(-1, 4))
        if wrong is not None:  # the metadata of a round are one thing: none of it can be given
            raise self.damaged(name, f"pose {wrong[0]}: {wrong[1]}" if outer else wrong[1])
        return Poses(position, quaternion) if outer else rigid_transform(position, quaternion)

    def __reduce__(self) -> tuple[Any, ...]:
        return (_unpickled, super().__reduce__())


def _unpickled(make: Callable[..., Row], arguments: tuple[Any, ...]) -> TouchRow:
    row = make(*arguments)
    return TouchRow(row.group, row.index)
