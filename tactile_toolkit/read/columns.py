"""Arrow columns seen as numpy arrays, without passing through Python lists; what schemas state of them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import msgspec
import numpy as np

from tactile_toolkit.array_types import AnyArray, Bool, Int64
from tactile_toolkit.errors import IntegrityError

_EXACT = 1 << 53
_INT_LIMIT = 1 << 63

T = TypeVar("T")
N = TypeVar("N", tuple[str, ...], None)


@dataclass(frozen=True, slots=True, eq=False)
class RaggedColumn:
    """A column of arrays of different lengths, as one flat array and the offsets at which rows begin.

    ``values`` has the shape (sum of row lengths, width) and is a view of Arrow's memory; row i is
    ``values[offsets[i]:offsets[i + 1]]``.
    """

    values: AnyArray
    offsets: AnyArray

    def __len__(self) -> int:
        return len(self.offsets) - 1

    def __getitem__(self, row: int) -> AnyArray:
        """Return the array of one row, shape (n, width), without a copy."""
        return self.values[self.offsets[row] : self.offsets[row + 1]]


def ragged_column(array: Any) -> RaggedColumn:
    """View ``list<fixed_size_list<T>[w]>``, or ``list<list<T>>`` with inner lists of one width, as numpy.

    Raises ValueError for nulls, and for inner lists of several widths.
    """
    column = nested_column(array)
    if column.nulls:
        raise ValueError(f"{column.nulls} null values where every row needs one")
    offsets, inner = column.levels
    widths = [inner] if isinstance(inner, int) else np.unique(np.diff(inner)).tolist()
    if len(widths) > 1:
        raise ValueError(f"inner lists of {widths[0]} and {widths[1]} values in one column")
    # Without a row the width is unknown; that of corners and triangles does no harm.
    width = widths[0] if widths else 3
    return RaggedColumn(column.values.reshape(-1, width), np.asarray(offsets))


def vectors_type(value_type: Any, width: int = 3) -> Any:
    """Return the Arrow type ``list<value_type[width]>``."""
    import pyarrow as pa

    return pa.list_(pa.list_(value_type, width))


def ragged_array(column: RaggedColumn, value_type: Any) -> Any:
    """Pack rows that already lie one after another into ``list<value_type[width]>``, with no Python list."""
    import pyarrow as pa

    width = column.values.shape[1]
    # Not value_type.to_pandas_dtype(): it imports pandas, which takes a second.
    inner = pa.FixedSizeListArray.from_arrays(pa.array(column.values.reshape(-1), value_type), width)
    offsets = pa.array(column.offsets, pa.int32())
    return pa.ListArray.from_arrays(offsets, inner, type=vectors_type(value_type, width))


@dataclass(frozen=True, slots=True, eq=False)
class BytesColumn:
    """Byte strings one after another in Arrow's memory: string i is ``data[offsets[i]:offsets[i + 1]]``.

    ``present`` states which of them are stored at all; None when all are.
    """

    data: memoryview
    offsets: AnyArray
    present: Bool | None

    def __getitem__(self, index: int) -> memoryview | None:
        """Return one string without a copy; None when it is null."""
        if self.present is not None and not self.present[index]:
            return None
        return self.data[self.offsets[index] : self.offsets[index + 1]]

    def __len__(self) -> int:
        return len(self.offsets) - 1


@dataclass(frozen=True, slots=True, eq=False)
class NestedColumn:
    """A column of lists in lists: rows of touches of frames of vectors, padded or ragged.

    Attributes
    ----------
    levels : tuple of ndarray or int
        Per level of nesting, from the rows inwards: where each list begins (one more than there are lists),
        or the length that all lists share.
    values : ndarray or BytesColumn
        What the innermost lists hold, a view of Arrow's memory without nulls.
    nulls : int
        How many lists and values are null.
    """

    levels: tuple[AnyArray | int, ...]
    values: Any
    nulls: int

    def inside(self, level: int, start: int, stop: int) -> tuple[int, int]:
        """Return the range of the next level that lists ``start`` to ``stop`` of a level cover."""
        where = self.levels[level]
        if isinstance(where, int):
            return start * where, stop * where
        return int(where[start]), int(where[stop])

    def flat(self, level: int, start: int, stop: int) -> AnyArray:
        """Return all values below lists ``start`` to ``stop`` of a level, flat."""
        for deeper in range(level, len(self.levels)):
            start, stop = self.inside(deeper, start, stop)
        values: AnyArray = self.values[start:stop]
        return values

    def lengths(self, level: int) -> Int64:
        """Return the length of every list of a level that stores offsets (not one shared length)."""
        return np.diff(np.asarray(self.levels[level])).astype(np.int64)


def nested_column(array: Any) -> NestedColumn:
    """View an Arrow array of lists at any depth as numpy."""
    import pyarrow as pa

    levels: list[AnyArray | int] = []
    nulls = array.null_count
    # A slice keeps the values of all rows, which are cut out here: Arrow imports `pyarrow.compute` for that,
    # which takes longer than to unpack the first row group.
    while list_depth(array.type)[0]:
        if pa.types.is_fixed_size_list(array.type):
            width = array.type.list_size
            levels.append(width)
            array = array.values.slice(array.offset * width, len(array) * width)
        else:
            offsets = numpy_values(array.offsets)
            first, last = (int(offsets[0]), int(offsets[-1])) if len(offsets) else (0, 0)
            levels.append(offsets - first if first else offsets)
            array = array.values.slice(first, last - first)
        nulls += array.null_count
    if pa.types.is_struct(array.type):  # an image or clip: its bytes, and the name it once had
        array = array.flatten()[array.type.get_field_index("bytes")]
    if not pa.types.is_binary(array.type):
        return NestedColumn(tuple(levels), numpy_values(array), nulls)
    # Byte strings have offsets as lists do, but pyarrow 26 does not hand them out.
    _, stored_offsets, data = array.buffers()
    starts = np.frombuffer(stored_offsets, np.int32, len(array) + 1, array.offset * 4)
    present = None if array.null_count == 0 else array.is_valid().to_numpy(zero_copy_only=False)
    blobs = memoryview(data).cast("B") if data is not None else memoryview(b"")
    return NestedColumn(tuple(levels), BytesColumn(blobs, starts, present), nulls)


def numpy_values(array: Any) -> AnyArray:
    """Return the values of an Arrow array, read-only; where some are null, numbers become floats."""
    import pyarrow as pa

    # Arrow's `to_numpy` imports pandas, which takes half a second.
    if array.null_count or not (pa.types.is_integer(array.type) or pa.types.is_floating(array.type)):
        values: AnyArray = array.to_numpy(zero_copy_only=False)
    else:
        values = np.from_dlpack(array)
    values.setflags(write=False)
    return values


def list_depth(data_type: Any) -> tuple[int, Any]:
    """Return how many lists are nested in an Arrow type, and the type inside them."""
    import pyarrow as pa

    depth = 0
    while isinstance(data_type, (pa.ListType, pa.FixedSizeListType)):
        depth, data_type = depth + 1, data_type.value_type
    return depth, data_type


def column_types(fields: Iterable[Any], prefix: str = "") -> dict[str, Any]:
    """Return the Arrow type of each column of a schema by dotted name, that of a struct before its fields'.

    Struct ``a<b, c>`` and flat ``a.b``, ``a.c`` read alike.
    """
    import pyarrow as pa

    types = {}
    for each in fields:
        name = prefix + each.name
        types[name] = each.type
        if pa.types.is_struct(each.type):
            types |= column_types(each.type, f"{name}.")
    return types


def column_names(schema: Any) -> tuple[str, ...]:
    """List columns by dotted name, at any depth; a struct goes by its fields."""
    import pyarrow as pa

    types = column_types(schema).items()
    return tuple([name for name, data_type in types if not pa.types.is_struct(data_type)])


def table_bytes(table: Any) -> Any:
    """Pack a table as an Arrow stream; returns an Arrow buffer."""
    import pyarrow as pa

    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    return sink.getvalue()


def null_fields(table: Any, names: Sequence[str]) -> dict[int, str]:
    """Find the rows of a table, one chunk per column, in which one of some columns holds a null at any depth.

    Returns the number of each such row with the first field in which the null lies: ``"placements.shape"``.
    Columns that are absent are passed over.
    """
    group = RowGroup(table)
    found: dict[int, str] = {}
    for name in filter(group.names.__contains__, names):
        array = group.arrow(name)
        for row in range(len(array)) if _first_null(array, name) else ():
            part = _first_null(array.slice(row, 1), name)
            if part:
                found.setdefault(row, part)
    return found


def _first_null(array: Any, name: str) -> str:
    """Return the first field in or below a column in which a value is null; "" where none is."""
    import pyarrow as pa

    if array.null_count:
        return name
    if pa.types.is_struct(array.type):
        fields = zip(array.type, array.flatten(), strict=True)
        return next(filter(None, (_first_null(child, f"{name}.{field.name}") for field, child in fields)), "")
    return _first_null(array.flatten(), name) if list_depth(array.type)[0] else ""


class Rows:
    """Some rows that lie together: columns as numpy views, each built on its first use.

    ``table`` holds all columns, one chunk each; a subclass sets it, or makes it on first use. ``path`` and
    ``first_row`` say where the rows are from, for messages.
    """

    table: Any

    def __init__(self, path: str = "", first_row: int = 0) -> None:
        self.path = path
        self.first_row = first_row
        self._ragged: dict[str, RaggedColumn] = {}
        self._flat: dict[str, AnyArray] = {}
        self._views: dict[str, Any] = {}

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Columns by dotted name."""
        return column_names(self.table.schema)

    @cached_property
    def flat_table(self) -> Any:
        """The rows with the fields of structs as columns of their own, by dotted name."""
        import pyarrow as pa

        table = self.table
        while any(map(pa.types.is_struct, table.schema.types)):
            table = table.flatten()
        return table

    def once(self, key: str, build: Callable[[], T]) -> T:
        """Build a view of the rows on its first use and keep it with them."""
        view = self._views.get(key)
        # setdefault, here and below: of two threads that build a view at once, both get that of the first.
        found: T = self._views.setdefault(key, build()) if view is None else view
        return found

    def ragged(self, name: str) -> RaggedColumn:
        """Return a column of arrays of shape (n_i, width), by dotted name; IntegrityError for a null."""
        column = self._ragged.get(name)
        if column is not None:
            return column
        try:
            return self._ragged.setdefault(name, ragged_column(self.arrow(name)))
        except ValueError as error:
            row = min(null_fields(self.table, [name]), default=None)
            raise self.damaged(name, row, f"{error}" if row is None else "no value is stored") from error

    def damaged(
        self, name: str, row: int | None, problem: str, expected: str = "a value in every row"
    ) -> IntegrityError:
        """Return the error for a field of a row of these, or of any of them, that cannot be used."""
        where = "" if row is None else f", row {self.first_row + row}"
        return IntegrityError.in_file(self.path, f"{where}, field {name!r}: {problem}; expected {expected}")

    def nested(self, name: str) -> NestedColumn:
        """Return a column of nested lists, by dotted name."""
        return self.once(name, lambda: nested_column(self.arrow(name)))

    def flat(self, name: str) -> AnyArray:
        """Return a column of plain values as a numpy array."""
        column = self._flat.get(name)
        return self._flat.setdefault(name, numpy_values(self.arrow(name))) if column is None else column

    def arrow(self, name: str) -> Any:
        """Return a column as an Arrow array, by dotted name, whether stored flat or as a struct's field.

        Raises KeyError when the column does not exist.
        """
        # A struct as a whole is a column of the table alone.
        table = self.table if name in self.table.column_names else self.flat_table
        column = table.column(name)
        return column.chunk(0) if column.num_chunks == 1 else column.combine_chunks()


class RowGroup(Rows):
    """One unpacked row group, or a block of a large one.

    ``mapped_bytes`` of it lie in a mapped file of the cache, so that holding on to them costs little; 0 where
    they lie in memory.
    """

    def __init__(self, table: Any, path: str = "", first_row: int = 0, mapped_bytes: int = 0) -> None:
        super().__init__(path, first_row)
        self.table = table
        self.mapped_bytes = mapped_bytes


# --- types of others --------------------------------------------------------------------------------


def plain_type(data_type: Any) -> Any:
    """Return the type of ours for the same values: no dictionary, view, 64-bit offset or half float."""
    import pyarrow as pa

    kinds = pa.types
    if kinds.is_dictionary(data_type):
        return plain_type(data_type.value_type)
    if kinds.is_string_view(data_type) or kinds.is_large_string(data_type):
        return pa.string()
    if kinds.is_binary_view(data_type) or kinds.is_large_binary(data_type):
        return pa.binary()
    if kinds.is_float16(data_type):
        return pa.float32()
    if kinds.is_struct(data_type):
        return pa.struct([each.with_type(plain_type(each.type)) for each in data_type])
    if kinds.is_map(data_type):
        return pa.map_(plain_type(data_type.key_type), plain_type(data_type.item_type))
    lists = (pa.ListType, pa.LargeListType, pa.ListViewType, pa.LargeListViewType, pa.FixedSizeListType)
    if not isinstance(data_type, lists):
        return data_type
    element = data_type.value_field.with_type(plain_type(data_type.value_type))
    return pa.list_(element, data_type.list_size if kinds.is_fixed_size_list(data_type) else -1)


def plain_schema(schema: Any) -> Any:
    """Return a schema with :func:`plain_type` of each column; the schema itself where all are plain."""
    import pyarrow as pa

    types = list(map(plain_type, schema.types))
    if types == schema.types:
        return schema
    # What other libraries note of a field that is changed, such as its categories, holds no more.
    fields = [
        each if each.type == data_type else pa.field(each.name, data_type, each.nullable)
        for each, data_type in zip(schema, types, strict=True)
    ]
    return pa.schema(fields, schema.metadata)


def plain_table(table: Any) -> Any:
    """Return a table with the types of :func:`plain_schema` and the same values; itself where it has them."""
    import pyarrow as pa

    schema = plain_schema(table.schema)
    if schema is table.schema or schema.types == table.schema.types:
        return table
    columns = [_plain_column(*each) for each in zip(table.columns, schema.types, strict=True)]
    return pa.table(columns, schema=schema)


def _plain_column(column: Any, data_type: Any) -> Any:
    import pyarrow as pa

    if "list_view" not in str(column.type):
        return column.cast(data_type)
    # pyarrow 26 casts those with a null wrongly.
    return pa.chunked_array([pa.array(chunk.to_pylist(), data_type) for chunk in column.chunks], data_type)


def whole_number(value: object) -> int | None:
    """Return the integer that a stored value means, as 3.0 means 3; None where it means none.

    Other libraries store integers as floats where some are missing. Floats from 2**53 on are refused: they
    may stand for several integers.
    """
    number: Any = value
    try:
        whole = int(number)
    except (TypeError, ValueError, OverflowError):
        return None
    limit = _EXACT if isinstance(value, float) else _INT_LIMIT
    return whole if whole == number and -limit <= whole < limit else None


def whole_numbers(values: AnyArray) -> Bool:
    """Return which values mean integers, each as :func:`whole_number` decides."""
    if values.dtype.kind in "bi":
        return np.ones(values.shape, bool)
    if values.dtype.kind == "u":
        return np.asarray(values < np.uint64(_INT_LIMIT))
    if values.dtype.kind == "f":
        return np.asarray((values >= -_EXACT) & (values < _EXACT) & (values == np.trunc(values)))
    return np.array([whole_number(value) is not None for value in values.tolist()], bool)


Expected = tuple[int, tuple[Callable[[Any], bool], ...], str]
"""What a column must be: depth of nesting, tests of the innermost type of which one must hold, and words."""


def wrong_type(types: Mapping[str, Any], expected: Mapping[str, Expected]) -> str:
    """Say which column that is there has a type from which values cannot be read; empty where none has."""
    import pyarrow as pa

    for name in filter(types.__contains__, expected):
        depth, tests, words = expected[name]
        found_depth, leaf = list_depth(types[name])
        if pa.types.is_struct(leaf) and leaf.get_field_index("bytes") >= 0:
            leaf = leaf.field("bytes").type
        if found_depth != depth or not any(test(leaf) for test in tests):
            return f"field {name!r}: the column has the type {types[name]}; expected {words}"
    return ""


# --- what `datasets` stores of the features of a data set ---------------------------------------------

# Arrow's words for what numpy and `datasets` call otherwise.
_DTYPES = {"double": "float64", "float": "float32", "halffloat": "float16"}


class _Label(msgspec.Struct):
    names: list[str] | None = None


class _Info(msgspec.Struct):
    features: dict[str, Any] | None = None


class _Metadata(msgspec.Struct):
    info: _Info | None = None


def dtype_name(data_type: Any) -> str:
    """Return what `datasets` calls an Arrow type of single values."""
    return _DTYPES.get(str(data_type), str(data_type))


def label_feature(names: Sequence[str]) -> dict[str, Any]:
    """Describe the label column to `datasets`."""
    return {"names": list(names), "_type": "ClassLabel"}


def feature_metadata(features: Mapping[str, Any]) -> dict[str, str]:
    """Return schema metadata from which `datasets` reads the features of a Parquet file."""
    return {"huggingface": json.dumps({"info": {"features": dict(features)}})}


def stored_features(schema: Any, where: str) -> dict[str, Any]:
    """Return what `datasets` stored in a schema about its columns, by name; nothing where it stored nothing.

    Raises IntegrityError, which names the file ``where``, when the metadata do not describe features.
    """
    text = (schema.metadata or {}).get(b"huggingface", b"{}")
    try:
        found = (msgspec.json.decode(text, type=_Metadata).info or _Info()).features or {}
        msgspec.convert(found.get("label"), _Label | None)
    except (msgspec.MsgspecError, RecursionError) as error:
        beginning = text[:80].decode(errors="replace")
        raise IntegrityError(
            f"{where!r}, field 'label': the metadata 'huggingface' begins with {beginning!r}; expected the "
            "features of the data set, class names among them, in JSON",
            next="download or convert the data set again",
        ) from error
    return found


def class_names(schema: Any, default: N, where: str = "") -> tuple[str, ...] | N:
    """Return the names of the classes that `datasets` stored in a schema; ``default`` where it stored none.

    Raises IntegrityError, naming the data set, ``where``, for what does not describe features.
    """
    names = (stored_features(schema, where).get("label") or {}).get("names")
    return default if names is None else tuple(names)
