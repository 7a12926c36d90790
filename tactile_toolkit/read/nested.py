"""Nested Arrow lists seen as numpy arrays: rows of touches of frames of vectors, padded or ragged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.read.parquet import RowGroup

__all__ = ["BytesColumn", "NestedColumn", "list_depth", "nested_column"]


@dataclass(frozen=True, slots=True, eq=False)
class BytesColumn:
    """Byte strings one after another in Arrow's memory.

    Attributes
    ----------
    data : memoryview
        All strings.
    offsets : ndarray of int, shape (n + 1,)
        String i is ``data[offsets[i]:offsets[i + 1]]``.
    present : ndarray of bool, shape (n,), or None
        Which of them are stored at all; None when all are.
    """

    data: memoryview
    offsets: NDArray[Any]
    present: NDArray[np.bool_] | None

    def __getitem__(self, index: int) -> memoryview | None:
        """Return one string without a copy; None when it is null."""
        if self.present is not None and not self.present[index]:
            return None
        return self.data[self.offsets[index] : self.offsets[index + 1]]

    def __len__(self) -> int:
        return len(self.offsets) - 1


@dataclass(frozen=True, slots=True, eq=False)
class NestedColumn:
    """A column of nested lists.

    Attributes
    ----------
    levels : tuple of (ndarray of int, or int)
        Per level of nesting, from the rows inwards: where each list begins (one more than there are lists),
        or the length that all lists share.
    values : ndarray or BytesColumn
        What the innermost lists hold, one after another; a view of Arrow's memory where it has no nulls.
    """

    levels: tuple[NDArray[Any] | int, ...]
    values: Any

    def inside(self, level: int, start: int, stop: int) -> tuple[int, int]:
        """Return the range of the next level that lists ``start`` to ``stop`` of a level cover."""
        where = self.levels[level]
        if isinstance(where, int):
            return start * where, stop * where
        return int(where[start]), int(where[stop])

    def flat(self, level: int, start: int, stop: int) -> NDArray[Any]:
        """Return all values below lists ``start`` to ``stop`` of a level, flat."""
        for deeper in range(level, len(self.levels)):
            start, stop = self.inside(deeper, start, stop)
        values: NDArray[Any] = self.values[start:stop]
        return values

    def lengths(self, level: int) -> NDArray[np.int64]:
        """Return the length of every list of a level, where the level stores places (not a shared length)."""
        return np.diff(np.asarray(self.levels[level])).astype(np.int64)


def nested_column(group: RowGroup, name: str) -> NestedColumn:
    """View a column of a row group as nested lists; built once per row group.

    Raises
    ------
    KeyError
        When there is no such column.
    """
    column: NestedColumn = group.once(f"nested {name}", lambda: _unnest(group.arrow(name)))
    return column


def _unnest(array: Any) -> NestedColumn:
    import pyarrow as pa

    levels: list[NDArray[Any] | int] = []
    while True:
        if pa.types.is_fixed_size_list(array.type):
            width = array.type.list_size
            levels.append(width)
            array = array.values.slice(array.offset * width, len(array) * width)
        elif pa.types.is_list(array.type) or pa.types.is_large_list(array.type):
            levels.append(array.offsets.to_numpy(zero_copy_only=True))
            array = array.values
        else:
            return NestedColumn(tuple(levels), _leaf(array))


def _leaf(array: Any) -> Any:
    import pyarrow as pa

    if pa.types.is_struct(array.type):
        array = array.flatten()[array.type.get_field_index("bytes")]
    if pa.types.is_binary(array.type) or pa.types.is_large_binary(array.type):
        return _bytes(array)
    return array.to_numpy(zero_copy_only=False)


def _bytes(array: Any) -> BytesColumn:
    import pyarrow as pa

    dtype = np.dtype(np.int64 if pa.types.is_large_binary(array.type) else np.int32)
    _, places, data = array.buffers()
    offsets = np.frombuffer(places, dtype, len(array) + 1, array.offset * dtype.itemsize)
    present = None if array.null_count == 0 else array.is_valid().to_numpy(zero_copy_only=False)
    return BytesColumn(memoryview(data).cast("B") if data is not None else memoryview(b""), offsets, present)


def list_depth(data_type: Any) -> tuple[int, Any]:
    """Return how many lists are nested in an Arrow type, and the type inside them."""
    import pyarrow as pa

    depth = 0
    while (
        pa.types.is_list(data_type)
        or pa.types.is_large_list(data_type)
        or pa.types.is_fixed_size_list(data_type)
    ):
        depth, data_type = depth + 1, data_type.value_type
    return depth, data_type
