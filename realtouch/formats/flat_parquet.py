"""Parquet with a row for each touch, as `datasets`, pandas and polars read it: the rows are the format.

Files of other programs have the picture in a column of bytes, or of ``bytes`` and ``path`` as `datasets`
stores it. They are not trusted: Arrow allocates what the header of a page states, so headers are checked
before. A column of a row group is a sequence of pages. Each begins with a header in the compact protocol of
Thrift; its fields 2 and 3 are the sizes of the page, unpacked and stored.
"""

from __future__ import annotations

import urllib.parse
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import IO, TYPE_CHECKING, NamedTuple

import numpy as np
import pyarrow as pa

from realtouch.importing import import_options, source_files, source_touches
from realtouch.touches import schema as stored_schema
from tactile_toolkit import cache, errors, read, store
from tactile_toolkit.columns import column_types
from tactile_toolkit.value_types import JsonDict

if TYPE_CHECKING:
    from pyarrow import parquet as pq


_ENDING = ".parquet"
_SPLIT = "split"
_HIVE_NULL = "__HIVE_DEFAULT_PARTITION__"

# Columns of our exports. Those of the order repeat the ids and the order of the rows.
_OURS = {"id", "round_id", "label_name", "touch", "frame"}
_ORDER_COLUMNS = ("id", "touch", "frame")

_ROWS_AT_ONCE = 4096

# A value may be stored once and repeated in each row, so the stored size of a column says little.
_BYTES_AT_ONCE = 256 << 20
_TEXT = "BYTE_ARRAY"
_VALUE_BYTES = 8

_UNPACKED, _STORED = 2, 3  # fields of a header
_HEADER_BYTES = (1 << 10, 1 << 24)  # read at first, and for a long header; Arrow reads no longer ones
_MAX_PAGES = 1 << 20
_SPARE_BYTES = 100  # by which old writers understate the size of a column
_BOOLEANS = (1, 2)
_BYTE = 3
_INTEGERS = (4, 5, 6)
_DOUBLE = 7
_BINARY = 8
_LISTS = (9, 10)
_STRUCT = 12
_MAX_BITS = 63


def find_flat(
    home: store.DataFolder,
    columns: import_options.ImportColumns,
    table: str | None,
    ledger: source_files.Ledger,
) -> Iterator[source_touches.SourceTouches]:
    """Yield a touch for each row of each file, in their order; the split is that of the file's name."""
    home, paths = source_files.files_to_read(
        home, "Parquet files; expected a row for each touch in them", _parquet
    )
    for path in paths:
        try:
            parquet = ForeignParquet(home, path)
        except errors.ItemError as error:
            raise errors.InputError(f"{home.address(path)!r}: {error.what}") from error
        column = _picture_column(parquet, columns.image_name)
        yield _touches(home, path, parquet, column)


def _parquet(home: store.DataFolder) -> list[str]:
    return sorted(path for path in home.walk() if path.endswith(_ENDING) and not store.is_hidden(path))


def _picture_column(parquet: ForeignParquet, name: str) -> str:
    """Return the column of pictures: the named or the only one; InputError if there is no such column."""
    for stored in stored_schema.MEDIA_COLUMN.values():
        # In a data set of touches, it is a list with an entry for each touch.
        if stored in parquet.types and not is_picture(parquet.types[stored]):
            raise errors.InputError(
                f"{parquet.address!r} has the column {stored!r} of a data set of touches, "
                "which needs no import",
                next="open the data set by its folder, as with `tactile info`",
            )
    known = [column for column, data_type in parquet.types.items() if is_picture(data_type)]
    return source_files.chosen_pictures(known, name, parquet.address, "columns of pictures", parquet.types)


def _touches(
    home: store.DataFolder, path: str, parquet: ForeignParquet, column: str
) -> source_touches.SourceTouches:
    names = [name for name, data_type in parquet.types.items() if not is_picture(data_type)]
    size, stem = parquet.picture_bytes(column), path.removesuffix(_ENDING)
    shard = store.ShardName.parse(path.rpartition("/")[2])
    left_out = _ORDER_COLUMNS if {*names} >= _OURS else ()
    fields = parquet.columns([name for name in names if name not in left_out])
    if shard is not None and _SPLIT not in names:
        fields = {_SPLIT: source_touches.repeated(shard.split, len(parquet)), **fields}
    fields = {**_folder_values(path, len(parquet)), **fields}
    # The name of the file of each picture, without its folder.
    files = [source_files.path_of(name or "").rpartition("/")[2] for name in parquet.picture_names(column)]
    return source_touches.SourceTouches.of(
        [name or f"{stem}_{number:06d}" for number, name in enumerate(files)],
        home.address(),
        path,
        fields,
        part=column,
        start=np.arange(len(parquet)),
        size=size,
    )


def _folder_values(path: str, rows: int) -> dict[str, pa.Array]:
    """Return the columns that folders state, as Hive and Spark write them: ``label=3/part-0.parquet``."""
    values = {}
    for folder in path.split("/")[:-1]:
        name, _, value = folder.partition("=")
        if name and value and value != _HIVE_NULL:
            column = column_types.column_of(pa.array([urllib.parse.unquote(value)]), from_text=True)
            values[urllib.parse.unquote(name)] = column.take(pa.array(np.zeros(rows, np.int64)))
    return values


def is_picture(data_type: pa.DataType | None) -> bool:
    """Return whether a column may hold encoded pictures: bytes, or a struct with bytes."""
    if data_type is None:
        return False
    if pa.types.is_struct(data_type):
        index = data_type.get_field_index("bytes")
        return index >= 0 and is_picture(data_type.field(index).type)
    return bool(pa.types.is_binary(data_type))


class _Chunk(NamedTuple):
    """A column of a row group, as the footer states it; ``values`` includes the values in lists."""

    path: str
    size_bytes: int
    values: int
    is_text: bool
    start: int
    stored_bytes: int


class ForeignParquet:
    """A Parquet file below a source, whose content is not trusted.

    Raises ItemError if it is missing or outside the source, IntegrityError if it is damaged, and InputError
    if two columns have the same name.
    """

    def __init__(self, home: store.DataFolder, path: str) -> None:
        self.size_bytes = home.size_inside(path)
        self._home, self._path = home, path
        self.address = home.address(path)
        with _named_values(self.address):
            source = self.address if home.is_local else home.open(path)
            self._file = store.open_checked(source, checks_columns=True)
            schema = read.supported_table(self._file.schema_arrow.empty_table()).schema
            metadata = self._file.metadata
            groups = list(map(metadata.row_group, range(metadata.num_row_groups)))
            self._chunks = [_chunks(group) for group in groups]
        self.types: dict[str, pa.DataType] = dict(zip(schema.names, schema.types, strict=True))
        if len(self.types) < len(schema.names):
            raise errors.InputError(f"{self.address!r} has two columns of one name; expected different names")
        self._starts: list[int] = np.cumsum([0, *(group.num_rows for group in groups)]).tolist()

    def __len__(self) -> int:
        return self._starts[-1]

    def picture_bytes(self, name: str) -> int:
        """Return the approximate size of a picture of a column in bytes."""
        size = sum(chunk.size_bytes for group in self._chunks for chunk in _of_columns(group, [name]))
        return size // max(1, len(self)) + 1

    def rows(self, names: Sequence[str]) -> Iterator[JsonDict]:
        """Yield some columns of each row; InputError for more than may be unpacked."""
        for table in self._bounded(names):
            with _named_values(self.address):
                rows = table.to_pylist()
            yield from rows or ({} for _ in range(len(table)))

    def columns(self, names: Sequence[str]) -> dict[str, pa.Array]:
        """Return columns with an entry for each row; see :mod:`tactile_toolkit.columns.column_types`.

        Raises as :meth:`rows` does.
        """
        parts = list(self._bounded(names))
        if not parts:
            return {name: pa.nulls(0) for name in names}
        with _named_values(self.address):
            joined = pa.concat_tables(parts)
            return {name: column_types.column_of(joined[name]) for name in names}

    def picture_names(self, name: str) -> list[str | None]:
        """Return the paths that a column of pictures states; None for a picture without a path."""
        if not pa.types.is_struct(self.types[name]) or self.types[name].get_field_index("path") < 0:
            return [None] * len(self)
        paths = list[str | None]()
        for table in self._bounded([f"{name}.path"]):
            values = table[name].combine_chunks().to_pylist()
            paths += [
                value["path"] if isinstance((value or {}).get("path"), str) else None for value in values
            ]
        return paths

    def pictures(self, name: str, rows: Iterable[int]) -> Iterator[bytes | errors.ItemError]:
        """Yield the encoded picture of each of some rows; rows in ascending order are read once."""
        group = -1
        start = 0
        held = list[bytes | None]()
        batches: Iterator[pa.Table] = iter(())
        for row in rows:
            if not 0 <= row < len(self):
                yield errors.ItemError("missing", f"no row {row:,}; expected fewer than {len(self):,}")
                continue
            if not start <= row < start + len(held):
                holding = bisect_right(self._starts, row) - 1
                if holding != group or row < start:
                    group = holding
                    start = self._starts[holding]
                    held = []
                    batches = self._tables(group, [name])
                while row >= start + len(held):
                    start = start + len(held)
                    held = _picture_bytes(next(batches)[name].combine_chunks())
            yield held[row - start] or errors.ItemError(
                "missing", f"row {row:,} of {name!r} holds no bytes; expected a picture"
            )

    def _bounded(self, names: Sequence[str]) -> Iterator[pa.Table]:
        """Yield some columns of all rows, a few rows at a time; InputError for more than may be unpacked."""
        stated = [chunk for group in self._chunks for chunk in _of_columns(group, names)]
        unpacked = sum(max(chunk.size_bytes, _VALUE_BYTES * chunk.values) for chunk in stated)
        cache.require_unpackable(unpacked, f"{self.address!r}:", self.size_bytes)
        unpacked = 0
        for group in range(len(self._chunks)):
            for table in self._tables(group, names):
                unpacked += table.nbytes
                cache.require_unpackable(unpacked, f"{self.address!r}:", self.size_bytes)
                yield table

    def _tables(self, group: int, names: Sequence[str]) -> Iterator[pa.Table]:
        """Yield the rows of a row group, a few at a time; IntegrityError if it holds fewer than stated."""
        chunks = _of_columns(self._chunks[group], names)
        largest = max((1, *(chunk.size_bytes for chunk in chunks if chunk.is_text)))
        rows = min(_ROWS_AT_ONCE, max(1, _BYTES_AT_ONCE // largest))
        missing = self._starts[group + 1] - self._starts[group]
        with _named_values(self.address), self._home.open_inside(self._path) as stream:
            for chunk in chunks:
                require_bounded_pages(stream, chunk.start, chunk.stored_bytes, _BYTES_AT_ONCE)
        with store.named_damage(self.address):
            # Arrow uses no threads of its own, as shards are imported in parallel.
            for batch in self._file.iter_batches(rows, [group], list(names), use_threads=False):
                missing -= len(batch)
                yield read.supported_table(pa.Table.from_batches([batch]))
        if missing:
            raise errors.IntegrityError.in_file(
                self.address,
                f" is damaged, row group {group} holds {missing:,} rows fewer than its footer states",
            )


def _chunks(group: pq.RowGroupMetaData) -> list[_Chunk]:
    """Return the columns of a row group; for a struct or list, the columns in it."""
    columns = map(group.column, range(group.num_columns))
    return [
        _Chunk(
            of.path_in_schema,
            of.total_uncompressed_size,
            of.num_values,
            of.physical_type == _TEXT,
            min(of.data_page_offset, of.dictionary_page_offset or of.data_page_offset),
            of.total_compressed_size,
        )
        for of in columns
    ]


def _picture_bytes(pictures: pa.Array) -> list[bytes | None]:
    """Return the bytes of each picture; None for a missing one."""
    if pa.types.is_struct(pictures.type):
        pictures = pictures.flatten()[pictures.type.get_field_index("bytes")]
    contents: list[bytes | None] = pictures.to_pylist()
    return contents


def _of_columns(chunks: Sequence[_Chunk], names: Sequence[str]) -> list[_Chunk]:
    prefixes = tuple(f"{name}." for name in names)
    return [chunk for chunk in chunks if f"{chunk.path}.".startswith(prefixes)]


@contextmanager
def _named_values(address: str) -> Iterator[None]:
    """Turn errors about values that Python and NumPy do not have into an IntegrityError."""
    try:
        with store.named_damage(address):
            yield
    except (ValueError, OverflowError) as error:
        raise errors.IntegrityError.in_file(
            address, f" holds a value that cannot be read ({error})"
        ) from error


def read_rows(
    home: store.DataFolder, picture: source_touches.PictureLocation, numbers: Sequence[int]
) -> Iterator[bytes | errors.ItemError]:
    """Yield the pictures of some rows; ``part`` of the location is their column."""
    return ForeignParquet(home, picture.path).pictures(picture.part, numbers)


read_contents = partial(source_files.pictures_by_file, read_rows)


def require_bounded_pages(stream: IO[bytes], start: int, stored_bytes: int, most_bytes: int) -> None:
    """Raise ValueError if a page in a range of a file states more bytes than it can have.

    ``most_bytes`` is the limit for an unpacked page.
    """
    at = start
    end = start + stored_bytes
    for _ in range(_MAX_PAGES):
        if at >= end:
            return
        sizes, length = _header(stream, at)
        unpacked, stored = (sizes.get(field, -1) for field in (_UNPACKED, _STORED))
        at += length + stored
        if not (0 <= unpacked <= most_bytes and stored >= 0 and at <= end + _SPARE_BYTES):
            raise ValueError(
                f"a page of {unpacked:,} bytes, {stored:,} stored; "
                f"expected at most {most_bytes:,} in {stored_bytes:,}"
            )
    raise ValueError(f"more than {_MAX_PAGES:,} pages in {stored_bytes:,} bytes")


def _header(stream: IO[bytes], at: int) -> tuple[dict[int, int], int]:
    """Return the integers in the header of a page by their fields, and the length of the header."""
    for most in _HEADER_BYTES:
        stream.seek(at)
        data = stream.read(most)
        integers: dict[int, int] = {}
        try:
            return integers, _end_of_struct(data, 0, integers)
        except (IndexError, RecursionError):
            continue
    raise ValueError("a page without a whole header")


def _end_of_struct(data: bytes, at: int, integers: dict[int, int]) -> int:
    """Return the end of a struct; IndexError if that is beyond the data."""
    field = 0
    while data[at]:
        step = data[at] >> 4
        kind = data[at] & 15
        at = at + 1
        field = field + step
        if not step:
            field, at = _varint(data, at)
        start = at
        at = _end_of_value(data, at, kind)
        if kind in _INTEGERS:
            value = _varint(data, start)[0]
            integers[field] = (value >> 1) ^ -(value & 1)
    return at + 1


def _end_of_value(data: bytes, at: int, kind: int) -> int:
    if kind in _INTEGERS:
        return _varint(data, at)[1]
    if kind == _STRUCT:
        return _end_of_struct(data, at, {})
    if kind == _BINARY:
        length, at = _varint(data, at)
        return at + length
    if kind in _LISTS:
        count = data[at] >> 4
        element = data[at] & 15
        at = at + 1
        if count == 15:
            count, at = _varint(data, at)
        if element in _BOOLEANS:
            element = _BYTE
        for _ in range(count):
            _ = data[at]  # raises IndexError at the end of the data
            at = _end_of_value(data, at, element)
        return at
    sizes = {**dict.fromkeys(_BOOLEANS, 0), _BYTE: 1, _DOUBLE: 8}
    if kind not in sizes:
        raise ValueError(f"a header of a page with a value of type {kind}")
    return at + sizes[kind]


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, _MAX_BITS + 1, 7):
        value |= (data[at] & 127) << shift
        at += 1
        if data[at - 1] < 128:
            return value, at
    raise ValueError("a header of a page with a number of more than 64 bits")
