"""Touches and recordings of a source, as columns: where their pictures are, fields and problems."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import repeat
from typing import Any, NamedTuple, overload

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from realtouch.video.avi import MAX_CLIP_FRAMES
from tactile_toolkit import errors, wording
from tactile_toolkit.columns import column_types
from tactile_toolkit.value_types import Bool, Float64, Int64

_LISTING = pa.schema(
    {
        "name": pa.string(),
        "home": pa.string(),
        "path": pa.string(),
        "part": pa.string(),
        "start": pa.int64(),
        "size": pa.int64(),
        "frames": pa.int64(),
        "contact": pa.list_(pa.int64()),
        "time_s": pa.list_(pa.float64()),
        "reason": pa.string(),
        "problem": pa.string(),
        "number": pa.int64(),
        "round": pa.string(),
    }
)
_LOCATION_COLUMNS = ("home", "path", "part", "start", "size", "frames")
File = tuple[str, str]
"""Address of a source, and a path below it."""

CUTS = ("frames", "whole", "contact")
"""How recordings become touches without a table: each picture, the whole, or clips found by contact."""
EXCLUDED = "excluded"
"""Reason of a touch that the source itself leaves out."""
TIME_S = "time_s"
"""Name of the field with the time of a picture of a recording, seconds."""
_ROUND = "round_id"
_SHORTER = "cut it into touches with `--cut contact` or a table of times (`--cut TABLE`)"


class PictureLocation(NamedTuple):
    """Where the pictures of a touch are: all that the reader of a format needs.

    Attributes
    ----------
    home, path : str
        Address of the source, and the file below it that holds the pictures.
    part : str
        Part of a file with several sequences of pictures. Only the reader of the format uses it.
    start, size : int
        Offset of the picture in the file and its size, bytes. For a recording, the number of the first
        picture and the approximate size of all pictures.
    frames : int
        Number of pictures of a clip; 0 for a single image.
    """

    home: str
    path: str
    part: str = ""
    start: int = 0
    size: int = 0
    frames: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class SourceTouches(Sequence[PictureLocation]):
    """Touches to import; as a sequence, the locations of their pictures.

    Attributes
    ----------
    listing : pyarrow.Table
        A row for each touch. ``name``: name in messages. ``home`` to ``frames``: a :class:`PictureLocation`.
        ``contact``: first and last picture of a clip with contact, if known. ``time_s``: time of each picture
        of a clip, if known, seconds, not decreasing. ``reason``, ``problem``: why the touch cannot be used,
        else null. ``number``: number among all touches of the source. ``round``: round to store it in.
    per_touch : pyarrow.Table
        Fields of each touch, by their names in the source; see :mod:`tactile_toolkit.columns.column_types`.
    per_frame : pyarrow.Table
        Fields of each picture of a clip: lists with an entry for each picture, or null.
    stored : pyarrow.Table
        Columns of the data set that follow from the fields, with an entry for each touch.
    """

    listing: pa.Table
    per_touch: pa.Table
    per_frame: pa.Table
    stored: pa.Table = field(default_factory=lambda: pa.table({}))

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        home: str,
        paths: Sequence[str] | str,
        fields: Mapping[str, pa.Array] | pa.Table,
        *,
        per_frame: Mapping[str, pa.Array] | None = None,
        problems: Mapping[int, errors.ItemError] | None = None,
        **columns: object,
    ) -> SourceTouches:
        """Return touches of one source; a single value in ``columns`` of the listing holds for all."""
        count = len(names)
        columns_given = {
            "name": names,
            "home": home,
            "path": paths,
            "part": "",
            "start": 0,
            "size": 0,
            "frames": 0,
        }
        columns_given |= columns
        made = [_as_column(columns_given.get(field.name), field.type, count) for field in _LISTING]
        per_touch = fields if isinstance(fields, pa.Table) else pa.table(dict(fields))
        touches = cls(pa.table(made, schema=_LISTING), per_touch, pa.table(dict(per_frame or {})))
        return touches.with_problems(problems or {})

    @classmethod
    def joined(cls, parts: Sequence[SourceTouches]) -> SourceTouches:
        """Return the touches of several sources; the type of a column fits the values of all sources."""
        if len(parts) == 1:
            return parts[0]
        listing = pa.concat_tables([_LISTING.empty_table(), *(part.listing for part in parts)])
        counts = list(map(len, parts))
        per_touch = _columns_of([part.per_touch for part in parts], counts)
        lists = _columns_of([part.per_frame for part in parts], counts)
        return cls(
            listing.combine_chunks(),
            pa.table({name: column_types.joined(columns) for name, columns in per_touch.items()}),
            pa.table({name: column_types.joined(columns) for name, columns in lists.items()}),
        )

    def __len__(self) -> int:
        return len(self.listing)

    @overload
    def __getitem__(self, number: int) -> PictureLocation: ...
    @overload
    def __getitem__(self, number: slice) -> SourceTouches: ...
    def __getitem__(self, number: int | slice) -> PictureLocation | SourceTouches:
        if isinstance(number, slice):
            return self.take(np.arange(len(self))[number])
        return next(iter(self.take(np.array([range(len(self))[number]]))))

    def __iter__(self) -> Iterator[PictureLocation]:
        return map(
            PictureLocation._make,
            zip(*(self.listing[name].to_pylist() for name in _LOCATION_COLUMNS), strict=True),
        )

    def take(self, rows: Int64) -> SourceTouches:
        """Return some touches in this order; the others are not kept in memory."""
        taken = pa.array(rows, pa.int64())
        tables = (self.listing, self.per_touch, self.per_frame, self.stored)
        return SourceTouches(*(table.take(taken) for table in tables))

    @property
    def is_usable(self) -> Bool:
        """Whether each touch has no problem, shape (n,)."""
        usable: Bool = pc.is_null(self.listing["problem"]).to_numpy()
        return usable

    @property
    def has_clips(self) -> bool:
        """Whether the touches are clips: those that can be used, if there are any."""
        is_clip = self.listing["frames"].to_numpy() > 0
        usable = self.is_usable
        return bool(is_clip[usable].any() if usable.any() else is_clip.any())

    @property
    def names(self) -> list[str]:
        """Names of all fields, in order."""
        return list(dict.fromkeys([*self.per_touch.column_names, *self.per_frame.column_names]))

    @property
    def known(self) -> set[str]:
        """Names of the fields that at least one touch has."""
        tables = (self.per_touch, self.per_frame)
        return {
            name for table in tables for name in table.column_names if table[name].null_count < len(table)
        }

    def value(self, name: str) -> pa.Array | None:
        """Return a field of the touches as a column; None if there is no such field."""
        # Not by the list of all names, which takes a millisecond for a thousand columns.
        index = self.per_touch.schema.get_field_index(name)
        return one_chunk(self.per_touch.column(index)) if index >= 0 else None

    @property
    def picture_counts(self) -> Int64:
        """Number of pictures of each touch, shape (n,): those of a clip, or one."""
        frames: Int64 = self.listing["frames"].to_numpy()
        return frames if self.has_clips else np.ones_like(frames)

    @property
    def owners(self) -> Int64:
        """Number of the touch of each picture, shape (pictures,)."""
        return np.repeat(np.arange(len(self)), self.picture_counts)

    def of_frames(self, name: str) -> pa.Array:
        """Return a field of the pictures of each clip, as lists.

        Where pictures have no values, each has the value of the clip.
        """
        values = one_chunk(self.per_frame[name])
        if not values.null_count:
            return values
        whole = _column(self.per_touch, name, len(self))
        inside = values.flatten()
        is_known = values.is_valid().to_numpy(zero_copy_only=False)
        known = pc.list_value_length(values).fill_null(0).to_numpy()
        lengths = np.where(is_known, known, self.listing["frames"].to_numpy())
        entries = column_types.joined([inside, whole])
        of_clips = np.repeat(np.arange(len(self)), lengths)
        rows = len(inside) + of_clips
        rows[is_known[of_clips]] = np.arange(len(inside))
        return column_types.lists_of(entries.take(pa.array(rows)), lengths)

    def of_pictures(self, name: str) -> pa.Array:
        """Return a field as a column with an entry for each picture of all touches; null without a value."""
        if name in self.per_frame.column_names:
            return self.of_frames(name).flatten()
        whole = _column(self.per_touch, name, len(self))
        return whole.take(pa.array(self.owners))

    def texts(self, name: str | None) -> list[str]:
        """Return a field of each touch as text; empty where there is no value."""
        column = self.value(name) if name else None
        if column is None:
            return [""] * len(self)
        return texts_in(column_types.texts_of(column).fill_null(""))

    def with_listing(self, **columns: object) -> SourceTouches:
        """Return the touches with other columns of ``listing``."""
        listing = self.listing
        for name, values in columns.items():
            field = _LISTING.field(name)
            column = _as_column(values, field.type, len(self))
            listing = listing.set_column(_LISTING.get_field_index(name), field, column)
        return replace(self, listing=listing)

    def with_fields(self, columns: Mapping[str, pa.Array]) -> SourceTouches:
        """Return the touches with fields added or replaced."""
        fields = dict(zip(self.per_touch.column_names, self.per_touch.columns, strict=True))
        return replace(self, per_touch=pa.table({**fields, **columns}))

    def with_problems(self, problems: Mapping[int, errors.ItemError]) -> SourceTouches:
        """Return the touches with problems added, by index; the first problem of a touch is kept."""
        if not problems:
            return self
        reasons, messages = (self.listing[name].to_pylist() for name in ("reason", "problem"))
        for number, error in problems.items():
            if messages[number] is None:
                reasons[number], messages[number] = error.reason, error.message
        return self.with_listing(reason=reasons, problem=messages)

    def problems(self) -> Iterator[tuple[int, str, errors.ItemError]]:
        """Yield number, name and problem of each touch that cannot be used."""
        held = self.listing.filter(pc.is_valid(self.listing["problem"]))
        for row in held.select(["number", "name", "reason", "problem"]).to_pylist():
            yield row["number"], row["name"], errors.ItemError(row["reason"], row["problem"])


def texts_in(column: pa.Array | pa.ChunkedArray) -> list[str]:
    """Return a column as a list of texts; equal texts are one object, which saves memory."""
    values = one_chunk(column) if isinstance(column, pa.ChunkedArray) else column
    encoded = values.dictionary_encode()
    names: list[str] = encoded.dictionary.to_pylist()
    return [names[code] for code in encoded.indices.to_pylist()]


def one_chunk(column: pa.ChunkedArray) -> pa.Array:
    """Return a column of a table as an array."""
    if column.num_chunks == 1:
        return column.chunk(0)
    return pa.concat_arrays([pa.nulls(0, column.type), *column.chunks])


def _as_column(value: object, data_type: pa.DataType, count: int) -> pa.Array:
    """Return values as an array; a single one is repeated."""
    if isinstance(value, pa.Array):
        return value
    if value is None or isinstance(value, (str, int)):
        return pa.repeat(pa.scalar(value, data_type), count)
    return pa.array(value, data_type)


def _column(table: pa.Table, name: str, count: int) -> pa.Array:
    """Return a column of a table; nulls if there is no such column."""
    return one_chunk(table[name]) if name in table.column_names else pa.nulls(count)


def _columns_of(tables: Sequence[pa.Table], counts: Sequence[int]) -> dict[str, list[pa.Array]]:
    """Return the parts of each column of some tables, an array for each table; nulls where it has none."""
    names = dict.fromkeys(name for table in tables for name in table.column_names)
    return {name: list(map(_column, tables, repeat(name), counts)) for name in names}


def add_values(digest: Any, column: pa.Array) -> None:
    """Add the values of a column to a digest; the layout of the column in memory does not matter."""
    digest.update(column.is_null().to_numpy(zero_copy_only=False).tobytes())
    if pa.types.is_list(column.type):
        digest.update(pc.list_value_length(column).fill_null(0).to_numpy().tobytes())
        add_values(digest, column.flatten())
    elif pa.types.is_string(column.type) or pa.types.is_binary(column.type):
        content = column.cast(pa.binary()).fill_null(b"")
        digest.update(pc.binary_length(content).to_numpy().tobytes())
        digest.update(b"".join(content.to_pylist()))
    elif pa.types.is_temporal(column.type):
        add_values(digest, column.cast(pa.string()))
    elif not pa.types.is_null(column.type):
        numbers = column.cast(pa.int8()) if pa.types.is_boolean(column.type) else column
        digest.update(numbers.fill_null(0).to_numpy().tobytes())


@dataclass(frozen=True, slots=True)
class Clip:
    """Pictures of a recording that become a touch, from ``start`` to the one before ``stop``.

    ``contact`` is the first and last picture with contact, counted from the start of the clip. ``problem``
    says why the clip cannot be used. ``fields`` are those of the clip, which replace those of the recording.
    """

    start: int
    stop: int
    name: str
    contact: tuple[int, int] | None = None
    problem: errors.ItemError | None = None
    fields: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """Samples with other times than the pictures, or a row for each picture of a recording.

    Attributes
    ----------
    name : str
        Name in the summary, and prefix of columns whose names are taken.
    address : str
        Address, for messages.
    read : callable
        Returns the columns of some rows by their numbers, int64, shape (n,), n > 0, increasing.
    rows : int
        Number of rows.
    time_column : str
        Column of times among those that ``read`` returns; empty if there is none.
    time_s : ndarray of float64, shape (rows,), or None
        Times of samples, seconds, not decreasing; None if a row is a picture. If samples have the same time,
        the first of them counts.
    """

    name: str
    address: str
    read: Callable[[Int64], dict[str, pa.Array]] = field(repr=False)
    rows: int
    time_column: str = ""
    time_s: Float64 | None = field(default=None, repr=False)


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A sequence of pictures: an episode, a video, or an array.

    Attributes
    ----------
    name : str
        Name in messages, without file ending; also the round of its touches unless a column states one.
    home, path : str
        Address of the source, and the file below it that holds the pictures.
    part : str
        Part of that file. Only the reader of the format uses it, which gets it back in each location.
    first : int
        Number of its first picture in the file or array.
    frames : int
        Number of pictures.
    frame_bytes : int
        Approximate size of a picture in bytes.
    values : mapping
        Fields of the whole recording, by their names in the source.
    per_frame : mapping
        Fields of each picture: columns of ``frames`` values; see :mod:`tactile_toolkit.columns.column_types`.
    time_s : ndarray of float64, shape (frames,), or None
        Time of each picture, seconds, not decreasing.
    problem : ItemError or None
        Why it cannot be used.
    round : str
        Round of its clips, if that is not ``name``; pictures of a recording are always a round of their own.
    cut : str
        How it becomes touches by default, if the source states that; see :data:`CUTS`.
    contact : tuple of int or None
        First and last picture with contact, for a recording of one touch.
    left_out : tuple of str
        Data of the recording that are not imported, each with its shape or the reason.
    is_at_stated_rate : bool
        Whether its times follow from the rate that its file states, which is often not that of the camera.
    conversions : tuple of str
        How its pictures are converted, as single images and in clips; empty if they are stored as they are.
    streams : tuple of Stream
        Samples that its file holds beside the pictures, with times of the same clock.
    """

    name: str
    home: str
    path: str
    part: str
    first: int
    frames: int
    frame_bytes: int
    values: Mapping[str, object] = field(default_factory=dict)
    per_frame: Mapping[str, pa.Array] = field(default_factory=dict)
    time_s: Float64 | None = None
    problem: errors.ItemError | None = None
    round: str = ""
    cut: str = ""
    contact: tuple[int, int] | None = None
    left_out: tuple[str, ...] = ()
    is_at_stated_rate: bool = False
    conversions: tuple[str, str] = ("", "")
    streams: tuple[Stream, ...] = ()

    def location(self, start: int, stop: int) -> PictureLocation:
        """Return the location of the pictures from ``start`` to the one before ``stop``."""
        size = self.frame_bytes * (stop - start)
        count = stop - start
        return PictureLocation(self.home, self.path, self.part, self.first + start, size, count)

    def checked(self) -> Recording:
        """Return the recording, with a problem if it has no picture or its times cannot be used."""
        problem = self.problem
        if problem is None and not self.frames:
            problem = errors.ItemError("empty", "the recording has no picture")
        if problem is None and self.time_s is not None and len(self.time_s) != self.frames:
            problem_text = f"{wording.with_count(len(self.time_s), 'times')} of {self.frames:,} pictures"
            problem = errors.ItemError("time", f"{problem_text}; expected one for each")
        elif problem is None and self.time_s is not None:
            is_later = np.diff(self.time_s) >= 0  # False for NaN
            if not is_later.all():
                number = int(is_later.argmin()) + 1
                before, after = self.time_s[number - 1 : number + 1].tolist()
                problem_text = (
                    f"picture {number:,} was taken at {after:g} s, the one before it at {before:g} s"
                )
                problem = errors.ItemError("times", f"{problem_text}; expected times that do not decrease")
        return replace(self, problem=problem)

    def unusable(self, problem: errors.ItemError | None, name: str = "") -> Clip:
        """Return one clip with a problem: the recording, or a touch of it, cannot be used."""
        return Clip(0, min(self.frames, 1), name or self.name, problem=problem)

    def clips(self, clips: Sequence[Clip]) -> SourceTouches:
        """Return clips as touches; a clip that is too long has a problem."""
        if self.problem is not None:  # nothing is known about its pictures
            self = replace(self, per_frame={}, time_s=None)
        counts = np.array([clip.stop - clip.start for clip in clips], np.int64)
        rows = np.concatenate([np.arange(clip.start, clip.stop) for clip in clips])
        problems = {number: clip.problem for number, clip in enumerate(clips) if clip.problem is not None}
        for number in np.flatnonzero(counts > MAX_CLIP_FRAMES).tolist():
            problems.setdefault(
                number,
                errors.ItemError(
                    "length",
                    f"a clip of {counts[number]:,} pictures; the limit is {MAX_CLIP_FRAMES:,}",
                    next=_SHORTER,
                ),
            )
        own = dict.fromkeys(name for clip in clips for name in clip.fields)
        fields = self._repeated_fields(self.round or self.name, len(clips))
        for name in own:
            whole = self.values.get(name)
            fields[name] = column_types.column_of([clip.fields.get(name, whole) for clip in clips])
        taken = pa.array(rows)
        per_frame = {}
        for name, column in self.per_frame.items():
            per_frame[name] = column_types.lists_of(column.take(taken), counts)
        times = None
        if self.time_s is not None and self.frames:
            times = column_types.lists_of(pa.array(self.time_s[rows]), counts)
        return SourceTouches.of(
            [clip.name for clip in clips],
            self.home,
            self.path,
            fields,
            per_frame=per_frame,
            problems=problems,
            part=self.part,
            start=[self.first + clip.start for clip in clips],
            size=counts * self.frame_bytes,
            frames=counts,
            contact=[clip.contact for clip in clips],
            time_s=times,
        )

    def images(self) -> SourceTouches:
        """Return each picture as a touch, with the fields of the picture and of the recording."""
        stem = self.name.replace("/", "-")
        count = self.frames
        fields = {**self._repeated_fields(self.name, count), **self.per_frame}
        if self.time_s is not None and TIME_S not in self.per_frame:
            fields[TIME_S] = pa.array(self.time_s)
        return SourceTouches.of(
            [f"{stem}_{frame:06d}.png" for frame in range(count)],
            self.home,
            self.path,
            fields,
            part=self.part,
            start=np.arange(count) + self.first,
            size=self.frame_bytes,
        )

    def _repeated_fields(self, round_id: str, count: int) -> dict[str, pa.Array]:
        """Return the fields of the recording as columns with an entry for each of some touches."""
        values = {_ROUND: round_id, **self.values}
        return {name: repeated(value, count) for name, value in values.items()}


def repeated(value: object, count: int) -> pa.Array:
    """Return a column of one value."""
    return column_types.column_of([value]).take(pa.array(np.zeros(count, np.int64)))


def touches_of(recording: Recording, cut: str) -> SourceTouches:
    """Cut a recording into its pictures or take the whole, by the first two of :data:`CUTS`."""
    if recording.problem is not None:
        return recording.clips([recording.unusable(recording.problem)])
    if cut == "frames":
        return recording.images()
    return recording.clips([Clip(0, recording.frames, recording.name, recording.contact)])
