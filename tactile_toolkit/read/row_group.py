"""A group of rows in memory, and its columns as numpy views."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TypeVar

import pyarrow as pa

from tactile_toolkit.array_types import AnyArray
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.json_types import JsonDict
from tactile_toolkit.read.arrow_views import (
    NestedColumn,
    RaggedColumn,
    nested_column,
    numpy_values,
    ragged_column,
)
from tactile_toolkit.read.schemas import column_names, list_depth

T = TypeVar("T")


class Rows:
    """Some rows, with columns as numpy views that are built on first use.

    ``table`` holds all columns, one chunk each; subclasses set it, or make it on first use. ``path`` and
    ``first_row`` are the origin of the rows, for messages.
    """

    table: pa.Table

    def __init__(self, path: str = "", first_row: int = 0) -> None:
        self.path = path
        self.first_row = first_row
        self._ragged: dict[str, RaggedColumn] = {}
        self._flat: dict[str, AnyArray] = {}
        self._views: JsonDict = {}

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Columns by dotted name."""
        return column_names(self.table.schema)

    @cached_property
    def flat_table(self) -> pa.Table:
        """The rows with the fields of structs as columns of their own, by dotted name."""
        table = self.table
        while any(map(pa.types.is_struct, table.schema.types)):
            table = table.flatten()
        return table

    def once(self, key: str, build: Callable[[], T]) -> T:
        """Build a view of the rows on first use, and keep it."""
        view = self._views.get(key)
        # setdefault, here and below: if two threads build a view at once, the first one wins.
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
        """Return the error for an unusable field of a row, or of any row if None."""
        where = "" if row is None else f", row {self.first_row + row}"
        return IntegrityError.in_file(self.path, f"{where}, field {name!r}: {problem}; expected {expected}")

    def nested(self, name: str) -> NestedColumn:
        """Return a column of nested lists, by dotted name."""
        return self.once(name, lambda: nested_column(self.arrow(name)))

    def flat(self, name: str) -> AnyArray:
        """Return a column of plain values as a numpy array."""
        column = self._flat.get(name)
        return self._flat.setdefault(name, numpy_values(self.arrow(name))) if column is None else column

    def arrow(self, name: str) -> pa.Array:
        """Return a column as an Arrow array, by dotted name, whether stored flat or as a struct's field.

        Raises KeyError when the column does not exist.
        """
        # Only the table has whole structs as columns.
        table = self.table if name in self.table.column_names else self.flat_table
        column = table.column(name)
        return column.chunk(0) if column.num_chunks == 1 else column.combine_chunks()


class RowGroup(Rows):
    """An unpacked row group, or a block of a large one.

    ``mapped_bytes`` is its size in a mapped file of the cache; 0 if it is in memory.
    """

    def __init__(self, table: pa.Table, path: str = "", first_row: int = 0, mapped_bytes: int = 0) -> None:
        super().__init__(path, first_row)
        self.table = table
        self.mapped_bytes = mapped_bytes


def null_fields(table: pa.Table, names: Sequence[str]) -> dict[int, str]:
    """Find rows of a table, with one chunk per column, in which given columns hold a null at any depth.

    Returns the number of each such row with the first null field: ``"placements.shape"``. Absent columns are
    ignored.
    """
    group = RowGroup(table)
    found: dict[int, str] = {}
    for name in filter(group.names.__contains__, names):
        array = group.arrow(name)
        if not _first_null(array, name):
            continue
        for row in range(len(array)):
            field = _first_null(array.slice(row, 1), name)
            if field:
                found.setdefault(row, field)
    return found


def _first_null(array: pa.Array, name: str) -> str:
    """Return the first field in or below a column with a null value; "" if there is none."""
    if array.null_count:
        return name
    if pa.types.is_struct(array.type):
        fields = zip(array.type, array.flatten(), strict=True)
        return next(filter(None, (_first_null(child, f"{name}.{field.name}") for field, child in fields)), "")
    return _first_null(array.flatten(), name) if list_depth(array.type)[0] else ""
