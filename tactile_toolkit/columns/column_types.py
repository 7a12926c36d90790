"""The types of foreign columns, decided only here: of text tables, JSON, Parquet and numpy.

A column is an Arrow array of bool, int64, float64, text or points in time, or of lists of these; matrices are
lists, row by row. Missing values and empty texts are null. Values without a common type, such as objects,
are kept as JSON (:data:`UNTYPED`).
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import suppress
from functools import partial, reduce
from itertools import chain
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from tactile_toolkit import read
from tactile_toolkit.value_types import AnyArray, Float64, Int64, JsonValue

T = TypeVar("T")

UNTYPED = pa.binary()
"""Type of a column whose values have no common type: each is JSON, which no reader takes for a number."""

_NOTHING = pa.null()
_LISTS = (list, tuple)
MAX_NESTING = 32
"""Most brackets inside each other in JSON that is parsed; parsers end the process at some thousands."""
_JSON_STRING = re.compile(rb'"(?:[^"\\]|\\.)*"', re.DOTALL)
_BRACKETS = np.zeros(256, np.int8)
_BRACKETS[[*b"[{"]] = 1
_BRACKETS[[*b"]}"]] = -1
_MAX_LEVELS = 4  # of lists in a list
_MAX_EXACT = 1 << 53  # below which float64 holds every integer
_NO_VALUE = pa.array(["", "NA", "N/A", "#N/A", "nan", "NaN", "null", "NULL", "None"])
# Types that text may have, given that of earlier rows; else it stays text.
_OF_TEXT: dict[pa.DataType, tuple[pa.DataType, ...]] = {
    pa.null(): (pa.int64(), pa.float64(), pa.bool_()),
    pa.int64(): (pa.int64(), pa.float64()),
    pa.float64(): (pa.float64(),),
    pa.bool_(): (pa.bool_(),),
}
_CODE = r"^[+-]?0[0-9xX]"  # 007 is a name, which a number would not reproduce
_WHOLE = r"^[+-]?[0-9]+$"
_ODD = rf"{_CODE}|[0-9]{{16,}}$|[eE]\+?[0-9]{{3,}}$"  # texts that a number may not reproduce
_SWITCHED = pa.array(["0", "1"])
_DECIMAL_COMMA = r"^[+-]?[0-9]*,[0-9]+([eE][+-]?[0-9]+)?$"
_POINT = r"[0-9]\.|\.[0-9]"
_VECTOR = r"^\[[-+.,0-9eE \[\]nulNa]*\]$"  # of numbers, NaN or null, in JSON
_NO_BRACKETS = str.maketrans("[](),;", "      ")
_NUMBERS = (pa.int64(), pa.float64())


def _without_blanks(texts: pa.Array) -> pa.Array:
    """Return texts as they are; null for texts of spaces only."""
    return pc.if_else(pc.equal(pc.utf8_trim_whitespace(texts), ""), pa.scalar(None, pa.string()), texts)


def _words_of(texts: pa.Array, *, decimal_commas: bool = False) -> pa.Array:
    """Return texts in the form in which numbers are read; null for words that mean a missing value.

    With ``decimal_commas``, as the separator of a table shows, commas become points, unless a number of the
    column has a point: then commas may stand between thousands.
    """
    words = pc.utf8_trim_whitespace(texts)
    words = pc.if_else(pc.is_in(words, _NO_VALUE), pa.scalar(None, pa.string()), words)
    if decimal_commas and not pc.any(pc.match_substring_regex(words, _POINT)).as_py():
        is_comma = pc.match_substring_regex(words, _DECIMAL_COMMA)
        words = pc.if_else(is_comma, pc.replace_substring(words, ",", "."), words)
    return words


def _text_type(words: pa.Array, known: pa.DataType = _NOTHING, *, is_exact: bool = True) -> pa.DataType:
    """Return the type of words, given that of earlier rows: a number, true or false, or text.

    With ``is_exact``, words stay text if formatting the number would not give the same text: codes such as
    007, and integers that float64 rounds.
    """
    if words.null_count == len(words):
        return known
    for kind in _OF_TEXT.get(known, ()):
        with suppress(pa.ArrowException):
            words.slice(0, 64).cast(kind)  # one that fails goes on to the last word, which takes long
            words.cast(kind)
            if is_exact and _is_changed(words, kind):
                break
            return kind
    return pa.string()


def _is_changed(words: pa.Array, data_type: pa.DataType) -> bool:
    """Return whether formatting values of a type would not give the same words."""
    if pa.types.is_boolean(data_type):
        return bool(pc.any(pc.is_in(words, _SWITCHED)).as_py())
    odd = words.filter(pc.match_substring_regex(words, _ODD))
    if not len(odd) or pc.any(pc.match_substring_regex(odd, _CODE)).as_py():
        return bool(len(odd))
    if pa.types.is_integer(data_type):
        return False
    numbers = odd.cast(pa.float64()).to_numpy()
    is_whole = pc.match_substring_regex(odd, _WHOLE).to_numpy(zero_copy_only=False)
    return bool((np.isinf(numbers) | (is_whole & (np.abs(numbers) >= _MAX_EXACT))).any())


def _as_type(texts: pa.Array, words: pa.Array, kind: pa.DataType) -> pa.Array:
    """Return texts, whose words are known, as a column of a type of :func:`_text_type`."""
    if pa.types.is_null(kind):
        return pa.nulls(len(texts))
    if pa.types.is_string(kind):
        return _without_blanks(texts)
    return words.cast(kind)


def is_nested_deeply(text: bytes) -> bool:
    """Return whether more than :data:`MAX_NESTING` brackets of JSON are inside each other."""

    def depth(data: bytes) -> int:
        opened = np.cumsum(_BRACKETS[np.frombuffer(data, np.uint8)], dtype=np.int64)
        return int((opened - np.minimum.accumulate(np.minimum(opened, 0))).max(initial=0))

    # Brackets in strings count only until the strings are left out, which takes longer.
    return depth(text) > MAX_NESTING and depth(_JSON_STRING.sub(b"", text)) > MAX_NESTING


def _vectors_of(texts: pa.Array) -> pa.Array:
    """Return texts as vectors if each of them is one, such as ``[1.5, 2]``."""
    if pc.all(pc.match_substring_regex(texts, _VECTOR)).as_py():
        words = texts.to_pylist()
        if is_nested_deeply("".join(filter(None, words)).encode()):
            return texts
        with suppress(ValueError):
            return column_of([text and json.loads(text) for text in words])
    return texts


class ColumnTypes:
    """The types of the columns of a table that is read a few rows at a time.

    Parameters
    ----------
    is_text : bool
        Whether all values are text, whose types follow from what they state.
    decimal_commas : bool
        Whether a comma may stand before decimals, as the separator of a text table shows.
    """

    def __init__(self, *, is_text: bool, decimal_commas: bool) -> None:
        self.known: dict[str, pa.DataType] = {}
        self._is_text = is_text
        self._decimal_commas = decimal_commas

    def add(self, rows: pa.Table, inexact: str = "") -> None:
        """Find the types that hold the values of some rows and of those before them.

        Numbers stay text if formatting them would not give the same text, except in the column ``inexact``.
        """
        for name, values in zip(rows.column_names, rows.columns, strict=True):
            known = self.known.get(name, _NOTHING)
            if self._is_text:
                self.known[name] = _text_type(self._words(values), known, is_exact=name != inexact)
            else:
                self.known[name] = _common_type(known, column_of(values).type, name)

    def typed(self, rows: pa.Table) -> dict[str, pa.Array]:
        """Return some columns of rows that were added, with the types that hold all values."""
        columns = {}
        for name, values in zip(rows.column_names, rows.columns, strict=True):
            if self._is_text:
                columns[name] = _as_type(values.combine_chunks(), self._words(values), self.known[name])
            else:
                columns[name] = column_of(values).cast(self.known[name])
        return columns

    def whole(self, table: pa.Table, texts: Collection[str], numbers: Collection[str]) -> dict[str, pa.Array]:
        """Return the columns of a whole table; see :meth:`tactile_toolkit.columns.tables.Table.whole`."""
        columns = {}
        for name, values in zip(table.column_names, table.columns, strict=True):
            if not self._is_text:
                columns[name] = column_of(values)
                continue
            column = _without_blanks(values.combine_chunks())
            if name not in texts:
                words = self._words(values)
                column = _as_type(column, words, _text_type(words))
                if pa.types.is_string(column.type):
                    column = words if name in numbers else _vectors_of(column)
            columns[name] = column
        return columns

    def _words(self, values: pa.ChunkedArray) -> pa.Array:
        return _words_of(values.combine_chunks(), decimal_commas=self._decimal_commas)


def column_of(
    values: pa.Array | pa.ChunkedArray | AnyArray | Iterable[object], *, from_text: bool = False
) -> pa.Array:
    """Return the column of values of Arrow, numpy, JSON or Python, or ``from_text`` of what texts state.

    Nested lists and arrays of shape (n, ...) become lists, row by row. In values of JSON, numbers beside
    texts or booleans become text.
    """
    if from_text:
        words = _words_of(values)
        return _as_type(values, words, _text_type(words))
    if isinstance(values, (pa.Array, pa.ChunkedArray)):
        return _plain(_supported(values))
    if isinstance(values, np.ndarray):
        if values.ndim > 1:
            width = values.size // max(1, len(values))
            return lists_of(column_of(values.reshape(-1)), np.full(len(values), width))
        return column_of(values.tolist() if values.dtype.kind == "O" else pa.array(values))
    listed = list(values)
    with suppress(pa.ArrowException, OverflowError, UnicodeError):
        column = pa.array(listed)  # in several parts if it is very large
        return _plain(column) if isinstance(column, pa.Array) else column_of(column)
    known = [value for value in listed if value is not None]
    if any(isinstance(value, (dict, bytes)) for value in known):
        return _as_json(listed)
    if not any(isinstance(value, _LISTS) for value in known):
        texts = _unless_missing(_text, listed)
        return _without_blanks(pa.array(texts, pa.string()))
    return _from_lists(listed)


def _from_lists(values: Sequence[object]) -> pa.Array:
    """Return lists and matrices as lists; as JSON if one is neither."""
    leaves = _unless_missing(_leaves, values)
    if any(leaf is None for leaf, value in zip(leaves, values, strict=True) if value is not None):
        return _as_json(values)
    entries = column_of(chain.from_iterable(filter(None, leaves)))
    if not _is_leaf(entries.type):
        return _as_json(values)
    return lists_of(entries, _unless_missing(len, leaves))


def _unless_missing(function: Callable[[Any], T], values: Iterable[Any]) -> list[T | None]:
    """Apply a function to each value except None."""
    return [None if value is None else function(value) for value in values]


def _text(value: object) -> str:
    return str(value).encode(errors="backslashreplace").decode()


def _leaves(value: object) -> list[object] | None:
    """Return the values of a list, or those of a matrix row by row; None for rows that differ."""
    if not isinstance(value, _LISTS):
        return None
    leaves = list(value)
    for _ in range(_MAX_LEVELS):
        if not any(isinstance(leaf, _LISTS) for leaf in leaves):
            return leaves
        if len({len(leaf) if isinstance(leaf, _LISTS) else -1 for leaf in leaves}) > 1:
            return None
        leaves = list(chain.from_iterable(leaves))
    return None


def _as_json(values: Sequence[object]) -> pa.Array:
    texts = _unless_missing(partial(json.dumps, default=str), values)
    return pa.array(texts, pa.string()).cast(UNTYPED)


def _plain(column: pa.Array) -> pa.Array:
    """Return the column of values of a supported type."""
    kind = column.type
    if pa.types.is_boolean(kind) or pa.types.is_null(kind) or pa.types.is_temporal(kind):
        return column
    if pa.types.is_string(kind):
        return _without_blanks(column)
    if pa.types.is_integer(kind):
        with suppress(pa.ArrowException):
            return column.cast(pa.int64())
        return column.cast(pa.string())
    if pa.types.is_floating(kind) or pa.types.is_decimal(kind):
        return column.cast(pa.float64())
    if pa.types.is_list(kind):
        return _list_column(column)
    return _as_json(column.to_pylist())


def _supported(values: pa.Array | pa.ChunkedArray) -> pa.Array:
    """Return values without the types that the toolkit does not read: dictionaries, views, extensions."""
    column = values.combine_chunks() if isinstance(values, pa.ChunkedArray) else values
    if isinstance(column, pa.ChunkedArray):  # of no chunk
        column = pa.concat_arrays(column.chunks) if column.num_chunks else pa.array([], column.type)
    if isinstance(column, pa.ExtensionArray):
        column = column.storage
    (supported,) = read.supported_table(pa.table([column], ["values"])).columns
    column = supported.chunk(0) if supported.num_chunks == 1 else supported.combine_chunks()
    if pa.types.is_fixed_size_list(column.type):
        column = column.cast(pa.list_(column.type.value_type))
    return column


def _list_column(column: pa.Array) -> pa.Array:
    lengths = pc.list_value_length(column)
    values = _supported(column.flatten())
    while pa.types.is_list(values.type):
        widths = lengths_of(values)
        if len(widths) != 1 or values.null_count:
            return _from_lists(column.to_pylist())
        lengths = pc.multiply(lengths, widths[0])
        values = _supported(values.flatten())
    entries = column_of(values)
    if not _is_leaf(entries.type):
        return _as_json(column.to_pylist())
    return lists_of(entries, lengths)


def lists_of(entries: pa.Array, lengths: Sequence[int | None] | Int64 | pa.Array) -> pa.Array:
    """Return entries as lists of some lengths, null where the length is."""
    lengths = pa.array(lengths, pa.int32()) if not isinstance(lengths, pa.Array) else lengths
    ends = np.cumsum(lengths.fill_null(0).to_numpy(), dtype=np.int64)
    offsets = pa.array(np.append(0, ends).astype(np.int32))
    mask = pc.is_null(lengths) if lengths.null_count else None
    return pa.ListArray.from_arrays(offsets, entries, mask=mask)


def lengths_of(column: pa.Array) -> list[int]:
    """Return the distinct lengths of lists, sorted; empty for other values."""
    if not pa.types.is_list(column.type):
        return []
    lengths: list[int] = pc.list_value_length(column).unique().drop_null().sort().to_pylist()
    return lengths


def _is_leaf(data_type: pa.DataType) -> bool:
    """Return whether values are numbers, booleans, texts or points in time, or all missing."""
    return not pa.types.is_list(data_type) and data_type != UNTYPED


def _common_type(first: pa.DataType, second: pa.DataType, name: str = "values") -> pa.DataType:
    """Return the type that holds values of both; ArrowException if there is none."""
    if UNTYPED in (first, second) and len({first, second, pa.null()}) > 2:
        raise pa.ArrowInvalid(f"{first} and {second}")
    both = [pa.schema([(name, data_type)]) for data_type in (first, second)]
    return pa.unify_schemas(both, promote_options="permissive").field(0).type


def joined(columns: Sequence[pa.Array]) -> pa.Array:
    """Return columns one after the other, as one column of a type that holds all of their values exactly."""
    kinds = {column.type for column in columns} - {_NOTHING}
    if kinds and all(map(pa.types.is_list, kinds)):
        entries = joined([column.flatten() for column in columns if pa.types.is_list(column.type)])
        lengths = [
            pc.list_value_length(column)
            if pa.types.is_list(column.type)
            else pa.nulls(len(column), pa.int32())
            for column in columns
        ]
        return lists_of(entries, pa.concat_arrays(lengths))
    with suppress(pa.ArrowException):
        kind = reduce(_common_type, (column.type for column in columns), pa.null())
        return pa.concat_arrays([pa.array([], kind), *(column.cast(kind) for column in columns)])
    return column_of(chain.from_iterable(map(values_of, columns)))


def values_of(column: pa.Array) -> list[JsonValue]:
    """Return values as objects of Python."""
    values: list[JsonValue] = column.to_pylist()
    if column.type != UNTYPED:
        return values
    return _unless_missing(json.loads, values)


def texts_of(column: pa.Array) -> pa.Array:
    """Return the text of each value, as of a name; null for a missing one, for NaN, and for lists."""
    if pa.types.is_string(column.type):
        return _without_blanks(pc.utf8_trim_whitespace(column))
    if not _is_leaf(column.type):
        plain = (None if isinstance(value, (dict, list)) else value for value in values_of(column))
        return _without_blanks(pa.array([_name(value) for value in plain], pa.string()))
    encoded = column.dictionary_encode()
    if isinstance(encoded, pa.Array) and not isinstance(encoded, pa.DictionaryArray):  # all null
        return pa.nulls(len(column), pa.string())
    names = pa.array(list(map(_name, encoded.dictionary.to_pylist())), pa.string())
    return names.take(encoded.indices)


def _name(value: object) -> str | None:
    return None if value is None or value != value else _text(value).strip()


def floats_of(column: pa.Array) -> Float64:
    """Return numbers, shape (n,), or lists of them of one length, (n, k); NaN for a missing one.

    Texts may hold several numbers. Raises ValueError for anything else.
    """
    kind = column.type
    if kind in _NUMBERS:
        numbers: Float64 = column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
        return numbers
    if pa.types.is_list(kind) and kind.value_type in _NUMBERS and len(lengths_of(column)) == 1:
        inside = column.flatten().cast(pa.float64(), safe=False)
        rows = np.full((len(column), *lengths_of(column)), np.nan)
        rows[column.is_valid().to_numpy(zero_copy_only=False)] = inside.to_numpy(
            zero_copy_only=False
        ).reshape(-1, rows.shape[1])
        return rows
    try:
        return np.array([_number(value) for value in values_of(column)], np.float64)
    except TypeError as error:
        raise ValueError(str(error)) from error


def _number(value: JsonValue) -> JsonValue:
    """Return a number, or a list of numbers; ValueError or TypeError for anything else."""
    if isinstance(value, (list, tuple)):
        return list(map(_number, value))
    if not isinstance(value, str):
        return float(value)
    words = value.translate(_NO_BRACKETS).split()
    if "_" in value or (len(words) > 1 and _is_one_number(value)):
        raise ValueError(value)
    return float(words[0]) if len(words) == 1 else [float(word) for word in words]


def _is_one_number(text: str) -> bool:
    """Return whether a text is a number with a comma, which may stand before decimals or thousands."""
    left, comma, right = text.strip().partition(",")
    return bool(comma) and left.lstrip("+-").isdecimal() and right.isdecimal()
