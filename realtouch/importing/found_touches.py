"""Touches to import, as columns: places of their pictures, fields and problems."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, overload

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from tactile_toolkit import errors
from tactile_toolkit.array_types import Bool, Int64
from tactile_toolkit.columns import column_types

_WHERE = pa.schema(
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
_PLACE_COLUMNS = ("home", "path", "part", "start", "size", "frames")

File = tuple[str, str]
"""Address of a source, and a path below it."""


class PicturePlace(NamedTuple):
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

    @property
    def file(self) -> File:
        """Folder and path of the file."""
        return self.home, self.path


@dataclass(frozen=True, slots=True, eq=False)
class FoundTouches(Sequence[PicturePlace]):
    """Touches to import; as a sequence, the places of their pictures.

    Attributes
    ----------
    where : pyarrow.Table
        A row for each touch. ``name``: name in messages. ``home`` to ``frames``: see :class:`PicturePlace`.
        ``contact``: first and last picture of a clip with contact, if known. ``time_s``: time of each picture
        of a clip, if known, seconds, not decreasing. ``reason``, ``problem``: why the touch cannot be used,
        else null. ``number``: number among all touches of the source. ``round``: round to store it in.
    said : pyarrow.Table
        Fields of each touch, by their names in the source; see :mod:`tactile_toolkit.column_types`.
    per_frame : pyarrow.Table
        Fields of each picture of a clip: lists with an entry for each picture, or null.
    """

    where: pa.Table
    said: pa.Table
    per_frame: pa.Table

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        home: str,
        paths: Sequence[str] | str,
        said: Mapping[str, pa.Array] | pa.Table,
        *,
        per_frame: Mapping[str, pa.Array] | None = None,
        problems: Mapping[int, errors.ItemError] | None = None,
        **columns: object,
    ) -> FoundTouches:
        """Return touches of one source; a single value of ``columns`` of ``where`` holds for all touches."""
        count = len(names)
        given = {"name": names, "home": home, "path": paths, "part": "", "start": 0, "size": 0, "frames": 0}
        given |= columns
        made = [_as_column(given.get(field.name), field.type, count) for field in _WHERE]
        found = cls(pa.table(made, schema=_WHERE), _table(said), _table(per_frame or {}))
        return found.with_problems(problems or {})

    @classmethod
    def joined(cls, parts: Sequence[FoundTouches]) -> FoundTouches:
        """Return the touches of several sources; the type of a column fits the values of all sources."""
        if len(parts) == 1:
            return parts[0]
        where = pa.concat_tables([_WHERE.empty_table(), *(part.where for part in parts)])
        said, per_frame = {}, {}
        for name in dict.fromkeys(name for part in parts for name in part.said.column_names):
            said[name] = column_types.joined([_column(part.said, name, len(part)) for part in parts])
        for name in dict.fromkeys(name for part in parts for name in part.per_frame.column_names):
            lists = [_column(part.per_frame, name, len(part)) for part in parts]
            per_frame[name] = column_types.joined_lists(lists)
        return cls(where.combine_chunks(), _table(said), _table(per_frame))

    def __len__(self) -> int:
        return len(self.where)

    @overload
    def __getitem__(self, number: int) -> PicturePlace: ...
    @overload
    def __getitem__(self, number: slice) -> FoundTouches: ...
    def __getitem__(self, number: int | slice) -> PicturePlace | FoundTouches:
        if isinstance(number, slice):
            return self.take(np.arange(len(self))[number])
        return next(iter(self.take(np.array([range(len(self))[number]]))))

    def __iter__(self) -> Iterator[PicturePlace]:
        return map(
            PicturePlace._make, zip(*(self.where[name].to_pylist() for name in _PLACE_COLUMNS), strict=True)
        )

    def take(self, rows: Int64) -> FoundTouches:
        """Return some touches in this order; the others are not kept in memory."""
        taken = pa.array(rows, pa.int64())
        return FoundTouches(*(each.take(taken) for each in (self.where, self.said, self.per_frame)))

    @property
    def is_usable(self) -> Bool:
        """Whether each touch has no problem, shape (n,)."""
        found: Bool = pc.is_null(self.where["problem"]).to_numpy()
        return found

    @property
    def has_clips(self) -> bool:
        """Whether the touches are clips; the first touch decides."""
        return bool(len(self)) and self.where["frames"][0].as_py() > 0

    @property
    def names(self) -> list[str]:
        """Names of all fields, in order."""
        return list(dict.fromkeys([*self.said.column_names, *self.per_frame.column_names]))

    @property
    def known(self) -> set[str]:
        """Names of the fields that at least one touch has."""
        tables = (self.said, self.per_frame)
        return {
            name for table in tables for name in table.column_names if table[name].null_count < len(table)
        }

    def value(self, name: str) -> pa.Array | None:
        """Return a field of the touches as a column; None if there is no such field."""
        return one_chunk(self.said[name]) if name in self.said.column_names else None

    @property
    def picture_counts(self) -> Int64:
        """Number of pictures of each touch, shape (n,): those of a clip, or one."""
        frames: Int64 = self.where["frames"].to_numpy()
        return frames if self.has_clips else np.ones_like(frames)

    def of_frames(self, name: str) -> pa.Array:
        """Return a field of the pictures of each clip, as lists.

        Where pictures have no values, each has the value of the clip.
        """
        values = one_chunk(self.per_frame[name])
        if not values.null_count:
            return values
        whole, inside = _column(self.said, name, len(self)), values.flatten()
        is_known = values.is_valid().to_numpy(zero_copy_only=False)
        known = pc.list_value_length(values).fill_null(0).to_numpy()
        lengths = np.where(is_known, known, self.where["frames"].to_numpy())
        entries = column_types.joined([inside, whole])
        of_clips = np.repeat(np.arange(len(self)), lengths)
        rows = len(inside) + of_clips
        rows[is_known[of_clips]] = np.arange(len(inside))
        return column_types.lists_of(entries.take(pa.array(rows)), lengths)

    def of_pictures(self, name: str) -> pa.Array:
        """Return a field as a column with an entry for each picture of all touches; null without a value."""
        if name in self.per_frame.column_names:
            return self.of_frames(name).flatten()
        whole = _column(self.said, name, len(self))
        return whole.take(pa.array(np.repeat(np.arange(len(self)), self.picture_counts)))

    def texts(self, name: str | None) -> list[str]:
        """Return a field of each touch as text; empty where there is no value."""
        column = self.value(name) if name else None
        if column is None:
            return [""] * len(self)
        return texts_in(column_types.texts_of(column).fill_null(""))

    def with_where(self, **columns: object) -> FoundTouches:
        """Return the touches with other columns of ``where``."""
        where = self.where
        for name, values in columns.items():
            field = _WHERE.field(name)
            column = _as_column(values, field.type, len(self))
            where = where.set_column(_WHERE.get_field_index(name), field, column)
        return replace(self, where=where)

    def with_said(self, columns: Mapping[str, pa.Array]) -> FoundTouches:
        """Return the touches with fields added or replaced."""
        said = dict(zip(self.said.column_names, self.said.columns, strict=True))
        return replace(self, said=_table({**said, **columns}))

    def with_problems(self, problems: Mapping[int, errors.ItemError]) -> FoundTouches:
        """Return the touches with problems added, by index; the first problem of a touch is kept."""
        if not problems:
            return self
        reasons, messages = (self.where[name].to_pylist() for name in ("reason", "problem"))
        for number, error in problems.items():
            if messages[number] is None:
                reasons[number], messages[number] = error.reason, error.message
        return self.with_where(reason=reasons, problem=messages)

    def problems(self) -> Iterator[tuple[int, str, errors.ItemError]]:
        """Yield number, name and problem of each touch that cannot be used."""
        held = self.where.filter(pc.is_valid(self.where["problem"]))
        for row in held.select(["number", "name", "reason", "problem"]).to_pylist():
            yield row["number"], row["name"], errors.ItemError(row["reason"], row["problem"])


def texts_in(column: pa.Array | pa.ChunkedArray) -> list[str]:
    """Return a column as a list of texts; equal texts are one object, which saves memory."""
    found = one_chunk(column) if isinstance(column, pa.ChunkedArray) else column
    encoded = found.dictionary_encode()
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


def _table(columns: Mapping[str, object] | pa.Table) -> pa.Table:
    return columns if isinstance(columns, pa.Table) else pa.table(dict(columns))


def ranges_of(sizes: Sequence[int], most_bytes: int) -> Iterator[slice]:
    """Divide items, given their sizes in bytes, into parts of at most ``most_bytes``.

    An item that is larger is a part of its own.
    """
    start = size_bytes = 0
    for number, size in enumerate(sizes):
        if size_bytes + size > most_bytes and number > start:
            yield slice(start, number)
            start, size_bytes = number, 0
        size_bytes += size
    yield slice(start, len(sizes))


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
