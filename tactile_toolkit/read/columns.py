"""Arrow columns as numpy views, without Python lists."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from tactile_toolkit.array_types import AnyArray, Bool, Int64

_EXACT = 1 << 53
_INT_LIMIT = 1 << 63


@dataclass(frozen=True, slots=True, eq=False)
class RaggedColumn:
    """A column of arrays of different lengths, as one flat array and the offsets of rows.

    ``values`` has shape (sum of row lengths, width) and is a view of Arrow's memory; row i is
    ``values[offsets[i]:offsets[i + 1]]``.
    """

    values: AnyArray
    offsets: AnyArray

    def __len__(self) -> int:
        return len(self.offsets) - 1

    def __getitem__(self, row: int) -> AnyArray:
        """Return the array of one row, shape (n, width), without a copy."""
        return self.values[self.offsets[row] : self.offsets[row + 1]]


def ragged_column(array: pa.Array) -> RaggedColumn:
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
    # Without rows the width is unknown; 3 is that of vertices and triangles.
    width = (widths or [3])[0]
    return RaggedColumn(column.values.reshape(-1, width), np.asarray(offsets))


def vectors_type(value_type: pa.DataType, width: int = 3) -> pa.DataType:
    """Return the Arrow type ``list<value_type[width]>``."""
    return pa.list_(pa.list_(value_type, width))


def ragged_array(column: RaggedColumn, value_type: pa.DataType) -> pa.ListArray:
    """Pack contiguous rows into ``list<value_type[width]>``, without Python lists."""
    width = column.values.shape[1]
    # Not value_type.to_pandas_dtype(): it imports pandas, which takes a second.
    inner = pa.FixedSizeListArray.from_arrays(pa.array(column.values.reshape(-1), value_type), width)
    offsets = pa.array(column.offsets, pa.int32())
    return pa.ListArray.from_arrays(offsets, inner, type=vectors_type(value_type, width))


@dataclass(frozen=True, slots=True, eq=False)
class BytesColumn:
    """Byte strings one after another in Arrow's memory: string i is ``data[offsets[i]:offsets[i + 1]]``.

    ``present`` states which of them are not null; None when none are null.
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
    """A column of nested lists, such as rows of touches of frames of vectors, padded or ragged.

    Attributes
    ----------
    levels : tuple of ndarray or int
        For each level of nesting, from the rows inwards: the offsets of the lists (one more than lists), or
        the length that all lists share.
    values : ndarray or BytesColumn
        Values of the innermost lists, a view of Arrow's memory without nulls.
    nulls : int
        Number of null lists and values.
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
        """Return all values in lists ``start`` to ``stop`` of a level, flat."""
        for deeper in range(level, len(self.levels)):
            start, stop = self.inside(deeper, start, stop)
        values: AnyArray = self.values[start:stop]
        return values

    def lengths(self, level: int) -> Int64:
        """Return the length of each list of a level that has offsets, not one shared length."""
        return np.diff(np.asarray(self.levels[level])).astype(np.int64)


def nested_column(array: pa.Array) -> NestedColumn:
    """View an Arrow array of lists of any depth as numpy."""
    levels: list[AnyArray | int] = []
    nulls = array.null_count
    # A slice keeps the values of all rows, so they are cut here: Arrow would import `pyarrow.compute` for
    # that, which takes longer than unpacking the first row group.
    while isinstance(array.type, (pa.ListType, pa.FixedSizeListType)):
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
    if pa.types.is_struct(array.type):  # an image or clip: bytes and name
        array = array.flatten()[array.type.get_field_index("bytes")]
    if not pa.types.is_binary(array.type):
        return NestedColumn(tuple(levels), numpy_values(array), nulls)
    # Byte strings have offsets like lists, but pyarrow 26 does not expose them.
    _, stored_offsets, data = array.buffers()
    starts = np.frombuffer(stored_offsets, np.int32, len(array) + 1, array.offset * 4)
    present = None if array.null_count == 0 else array.is_valid().to_numpy(zero_copy_only=False)
    blobs = memoryview(data).cast("B") if data is not None else memoryview(b"")
    return NestedColumn(tuple(levels), BytesColumn(blobs, starts, present), nulls)


def numpy_values(array: pa.Array) -> AnyArray:
    """Return the values of an Arrow array, read-only; numbers become floats if some are null."""
    # Arrow's `to_numpy` imports pandas, which takes half a second.
    if array.null_count or not (pa.types.is_integer(array.type) or pa.types.is_floating(array.type)):
        values: AnyArray = array.to_numpy(zero_copy_only=False)
    else:
        values = np.from_dlpack(array)
    values.setflags(write=False)
    return values


def table_bytes(table: pa.Table) -> pa.Buffer:
    """Pack a table as an Arrow stream; returns an Arrow buffer."""
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    return sink.getvalue()


def whole_number(value: object) -> int | None:
    """Convert a stored value to an integer, such as 3.0 to 3; None if it is not an integer.

    Other libraries store integers as floats if some are missing. Floats from 2**53 on are refused, because
    they may represent several integers.
    """
    number: Any = value
    try:
        whole = int(number)
    except (TypeError, ValueError, OverflowError):
        return None
    limit = _EXACT if isinstance(value, float) else _INT_LIMIT
    return whole if whole == number and -limit <= whole < limit else None


def whole_numbers(values: AnyArray) -> Bool:
    """Return the mask of values that are integers, as in :func:`whole_number`."""
    if values.dtype.kind in "bi":
        return np.ones(values.shape, bool)
    if values.dtype.kind == "u":
        return np.asarray(values < np.uint64(_INT_LIMIT))
    if values.dtype.kind == "f":
        return np.asarray((values >= -_EXACT) & (values < _EXACT) & (values == np.trunc(values)))
    return np.array([whole_number(value) is not None for value in values.tolist()], bool)
