"""Parquet files of other programs: columns as arrays, and pictures, a few of them in memory at a time."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pyarrow as pa

from realtouch import importing
from realtouch.formats.parquet_pages import require_bounded_pages
from tactile_toolkit import cache, errors, read, store
from tactile_toolkit.columns import column_types
from tactile_toolkit.json_types import JsonDict

if TYPE_CHECKING:
    from pyarrow import parquet as pq

_ROWS_AT_ONCE = 4096
# A value may be stored once and repeated in each row, so the stored size of a column says little.
_BYTES_AT_ONCE = 256 << 20
_TEXT = "BYTE_ARRAY"
_VALUE_BYTES = 8


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
        self.place = home.address(path)
        with _named_values(self.place):
            source = self.place if home.is_local else home.open(path)
            self._file = store.open_checked(source)
            schema, metadata = read.supported_schema(self._file.schema_arrow), self._file.metadata
            store.require_sound_columns(source, metadata, range(metadata.num_row_groups))
            groups = list(map(metadata.row_group, range(metadata.num_row_groups)))
            self._chunks = [_chunks(group) for group in groups]
        self.types: dict[str, pa.DataType] = dict(zip(schema.names, schema.types, strict=True))
        if len(self.types) < len(schema.names):
            raise errors.InputError(f"{self.place!r} has two columns of one name; expected different names")
        self._starts: list[int] = np.cumsum([0, *(group.num_rows for group in groups)]).tolist()

    def __len__(self) -> int:
        return self._starts[-1]

    def picture_bytes(self, name: str) -> int:
        """Return the approximate size of a picture of a column in bytes."""
        size = sum(each.size_bytes for group in self._chunks for each in _of_columns(group, [name]))
        return size // max(1, len(self)) + 1

    def rows(self, names: Sequence[str]) -> Iterator[JsonDict]:
        """Yield some columns of each row; InputError for more than may be unpacked."""
        for table in self._bounded(names):
            with _named_values(self.place):
                found = table.to_pylist()
            yield from found or ({} for _ in range(len(table)))

    def columns(self, names: Sequence[str]) -> dict[str, pa.Array]:
        """Return columns with an entry for each row; see :mod:`tactile_toolkit.column_types`.

        Raises as :meth:`rows` does.
        """
        found = list(self._bounded(names))
        if not found:
            return {name: pa.nulls(0) for name in names}
        with _named_values(self.place):
            joined = pa.concat_tables(found)
            return {name: column_types.from_arrow(joined[name]) for name in names}

    def picture_names(self, name: str) -> list[str | None]:
        """Return the paths that a column of pictures states; None for a picture without a path."""
        if not pa.types.is_struct(self.types[name]) or self.types[name].get_field_index("path") < 0:
            return [None] * len(self)
        found = list[str | None]()
        for table in self._bounded([f"{name}.path"]):
            values = table[name].combine_chunks().to_pylist()
            found += [
                value["path"] if isinstance((value or {}).get("path"), str) else None for value in values
            ]
        return found

    def pictures(self, name: str, rows: Iterable[int]) -> Iterator[bytes | errors.ItemError]:
        """Yield the encoded picture of each of some rows; rows in ascending order are read once."""
        group, start, held = -1, 0, list[bytes | None]()
        batches: Iterator[pa.Table] = iter(())
        for row in rows:
            if not 0 <= row < len(self):
                yield errors.ItemError("missing", f"no row {row:,}; expected fewer than {len(self):,}")
                continue
            if not start <= row < start + len(held):
                wanted = bisect_right(self._starts, row) - 1
                if wanted != group or row < start:
                    group, start, held = wanted, self._starts[wanted], []
                    batches = self._tables(group, [name])
                while row >= start + len(held):
                    start, held = start + len(held), _picture_bytes(next(batches)[name].combine_chunks())
            yield held[row - start] or errors.ItemError(
                "missing", f"row {row:,} of {name!r} holds no bytes; expected a picture"
            )

    def _bounded(self, names: Sequence[str]) -> Iterator[pa.Table]:
        """Yield some columns of all rows, a few rows at a time; InputError for more than may be unpacked."""
        stated = [each for group in self._chunks for each in _of_columns(group, names)]
        unpacked = sum(max(each.size_bytes, _VALUE_BYTES * each.values) for each in stated)
        cache.require_unpackable(unpacked, f"{self.place!r}:", self.size_bytes)
        unpacked = 0
        for group in range(len(self._chunks)):
            for table in self._tables(group, names):
                unpacked += table.nbytes
                cache.require_unpackable(unpacked, f"{self.place!r}:", self.size_bytes)
                yield table

    def _require_bounded_pages(self, chunks: Sequence[_Chunk]) -> None:
        with _named_values(self.place), self._home.open_inside(self._path) as stream:
            for each in chunks:
                require_bounded_pages(stream, each.start, each.stored_bytes, _BYTES_AT_ONCE)

    def _tables(self, group: int, names: Sequence[str]) -> Iterator[pa.Table]:
        """Yield the rows of a row group, a few at a time; IntegrityError if it holds fewer than stated."""
        chunks = _of_columns(self._chunks[group], names)
        largest = max((1, *(each.size_bytes for each in chunks if each.is_text)))
        rows = min(_ROWS_AT_ONCE, max(1, _BYTES_AT_ONCE // largest))
        missing = self._starts[group + 1] - self._starts[group]
        self._require_bounded_pages(chunks)
        with store.named_damage(self.place):
            # Arrow uses no threads of its own, as shards are imported in parallel.
            for batch in self._file.iter_batches(rows, [group], list(names), use_threads=False):
                missing -= len(batch)
                yield read.supported_table(pa.Table.from_batches([batch]))
        if missing:
            raise errors.IntegrityError.in_file(
                self.place,
                f" is damaged, row group {group} holds {missing:,} rows fewer than its footer states",
            )


def _chunks(group: pq.RowGroupMetaData) -> list[_Chunk]:
    """Return the columns of a row group; for a struct or list, the columns in it."""
    found = map(group.column, range(group.num_columns))
    return [
        _Chunk(
            of.path_in_schema,
            of.total_uncompressed_size,
            of.num_values,
            of.physical_type == _TEXT,
            min(of.data_page_offset, of.dictionary_page_offset or of.data_page_offset),
            of.total_compressed_size,
        )
        for of in found
    ]


def _picture_bytes(pictures: pa.Array) -> list[bytes | None]:
    """Return the bytes of each picture; None for a missing one."""
    if pa.types.is_struct(pictures.type):
        pictures = pictures.flatten()[pictures.type.get_field_index("bytes")]
    found: list[bytes | None] = pictures.to_pylist()
    return found


def _of_columns(chunks: Sequence[_Chunk], names: Sequence[str]) -> list[_Chunk]:
    prefixes = tuple(f"{name}." for name in names)
    return [each for each in chunks if f"{each.path}.".startswith(prefixes)]


@contextmanager
def _named_values(place: str) -> Iterator[None]:
    """Turn errors about values that Python and NumPy do not have into an IntegrityError."""
    try:
        with store.named_damage(place):
            yield
    except (ValueError, OverflowError) as error:
        raise errors.IntegrityError.in_file(place, f" holds a value that cannot be read ({error})") from error


def read_rows(place: importing.PicturePlace, numbers: Sequence[int]) -> Iterator[bytes | errors.ItemError]:
    """Yield the pictures of some rows; ``part`` of the place is their column."""
    return ForeignParquet(store.open_folder(place.home), place.path).pictures(place.part, numbers)
