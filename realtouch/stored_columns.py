"""Columns of a stored round, with one entry per touch or per frame; checked on reading.

T is the number of touches of the round, N_i the number of frames of touch i: the stated length of its clip,
to which entries per frame are cut. What is wrong with a value is a :class:`Damage`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from realtouch import avi, extras, schema
from tactile_toolkit import errors, read, wording
from tactile_toolkit.array_types import AnyArray, Bool, Float64, Floating, Int64
from tactile_toolkit.json_types import JsonValue
from tactile_toolkit.read import NestedColumn, Row, checked_index, whole_number, whole_numbers
from tactile_toolkit.touch import MEDIA_COLUMN, Kind

_NEXT = "run `realtouch verify` to list everything that is wrong, then download or convert again"

_FIELD = re.compile(r"field '([^']+)': (.*)")

# The first of these that exists gives the number of touches; poses only if no other column was read.
_COUNTED = (
    "pos_in_cell",
    "sensor_image",
    "sensor_video",
    "gel_pose_cell_frame.position",
    "gel_pose_cell_frame_seq.position",
)

_UNREADABLE = (ValueError, pa.ArrowException)

_TOO_LONG = f"a clip of {{:,}} frames; expected an integer of 0 to {avi.MAX_CLIP_FRAMES:,}"


@dataclass(frozen=True, slots=True)
class Damage:
    """Damage of a file, round or touch.

    Attributes
    ----------
    file : str
        Parquet file.
    row : int or None
        Row in that file, the first one if the problem names several; None if the whole file is meant.
    touch : int or None
        Touch of the round; None if the whole round is meant.
    field : str
        Column; empty if no single column is meant.
    problem : str
        What was found, and what was expected.
    """

    file: str
    row: int | None
    touch: int | None
    field: str
    problem: str

    def __str__(self) -> str:
        named: dict[str, object] = {"row": self.row, "touch": self.touch}
        if self.field:
            named["field"] = repr(self.field)
        parts = [f"{name} {value}" for name, value in named.items() if value is not None]
        return f"{', '.join([repr(self.file), *parts])}: {self.problem}"


class DamagedRoundError(errors.IntegrityError):
    """An :class:`IntegrityError` that carries its :class:`Damage`; internal, catch ``IntegrityError``."""

    def __init__(self, damage: Damage) -> None:
        super().__init__(damage, next=_NEXT)
        self.damage = damage

    def __reduce__(self) -> tuple[object, ...]:
        return (DamagedRoundError, (self.damage,))


def unreadable_file(path: str, error: errors.ToolkitError) -> Damage:
    """Return the damage of an entire file, from the error that opening it raised."""
    words = _cause(path, error)
    named = _FIELD.match(words)
    if named is None:
        return Damage(path, None, None, "", words)
    return Damage(path, None, None, named[1], named[2])


def unreadable_rows(shard: read.Shard, index: int, error: errors.IntegrityError) -> Damage:
    """Return the damage of a row group, from the error that reading it raised; ``row`` is its first row."""
    first, last = shard.group_starts[index], shard.group_starts[index + 1] - 1
    rows = f"rows {first} to {last} cannot be read" if last > first else "cannot be read"
    found = " ".join(str(error.__cause__ or _cause(shard.path, error)).split())
    return Damage(shard.path, first, None, "", f"{rows} ({found}); expected a whole Parquet file")


def _cause(path: str, error: errors.ToolkitError) -> str:
    """Return the message of an error without file and next step, which a list states once."""
    words = " ".join(error.what.split())
    return words.removeprefix(repr(path)).lstrip(",: ")


class StoredColumns(Row):
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
        return schema.has_poses(self.group.names)

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

    def missing_column(self, field: str) -> errors.InputError:
        """Return the error for a requested column that the data set does not have."""
        return errors.InputError(
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
        """Return T: the number of intended positions, else of images or clips, else of poses."""
        # Cached for a block of rows, as it is used for each touch.
        name = next(filter(self.has, _COUNTED), _COUNTED[0])
        starts = self.group.once("starts of touches", lambda: self.column_of(name).levels[0])
        if isinstance(starts, int):
            return starts
        return int(starts[self.index + 1] - starts[self.index])

    def entries_of(self, name: str, touch: int | None = None) -> tuple[NestedColumn, int, int]:
        """Return a column and the range of its entries that belong to the round, or to one touch.

        Raises IntegrityError unless the round has T entries, IndexError if it has no such touch.
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
        for name in schema.per_touch_columns(self.group.names):
            self.entries_of(name)

    def require_each(self, name: str, good: Bool, touch: int | None, problem: str, *found: AnyArray) -> None:
        """Raise IntegrityError for the first entry of touches that is not good.

        ``touch`` is the number of the first entry; the value ``found`` there is put into ``problem``.
        """
        if not good.all():
            wrong = int(np.argmin(good))
            raise self.damaged(name, problem.format(*(each[wrong] for each in found)), (touch or 0) + wrong)

    def per_touch(self, name: str, touch: int | None = None) -> AnyArray:
        """Return one value per touch, (T,), or that of ``touch``, (1,); IntegrityError unless there are T."""
        column, start, stop = self.entries_of(name, touch)
        values: AnyArray = column.values[start:stop]
        return values

    def vectors(self, name: str, width: int, touch: int | None = None) -> Floating:
        """Return one vector per touch, shape (T, width), or that of ``touch``, (1, width), a view.

        Raises IntegrityError for other numbers of values.
        """
        column, start, stop = self.entries_of(name, touch)
        values = column.flat(1, start, stop)
        touches = stop - start
        if len(values) != touches * width:
            problem = (
                f"{wording.with_count(len(values), 'values')} for {touches} touches; expected {width} each"
            )
            if touch is not None:
                problem = f"{wording.with_count(len(values), 'values')}; expected {width}"
            raise self.damaged(name, problem, touch)
        return values.reshape(touches, width)

    def readable(self, read: Callable[[int | None], AnyArray], shape: tuple[int, ...] = ()) -> Float64:
        """Read a value of all touches, shape (T, ...), float64; NaN for damaged touches."""
        try:
            return read(None).astype(np.float64)
        except errors.IntegrityError:
            # Touch by touch only if something is damaged; all at once is many times as fast.
            known = np.full((self.touch_total(), *shape), np.nan)
        for touch in range(len(known)):
            with suppress(errors.IntegrityError):
                known[touch] = read(touch)[0]
        return known

    def clip_lengths(self) -> Int64:
        """Return the number of frames of each clip, shape (T,).

        Raises IntegrityError for lengths that are missing, negative or beyond the limit.
        """
        values = self.per_touch("video_length_frames")
        # False for NaN, which stands for a missing one.
        possible = (values >= 0) & (values <= avi.MAX_CLIP_FRAMES) & whole_numbers(values)
        self.require_each("video_length_frames", possible, None, _TOO_LONG, values)
        return values.astype(np.int64, copy=False)

    def clip_length(self, touch: int) -> int:
        """Return the number of frames of one clip; raises as :func:`clip_lengths`."""
        column, place, _ = self.entries_of("video_length_frames", touch)
        frames = column.values[place]
        if not (0 <= frames <= avi.MAX_CLIP_FRAMES and int(frames) == frames):
            raise self.damaged("video_length_frames", _TOO_LONG.format(frames), touch)
        return int(frames)

    def cut(self, name: str, width: int, touch: int | None = None) -> tuple[AnyArray, ...]:
        """Return a sequence per touch, or that of ``touch``, cut to the length of its clip, (N_i, width).

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
        # Counted for a single touch as well; else missing values would be read from the next round.
        column, first, _ = self.entries_of(name)
        start, stop = column.inside(1, first + touch, first + touch + 1)
        wanted = self.clip_length(touch)
        if wanted > stop - start:
            raise self.damaged(name, f"{stop - start} frames; expected at least {wanted}", touch)
        values = column.flat(2, start, start + wanted) if width else column.values[start : start + wanted]
        if len(values) != wanted * max(width, 1):
            raise self.damaged(
                name,
                f"{wording.with_count(len(values), 'values')} for {wanted} frames; expected "
                f"{max(width, 1)} each",
                touch,
            )
        return values.reshape(wanted, width) if width else values

    def extra_entries(self, name: str) -> pa.Array:
        """Return the T entries of a further column, by its stored name; IntegrityError unless there are T."""
        self.entries_of(name)
        entries = self.group.arrow(name)[self.index].values
        if entries is None:  # a list of fixed length hides a null
            raise self.damaged(name, "no values are stored")
        return entries

    def extra_of_frames(self, name: str, entries: pa.Array, touch: int, count: int) -> pa.Array:
        """Return what a further column, given its entries, has for the first frames of a clip.

        Values that are missing for the whole clip are null. Raises IntegrityError for fewer than ``count``.
        """
        frames = entries[touch].values
        if frames is None:
            return pa.nulls(count, entries.type.value_type)
        if len(frames) < count:
            found = wording.with_count(len(frames), "frames")
            raise self.damaged(name, f"{found}; expected at least {count}", touch)
        return frames.slice(0, count)

    def extra_values(self, name: str) -> AnyArray | tuple[AnyArray, ...]:
        """Return a further column by its own name; see :class:`realtouch.extras.Extras`.

        Raises InputError, which is a KeyError too, without such a column, IntegrityError if it is damaged.
        """
        known = schema.extra_columns(self.group.names)
        if name not in known:
            raise extras.UnknownExtraError(name, self.path, known)
        stored, values = known[name], self.extra_entries(known[name])
        if not stored.startswith(schema.EXTRA_PREFIX["frame"]):
            with self.naming(stored):
                return extras.array_with_gaps(values)
        found = []
        for touch, length in enumerate(self.clip_lengths().tolist()):
            frames = self.extra_of_frames(stored, values, touch, length)
            with self.naming(stored, touch):
                found.append(extras.array_with_gaps(frames))
        return tuple(found)

    def plain_value(self, name: str) -> JsonValue:
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

    def stored_value(self, name: str) -> JsonValue:
        """Return a field of any type as Python's objects, without reading other rows.

        Raises IntegrityError for text that is not Unicode.
        """
        try:
            return self.group.arrow(name)[self.index].as_py()
        except _UNREADABLE as error:
            raise self.damaged(name, f"a value that cannot be read ({error})") from error

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
