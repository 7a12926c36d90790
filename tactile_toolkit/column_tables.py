"""Tables of any length, read a few rows at a time: text, JSON lines, Parquet. No whole table is in memory."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import IO, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.json
import pyarrow.parquet as pq

from tactile_toolkit.array_types import Int64
from tactile_toolkit.bounds import require_unpackable
from tactile_toolkit.errors import InputError
from tactile_toolkit.shown_text import printable
from tactile_toolkit.text_tables import TABLE_ENDINGS, table_text

MOST_ROWS = 1 << 25
"""Longest table that is read: nine hours of 1,000 rows a second."""

_MOST_COLUMNS = 1000
_HEADER_BYTES = 1 << 16
_BLOCK_BYTES = 1 << 22
_LONGEST_LINE = 4 * _BLOCK_BYTES
_ROWS_AT_ONCE = 1 << 15
_LONGEST_SHOWN = 200
_UNKNOWN = pa.array(["NA", "N/A", "#N/A", "nan", "NaN", "null", "NULL", "None"])
_CODE = r"^[+-]?0([0-9]+$|[xX])"  # 007 is a name, which a number would not give back
_SWITCHED = pa.array(["0", "1"])
_LONG_INTEGER = r"^[+-]?[0-9]{16,300}$"
_EXPONENT = r"[eE]\+?[0-9]{3,}$|^[+-]?[0-9]{301,}"
_DECIMAL_COMMA = r"^[+-]?[0-9]*,[0-9]+([eE][+-]?[0-9]+)?$"


class ColumnTable:
    """A table that is read in passes.

    Parameters
    ----------
    path : str
        What messages call it; the format follows from its ending.
    open_file : callable
        Opens it.

    Attributes
    ----------
    names : list of str
        Columns, in order; one without a name is called after its place, such as ``column_1``.

    Raises
    ------
    InputError
        It cannot be read, or exceeds a limit.
    """

    def __init__(self, path: str, open_file: Callable[[], IO[bytes]]) -> None:
        self.path, self._open = path, open_file
        self._types: dict[str, pa.DataType] = {}
        ending = path[path.rfind(".") :].lower()
        self._read = _READERS.get(ending, _text_batches)
        self._is_text = self._read is _text_batches
        first = next(self._batches(), None)
        self.names: list[str] = [] if first is None else list(first.schema.names)

    def _batches(self) -> Iterator[pa.Table]:
        """Yield the rows, a few at a time; values of text tables are text."""
        rows = 0
        with self._named_errors(), self._open() as stream:
            for batch in self._read(stream, self.path):
                rows += len(batch)
                if rows > MOST_ROWS:
                    found = f"{self.path!r} has more than {MOST_ROWS:,} rows"
                    raise InputError(found, next="divide it into several tables")
                yield batch.rename_columns(_checked_names(batch.schema.names, self.path))

    @contextmanager
    def _named_errors(self) -> Iterator[None]:
        try:
            yield
        except (pa.ArrowException, OSError, ValueError) as error:
            found = printable(str(error))[:_LONGEST_SHOWN]
            raise InputError(f"{self.path!r} cannot be read as a table: {found}") from error

    def scan(self, column: str = "") -> tuple[int, pa.ChunkedArray]:
        """Read all rows once, so that types are known: return their number, and the values of a column."""
        rows, kept = 0, []
        for batch in self._batches():
            rows += len(batch)
            for name in batch.schema.names:
                known = self._types.get(name, pa.null())
                self._types[name] = self._common(known, batch.column(name), name, name != column)
            if column in batch.schema.names:  # as numbers, which take less space than text
                kept.append(pa.table({column: self._typed(batch.column(column), column)}))
        self.names = list(self._types) or self.names
        if not kept:
            return rows, pa.chunked_array([pa.nulls(rows)])
        return rows, self._together(kept).column(0)

    def rows(self, numbers: Int64) -> pa.Table:
        """Return some rows by their rising numbers, at least one, after :meth:`scan`."""
        parts, start = [], 0
        for batch in self._batches():
            first, last = np.searchsorted(numbers, [start, start + len(batch)])
            if first < last:
                parts.append(batch.take(pa.array(numbers[first:last] - start)))
            start += len(batch)
        return self._together(parts)

    def lines(self, most: int) -> list[dict[str, Any]]:
        """Return all rows as objects of Python; InputError for more than ``most``."""
        rows, _ = self.scan()
        if rows > most:
            raise InputError(f"{self.path!r} has {rows:,} rows; expected at most {most:,}")
        if not rows:
            return []
        found: list[dict[str, Any]] = self.rows(np.arange(rows)).to_pylist()
        return found

    def _common(self, known: pa.DataType, values: pa.ChunkedArray, name: str, is_exact: bool) -> pa.DataType:
        """Return the type of a column, given that of earlier rows."""
        found = values.type
        if self._is_text:
            if pa.types.is_string(known):
                return known
            found = _type_of_text(values, known, is_exact)
        elif pa.types.is_dictionary(found):
            found = found.value_type
        try:
            both = [pa.schema([(name, each)]) for each in (known, found)]
            return pa.unify_schemas(both, promote_options="permissive").field(0).type
        except pa.ArrowException as error:
            if self._is_text:
                return pa.string()
            what = f"the column {name!r} holds values of the types {known} and {found}; expected one type"
            raise InputError(f"{self.path!r}: {what}") from error

    def _together(self, parts: Sequence[pa.Table]) -> pa.Table:
        """Return parts of the table as one, each column of the type that all of its rows have."""
        with self._named_errors():
            found = pa.concat_tables(parts, promote_options="permissive")
            return pa.table({name: self._typed(found.column(name), name) for name in found.schema.names})

    def _typed(self, values: pa.ChunkedArray, name: str) -> pa.ChunkedArray:
        """Return values of a column with the type that is known of it."""
        if pa.types.is_string(values.type) and not pa.types.is_string(self._types[name]):
            values = _without_words(values)
        if pa.types.is_null(self._types[name]):
            return pa.chunked_array([pa.nulls(len(values))])
        return values.cast(self._types[name])


def _checked_names(names: Sequence[str], path: str) -> list[str]:
    """Return the names of columns, each once; InputError for too many, or two of one name."""
    found = [name.strip() or f"column_{number}" for number, name in enumerate(names, 1)]
    if len(found) > _MOST_COLUMNS:
        raise InputError(f"{path!r} has {len(found):,} columns; expected at most {_MOST_COLUMNS:,}")
    twice = next((name for name in found if found.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{path!r} has two columns {twice!r}; expected different names")
    return found


def _type_of_text(values: pa.ChunkedArray, known: pa.DataType, is_exact: bool) -> pa.DataType:
    """Return the type of texts: numbers or switches if all are, nothing if all are empty.

    With ``is_exact``, text that a number would not give back stays text.
    """
    words = _without_words(values)
    if words.null_count == len(words):
        return pa.null()
    candidates = (pa.int64(), pa.float64(), pa.bool_())
    for data_type in candidates[pa.types.is_floating(known) :]:
        try:
            words.cast(data_type)
        except pa.ArrowException:
            continue
        return pa.string() if is_exact and _is_changed(words, data_type) else data_type
    return pa.string()


def _is_changed(words: pa.ChunkedArray, data_type: pa.DataType) -> bool:
    """Return whether values of a type would not give texts back: codes, long integers, numbers too large."""
    if pc.any(pc.match_substring_regex(words, _CODE)).as_py():
        return True
    if pa.types.is_boolean(data_type):
        return bool(pc.any(pc.is_in(words, _SWITCHED)).as_py())
    if pa.types.is_integer(data_type):
        return False
    long = words.filter(pc.match_substring_regex(words, _LONG_INTEGER)).to_pylist()
    large = words.filter(pc.match_substring_regex(words, _EXPONENT)).cast(pa.float64())
    return any(int(float(word)) != int(word) for word in long) or bool(pc.any(pc.is_inf(large)).as_py())


def _without_words(values: pa.ChunkedArray) -> pa.ChunkedArray:
    """Return texts with null for what stands for no value, and with points for decimal commas."""
    words = pc.utf8_trim_whitespace(values)
    is_missing = pc.or_(pc.equal(words, ""), pc.is_in(words, _UNKNOWN))
    words = pc.if_else(is_missing, pa.scalar(None, pa.string()), words)
    if pc.any(pc.match_substring(words, ",")).as_py():
        is_comma = pc.match_substring_regex(words, _DECIMAL_COMMA)
        words = pc.if_else(is_comma, pc.replace_substring(words, ",", "."), words)
    return words


def _text_batches(stream: IO[bytes], path: str) -> Iterator[pa.Table]:
    """Yield the rows of a text table, all columns as text."""
    encoding = "utf-16" if stream.read(2) in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    stream.seek(0)
    with io.TextIOWrapper(stream, encoding, newline="") as lines:
        text, separator = table_text(lines.read(_HEADER_BYTES).encode(), path)
        header, _, rest = text.partition("\n")
        names = next(csv.reader([header.rstrip("\r")], delimiter=separator, skipinitialspace=True), [])
        names = _checked_names(names, path)
        parsing = pa.csv.ParseOptions(delimiter=separator, newlines_in_values=True)
        types = pa.csv.ConvertOptions(column_types=dict.fromkeys(names, pa.string()))
        for block in _line_blocks(rest, lines, path, is_quoted=True):
            reading = pa.csv.ReadOptions(use_threads=False, block_size=len(block) + 1, column_names=names)
            yield pa.csv.read_csv(pa.BufferReader(block), reading, parsing, types)


def _json_batches(stream: IO[bytes], path: str) -> Iterator[pa.Table]:
    with io.TextIOWrapper(stream, "utf-8-sig", newline="") as lines:
        for block in _line_blocks("", lines, path):
            reading = pa.json.ReadOptions(use_threads=False, block_size=len(block) + 1)
            yield pa.json.read_json(pa.BufferReader(block), reading)


def _line_blocks(start: str, lines: IO[str], path: str, is_quoted: bool = False) -> Iterator[bytes]:
    """Yield a text in blocks of whole lines, as UTF-8; in tables, a quoted value may have several lines."""
    block = start
    while more := lines.read(_BLOCK_BYTES):
        block += more
        end = block.rfind("\n") + 1
        if end and not (is_quoted and block.count('"', 0, end) % 2):
            yield block[:end].encode()
            block = block[end:]
        elif len(block) > _LONGEST_LINE:
            raise InputError(f"{path!r} has a line of more than {_LONGEST_LINE:,} letters; expected a table")
    if is_quoted and block.count('"') % 2:
        raise InputError(f"{path!r} has a quote that does not end; expected a table")
    if block.strip():
        yield block.encode()


def _parquet_batches(stream: IO[bytes], path: str) -> Iterator[pa.Table]:
    size = stream.seek(0, io.SEEK_END)
    schema = pq.read_schema(stream)
    is_text = (pa.types.is_string, pa.types.is_large_string)
    texts = [each.name for each in schema if any(is_kind(each.type) for is_kind in is_text)]
    # Texts that repeat are stored once, and could take any space if each was unpacked.
    file = pq.ParquetFile(stream, read_dictionary=texts, pre_buffer=False, page_checksum_verification=True)
    for number in range(file.metadata.num_row_groups):
        require_unpackable(file.metadata.row_group(number).total_byte_size, path, size)
    for batch in file.iter_batches(_ROWS_AT_ONCE, use_threads=False):
        yield pa.Table.from_batches([batch])


_READERS = {".parquet": _parquet_batches, ".jsonl": _json_batches, ".ndjson": _json_batches}
TYPED_ENDINGS = tuple(_READERS)
"""Endings of the names of tables whose values have types, in lower case."""

COLUMN_TABLE_ENDINGS = (*TABLE_ENDINGS, *TYPED_ENDINGS)
