"""Rows of a Parquet file unpacked: columns as numpy views of Arrow memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from numpy.typing import NDArray

from dataset_store.columns import RaggedColumn, column_names, ragged_column

__all__ = ["RowGroup"]


@dataclass(frozen=True, eq=False)
class RowGroup:
    """One unpacked row group, or a block of a large one: columns as numpy views of mapped memory.

    Parameters
    ----------
    table : pyarrow.Table
        The rows, one chunk per column.
    path : str
        File that the rows come from, for messages.
    first_row : int
        Number of the first row in that file.
    mapped : bool
        Whether the rows lie in a mapped file of the cache, so that holding on to them costs no memory.
    """

    table: Any
    path: str = ""
    first_row: int = 0
    mapped: bool = False
    _ragged: dict[str, RaggedColumn] = field(default_factory=dict, repr=False)
    _flat: dict[str, NDArray[Any]] = field(default_factory=dict, repr=False)
    _views: dict[str, Any] = field(default_factory=dict, repr=False)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Columns by dotted name."""
        return column_names(self.table.schema)

    def once(self, key: str, build: Callable[[], Any]) -> Any:
        """Build a view of the rows on its first use and keep it with them."""
        view = self._views.get(key)
        return self._views.setdefault(key, build()) if view is None else view

    def ragged(self, name: str) -> RaggedColumn:
        """Return a column of arrays of shape (n_i, width), by dotted name."""
        column = self._ragged.get(name)
        if column is None:
            column = self._ragged.setdefault(name, ragged_column(self.arrow(name)))
        return column

    def flat(self, name: str) -> NDArray[Any]:
        """Return a column of plain values as a numpy array."""
        column = self._flat.get(name)
        if column is None:
            column = self._flat.setdefault(name, self.arrow(name).to_numpy(zero_copy_only=False))
        return column

    def arrow(self, name: str) -> Any:
        """Return a column as an Arrow array, by dotted name, whether stored flat or as a struct's field.

        Raises
        ------
        KeyError
            When there is no such column.
        """
        outer, *inner = _split_name(name, self.table.column_names)
        array = _one_chunk(self.table.column(outer))
        for part in inner:
            array = _struct_field(array, part, name)
        return array


def _split_name(name: str, columns: Sequence[str]) -> list[str]:
    """Split ``a.b.c`` into the stored column, which may hold dots itself, and the fields inside it."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        outer = ".".join(parts[:count])
        if outer in columns:
            return [outer, *parts[count:]]
    raise KeyError(name)


def _struct_field(array: Any, part: str, name: str) -> Any:
    import pyarrow as pa

    if not pa.types.is_struct(array.type) or array.type.get_field_index(part) < 0:
        raise KeyError(name)
    return array.flatten()[array.type.get_field_index(part)]


def _one_chunk(column: Any) -> Any:
    return column.chunk(0) if column.num_chunks == 1 else column.combine_chunks()
