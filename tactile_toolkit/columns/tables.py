"""Tables of any length, read a few rows at a time: text, JSON lines, Parquet; no table is held in memory.

A text table has commas, semicolons, tabs or bars between values, in UTF-8, or UTF-16 with a BOM. Its rows
have a value for each column. Spaces around numbers and empty lines do not count.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cached_property, partial
from typing import IO, ClassVar

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.json
import pyarrow.parquet as pq

from tactile_toolkit import cache, store, wording
from tactile_toolkit.columns import column_types
from tactile_toolkit.columns.known_formats import KnownFormat
from tactile_toolkit.errors import InputError, IntegrityError, ItemError
from tactile_toolkit.value_types import Int64, JsonDict

MAX_ROWS = 1 << 25
"""Longest table that is read in parts: nine hours of 1,000 rows a second."""

MAX_HELD_ROWS = 1 << 21
"""Longest table that is held in memory."""

_MAX_COLUMNS = 1000
_HEADER_BYTES = 1 << 16
_BLOCK_BYTES = 4 << 20  # Arrow refuses a longer line
_ROWS_AT_ONCE = 1 << 15
_LONGEST_SHOWN = 200  # characters of a message of Arrow
_NO_ROWS = pa.table({})
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
_QUOTED = re.compile(r'"[^"\n]*"')
_SEPARATORS = (",", ";", "\t")
_RARE_SEPARATOR = "|"  # of tables without the others
# A line before the header, by which spreadsheets state the separator.
_SEPARATOR_LINE = re.compile(r"sep=([,;\t|])\r?\n")


def open_source(folder: store.DataFolder, name: str, version: tuple[object, ...] | None = None) -> IO[bytes]:
    """Open a table or archive of a source; an InputError names it if it cannot be read.

    Raises IntegrityError if a ``version`` is stated and the file has another one.
    """
    if version is not None and folder.version(name) != version:
        raise IntegrityError(
            f"{folder.address(name)!r} was replaced or changed while it was read",
            next="run the same command again",
        )
    try:
        return folder.open_inside(name)
    except ItemError as error:
        raise InputError(f"{folder.address(name)!r} cannot be read: {error.what}") from error


class Table:
    """A table that is read several times, a few rows at a time.

    A column without a name is called ``column_1`` by its position.

    Parameters
    ----------
    path : str
        Name of the table in messages; its ending gives the format.
    open_file : callable
        Opens the table as a binary stream.

    Raises
    ------
    InputError
        It cannot be read, or exceeds a limit; raised by the first pass.
    """

    TEXT_ENDINGS: ClassVar = (".csv", ".tsv")
    """Endings of the names of text tables, in lower case."""
    ENDINGS: ClassVar = (*TEXT_ENDINGS, ".parquet", ".jsonl", ".ndjson")

    @classmethod
    def of(cls, folder: store.DataFolder, name: str) -> Table:
        """Return a table of a folder; a pass raises IntegrityError if the file has changed since."""
        return cls(folder.address(name), partial(open_source, folder, name, folder.version(name)))

    def __init__(self, path: str, open_file: Callable[[], IO[bytes]]) -> None:
        self.path = path
        self._open = open_file
        ending = path[path.rfind(".") :].lower()
        self._read = _READERS.get(ending, self._text_batches)
        self._own_keys = _KEYS.get(ending, ("pixels",))
        self._is_text = self._read == self._text_batches
        self._separator = ""
        self._uneven = ""
        self._names: list[str] = []
        self._only: pa.Table | None = None

    @property
    def names(self) -> list[str]:
        """Names of the columns, in order; the first rows are read if no pass did so before."""
        return self._names or next(self._batches(), _NO_ROWS).column_names

    @cached_property
    def _types(self) -> column_types.ColumnTypes:  # after the first rows, which show the separator
        return column_types.ColumnTypes(is_text=self._is_text, decimal_commas=self._separator != ",")

    def first_row(self) -> JsonDict:
        """Return the first row, as it is stored; empty for a table without rows."""
        return next(iter(next(self._batches(), _NO_ROWS).slice(0, 1).to_pylist()), {})

    def scan(self, choose: Callable[[Sequence[str]], str] = lambda _names: "") -> tuple[int, str, pa.Array]:
        """Read all rows to find the types of columns.

        Returns the number of rows, the name of the column that ``choose`` finds among those of the first
        rows, and its values.
        """
        rows = 0
        column = None
        kept: list[pa.Array] = []
        with self._named_errors():
            for batch in self._batches():
                self._only = None if rows else batch
                rows += len(batch)
                if column is None:
                    column = choose(batch.column_names)
                self._types.add(batch, column)
                if column in batch.column_names:  # as numbers, which take less space than text
                    kept.append(self._types.typed(batch.select([column]))[column])
            self._names = list(self._types.known)
            if not kept:
                kept = [pa.nulls(rows)]
            return rows, column or "", kept[0] if len(kept) == 1 else column_types.joined(kept)

    def rows(self, numbers: Int64) -> dict[str, pa.Array]:
        """Return rows by their numbers, int64, shape (n,), n > 0, increasing; needs :meth:`scan` before.

        The file is read again unless all of its rows fit into one part.
        """
        parts = []
        start = 0
        for batch in self._batches() if self._only is None else [self._only]:
            first, last = np.searchsorted(numbers, [start, start + len(batch)])
            if first < last:
                parts.append(batch.take(pa.array(numbers[first:last] - start)))
            start += len(batch)
        with self._named_errors():
            return self._types.typed(pa.concat_tables(parts, promote_options="permissive"))

    def whole(self, texts: Collection[str] = (), numbers: Collection[str] = ()) -> dict[str, pa.Array]:
        """Return all columns with their types; lists of numbers in brackets become vectors.

        In text tables, the columns ``texts`` stay text. If a value of the columns ``numbers`` is no number,
        they stay text, too, in which numbers can be read and other missing values are null.
        """
        with self._named_errors():
            parts = list(self._batches(MAX_HELD_ROWS))
            if not parts:
                return dict.fromkeys(self.names, pa.nulls(0))
            table = pa.concat_tables(parts, promote_options="permissive")
            self._names = table.column_names
            return self._types.whole(table, texts, numbers)

    def _batches(self, most_rows: int = 0) -> Iterator[pa.Table]:
        """Yield the rows, a few at a time; values of text tables are text."""
        rows = 0
        most_rows = most_rows or MAX_ROWS
        with self._named_errors(), self._open() as stream:
            for batch in self._read(stream, self.path):
                rows += len(batch)
                if rows > most_rows:
                    problem = f"{self.path!r} has more than {most_rows:,} rows"
                    raise InputError(problem, next="divide it into several tables")
                table = pa.Table.from_batches([batch])
                yield table.rename_columns(_checked_names(table.column_names, self.path))

    def _text_batches(self, stream: IO[bytes], path: str) -> Iterator[pa.RecordBatch]:
        """Yield the rows of a text table, all columns as text."""
        head = stream.read(_HEADER_BYTES)
        # Of "utf-8" alone, Arrow checks the values only: text in another encoding that also has uneven rows
        # would fail in its callback, where no error can be raised.
        encoding = "utf-16" if head.startswith(_UTF16_MARKS) else "utf-8-sig"
        text = head.decode(encoding, errors="ignore").removeprefix("\ufeff")
        stated = _SEPARATOR_LINE.match(text)
        header = text[stated.end() if stated else 0 :].lstrip("\r\n").partition("\n")[0]
        self._separator = stated[1] if stated else _separator_of(_QUOTED.sub("", header))
        if not header.strip():
            raise InputError(f"{path!r} is empty", next="write a line with the names of the columns first")
        # Refuses a header of too many columns before Arrow parses it.
        _checked_names([str(number) for number in range(header.count(self._separator) + 1)], path)
        spaced = re.compile(rf'("[^"]*")|({re.escape(self._separator)}) +')
        # If the header has spaces, so do the rows; Arrow would take spaces and quotes for text.
        is_spaced = f"{self._separator} " in header
        if is_spaced:
            header = spaced.sub(r"\1\2", header)
        parsing = pa.csv.ParseOptions(
            delimiter=self._separator, newlines_in_values=True, invalid_row_handler=self._note_uneven_row
        )
        names = pa.csv.read_csv(io.BytesIO(f"{header}\n".encode()), parse_options=parsing).column_names
        reading = pa.csv.ReadOptions(use_threads=False, block_size=_BLOCK_BYTES, encoding=encoding)
        reading.skip_rows = int(stated is not None)
        types = pa.csv.ConvertOptions(column_types=dict.fromkeys(names, pa.string()))
        stream.seek(0)
        if is_spaced:
            cache.require_unpackable(stream.seek(0, io.SEEK_END), path)
            stream.seek(0)
            plain = spaced.sub(r"\1\2", stream.read().decode(encoding))
            stream, reading.encoding = io.BytesIO(plain.encode()), "utf-8"
        batches = pa.csv.open_csv(stream, reading, parsing, types)
        rows = 0
        for batch in batches:
            rows += len(batch)
            yield batch
        if not rows:
            yield pa.RecordBatch.from_pylist([], batches.schema)  # states the columns

    def _note_uneven_row(self, row: pa.csv.InvalidRow) -> str:
        """Note a row that has not a value for each column, which :meth:`_named_errors` then reports."""
        values = wording.with_count(row.actual_columns, "values")
        self._uneven = (
            f"row {row.number}, with the header as row 1, has {values}; expected {row.expected_columns}"
        )
        return "error"

    @contextmanager
    def _named_errors(self) -> Iterator[None]:
        try:
            yield
        except (pa.ArrowException, OSError, ValueError) as error:
            if self._uneven:
                raise InputError(
                    f"{self.path!r} cannot be read as a table: {self._uneven}, one for each column",
                    next="leave missing values empty, close each quote, and quote values with a separator",
                ) from None
            if isinstance(error, UnicodeDecodeError):  # its position is that in the part read last
                error = ValueError(f"{error.object[max(error.start - 10, 0) : error.end]!r} is not text")
            known = self._known_format()
            if known is not None:
                raise InputError(
                    f"{self.path!r} is {known.name}; expected a table", next=known.step
                ) from error
            reason = wording.printable(str(error))[:_LONGEST_SHOWN]
            advice = (
                "save it as UTF-8 text, with commas, semicolons, tabs or bars between the values of each row"
                if self._is_text
                else ""
            )
            raise InputError(f"{self.path!r} cannot be read as a table: {reason}", next=advice) from error

    def _known_format(self) -> KnownFormat | None:
        """Return the format of a file that could not be read as a table; None if it is unknown."""
        with suppress(InputError, IntegrityError, OSError), self._open() as stream:
            known = KnownFormat.of(stream)
            return None if known is None or known.key in self._own_keys else known
        return None


def _checked_names(names: Sequence[str], path: str) -> list[str]:
    """Return the names of columns; InputError for too many columns, or for duplicate names."""
    checked = [name.strip() or f"column_{number}" for number, name in enumerate(names, 1)]
    if len(checked) > _MAX_COLUMNS:
        raise InputError(f"{path!r} has {len(checked):,} columns; expected at most {_MAX_COLUMNS:,}")
    twice = next((name for name in checked if checked.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{path!r} has two columns {twice!r}; expected different names")
    return checked


def _separator_of(header: str) -> str:
    """Return the most frequent separator of a header; a bar if it has no other."""
    separator = max(_SEPARATORS, key=header.count)
    return separator if separator in header or _RARE_SEPARATOR not in header else _RARE_SEPARATOR


def _json_batches(stream: IO[bytes], path: str) -> Iterator[pa.RecordBatch]:
    with io.BufferedReader(stream) as lines:  # type: ignore[type-var] # files of stores have no such `readline`
        while block := lines.read(_BLOCK_BYTES) + lines.readline(_BLOCK_BYTES):
            if column_types.is_nested_deeply(block):
                problem = f"{path!r} has more than {column_types.MAX_NESTING} brackets inside each other"
                raise InputError(problem, next="store nested values as columns, or as text")
            reading = pa.json.ReadOptions(use_threads=False, block_size=len(block) + 1)
            yield from pa.json.read_json(pa.BufferReader(block), reading).to_batches()


def _parquet_batches(stream: IO[bytes], path: str) -> Iterator[pa.RecordBatch]:
    size = stream.seek(0, io.SEEK_END)
    is_text = (pa.types.is_string, pa.types.is_large_string, pa.types.is_string_view)
    texts = [
        field.name for field in pq.read_schema(stream) if any(is_kind(field.type) for is_kind in is_text)
    ]
    # As dictionaries: repeated texts are stored once, and could take any space if they were expanded.
    file = pq.ParquetFile(stream, read_dictionary=texts, pre_buffer=False, page_checksum_verification=True)
    for number in range(file.metadata.num_row_groups):
        cache.require_unpackable(file.metadata.row_group(number).total_byte_size, path, size)
    yield from file.iter_batches(_ROWS_AT_ONCE, use_threads=False)


# Keys of the known formats that readers read.
_KEYS = {".parquet": ("parquet",), ".jsonl": ("json", "strokes"), ".ndjson": ("json", "strokes")}
_READERS = {".parquet": _parquet_batches, ".jsonl": _json_batches, ".ndjson": _json_batches}
