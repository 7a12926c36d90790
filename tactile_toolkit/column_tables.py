"""Tables of any length, read a few rows at a time: text, JSON lines, Parquet; no table is held in memory."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import IO

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.json
import pyarrow.parquet as pq

from tactile_toolkit import bounds, column_types, shown_text, text_tables
from tactile_toolkit.array_types import Int64
from tactile_toolkit.errors import InputError
from tactile_toolkit.json_types import JsonDict

MAX_ROWS = 1 << 25
"""Longest table that is read: nine hours of 1,000 rows a second."""

_MAX_COLUMNS = 1000
_HEADER_BYTES = 1 << 16
_BLOCK_BYTES = 1 << 20  # Arrow refuses a longer line
_ROWS_AT_ONCE = 1 << 15
_LONGEST_SHOWN = 200  # characters of a message of Arrow
_NO_ROWS = pa.table({})


class ColumnTable:
    """A table that is read several times, a few rows at a time.

    Parameters
    ----------
    path : str
        Name of the table in messages; its ending gives the format.
    open_file : callable
        Opens the table as a binary stream.

    Attributes
    ----------
    names : list of str
        Names of the columns, in order; a column without a name is called ``column_1`` by its position.

    Raises
    ------
    InputError
        It cannot be read, or exceeds a limit.
    """

    def __init__(self, path: str, open_file: Callable[[], IO[bytes]]) -> None:
        self.path = path
        self._open = open_file
        self._types: dict[str, pa.DataType] = {}
        self._read = _READERS.get(path[path.rfind(".") :].lower(), self._text_batches)
        self._is_text = self._read == self._text_batches
        self._separator = ""
        self.names: list[str] = next(self._batches(), _NO_ROWS).column_names

    def _batches(self) -> Iterator[pa.Table]:
        """Yield the rows, a few at a time; values of text tables are text."""
        rows = 0
        with self._named_errors(), self._open() as stream:
            for batch in self._read(stream, self.path):
                rows += len(batch)
                if rows > MAX_ROWS:
                    found = f"{self.path!r} has more than {MAX_ROWS:,} rows"
                    raise InputError(found, next="divide it into several tables")
                table = pa.Table.from_batches([batch])
                yield table.rename_columns(_checked_names(table.column_names, self.path))

    def _text_batches(self, stream: IO[bytes], path: str) -> Iterator[pa.RecordBatch]:
        """Yield the rows of a text table, all columns as text."""
        head = stream.read(_HEADER_BYTES)
        encoding = "utf-16" if head.startswith(text_tables.UTF16_MARKS) else "utf-8"
        whole = head.decode(encoding, errors="ignore").removeprefix("\ufeff")
        text, self._separator = text_tables.table_text(whole.encode(), path)
        header = text.lstrip().partition("\n")[0]
        # Refuses a header of too many columns before Arrow parses it.
        _checked_names([str(number) for number in range(header.count(self._separator) + 1)], path)
        reading = pa.csv.ReadOptions(use_threads=False, block_size=_BLOCK_BYTES, encoding=encoding)
        reading.skip_rows = int(text != whole)  # the line that states the separator
        parsing = pa.csv.ParseOptions(delimiter=self._separator, newlines_in_values=True)
        names = pa.csv.read_csv(io.BytesIO(f"{header}\n".encode()), parse_options=parsing).column_names
        types = pa.csv.ConvertOptions(column_types=dict.fromkeys(names, pa.string()))
        stream.seek(0)
        yield from pa.csv.open_csv(stream, reading, parsing, types)

    @contextmanager
    def _named_errors(self) -> Iterator[None]:
        try:
            yield
        except (pa.ArrowException, OSError, ValueError) as error:
            found = shown_text.printable(str(error))[:_LONGEST_SHOWN]
            raise InputError(f"{self.path!r} cannot be read as a table: {found}") from error

    def first_row(self) -> JsonDict:
        """Return the first row, as it is stored; empty for a table without rows."""
        return next(iter(next(self._batches(), _NO_ROWS).slice(0, 1).to_pylist()), {})

    def scan(self, column: str = "") -> tuple[int, pa.Array]:
        """Read all rows to find the types of columns; return the number of rows, and values of a column."""
        rows, kept = 0, []
        with self._named_errors():
            for batch in self._batches():
                rows += len(batch)
                for name in batch.column_names:
                    self._types[name] = self._common(name, batch.column(name), name != column)
                if column in batch.column_names:  # as numbers, which take less space than text
                    kept.append(self._typed(batch.select([column])))
            self.names = list(self._types) or self.names
            if not kept:
                return rows, pa.nulls(rows)
            return rows, column_types.joined([each.column(0).combine_chunks() for each in kept])

    def rows(self, numbers: Int64) -> pa.Table:
        """Return rows by their numbers, int64, shape (n,), n > 0, increasing; needs :meth:`scan` before."""
        parts, start = [], 0
        for batch in self._batches():
            first, last = np.searchsorted(numbers, [start, start + len(batch)])
            if first < last:
                parts.append(batch.take(pa.array(numbers[first:last] - start)))
            start += len(batch)
        with self._named_errors():
            return self._typed(pa.concat_tables(parts, promote_options="permissive"))

    def _common(self, name: str, values: pa.ChunkedArray, is_exact: bool) -> pa.DataType:
        """Return the common type of some values of a column and of its earlier values.

        With ``is_exact``, numbers stay text if formatting them would not give the same text.
        """
        known = self._types.get(name, pa.null())
        if self._is_text:
            return column_types.text_type(self._words(values), known, is_exact=is_exact)
        return column_types.common_type(known, column_types.from_arrow(values).type, name)

    def _words(self, values: pa.ChunkedArray) -> pa.Array:
        found = values.combine_chunks()
        return column_types.words_of(found, decimal_commas=self._separator != ",")

    def _typed(self, table: pa.Table) -> pa.Table:
        """Convert the columns of some rows to the types that hold all values of the table."""
        columns = {}
        for name, values in zip(table.column_names, table.columns, strict=True):
            kind = self._types[name]
            if self._is_text:
                columns[name] = column_types.as_type(values.combine_chunks(), self._words(values), kind)
            else:
                columns[name] = column_types.from_arrow(values).cast(kind)
        return pa.table(columns)


def _checked_names(names: Sequence[str], path: str) -> list[str]:
    """Return the names of columns; InputError for too many columns, or for duplicate names."""
    found = [name.strip() or f"column_{number}" for number, name in enumerate(names, 1)]
    if len(found) > _MAX_COLUMNS:
        raise InputError(f"{path!r} has {len(found):,} columns; expected at most {_MAX_COLUMNS:,}")
    twice = next((name for name in found if found.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{path!r} has two columns {twice!r}; expected different names")
    return found


def _json_batches(stream: IO[bytes], path: str) -> Iterator[pa.RecordBatch]:
    with io.BufferedReader(stream) as lines:  # type: ignore[type-var] # files of stores have no such `readline`
        while block := lines.read(_BLOCK_BYTES) + lines.readline(_BLOCK_BYTES):
            reading = pa.json.ReadOptions(use_threads=False, block_size=len(block) + 1)
            yield from pa.json.read_json(pa.BufferReader(block), reading).to_batches()


def _parquet_batches(stream: IO[bytes], path: str) -> Iterator[pa.RecordBatch]:
    size = stream.seek(0, io.SEEK_END)
    is_text = (pa.types.is_string, pa.types.is_large_string, pa.types.is_string_view)
    texts = [each.name for each in pq.read_schema(stream) if any(is_kind(each.type) for is_kind in is_text)]
    # As dictionaries: repeated texts are stored once, and could take any space if they were expanded.
    file = pq.ParquetFile(stream, read_dictionary=texts, pre_buffer=False, page_checksum_verification=True)
    for number in range(file.metadata.num_row_groups):
        bounds.require_unpackable(file.metadata.row_group(number).total_byte_size, path, size)
    yield from file.iter_batches(_ROWS_AT_ONCE, use_threads=False)


_READERS = {".parquet": _parquet_batches, ".jsonl": _json_batches, ".ndjson": _json_batches}
TYPED_ENDINGS = tuple(_READERS)
"""Endings of the names of tables whose values have types, in lower case."""

COLUMN_TABLE_ENDINGS = (*text_tables.TABLE_ENDINGS, *TYPED_ENDINGS)
"""Endings of the names of all tables that are read, in lower case."""
