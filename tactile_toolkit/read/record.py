"""Stored rows, and typed records of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa

from tactile_toolkit.array_types import AnyArray
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.json_types import JsonDict
from tactile_toolkit.read.arrow_views import table_bytes
from tactile_toolkit.read.integer_columns import whole_number
from tactile_toolkit.read.row_group import RowGroup, Rows

T = TypeVar("T")


class Row:
    """A stored row, whose fields are read on demand: row ``index`` of ``group``."""

    __slots__ = ("group", "index")

    def __init__(self, group: Rows, index: int) -> None:
        self.group = group
        self.index = index

    def array(self, name: str) -> AnyArray:
        """Return a field of shape (n, width) as a read-only view of the stored values."""
        try:
            return self.group.ragged(name)[self.index]
        except IntegrityError:  # possibly of another row: read this row by itself
            alone = self.group.table.slice(self.index, 1)
            return RowGroup(alone, self.path, self.number).ragged(name)[0]

    def value(self, name: str) -> Any:
        """Return a plain field as a numpy scalar or a Python object."""
        return self.group.flat(name)[self.index]

    def required(self, name: str) -> Any:
        """Return a plain field as :meth:`value` does; IntegrityError if it is null."""
        value = self.value(name)
        # Nulls of numbers become NaN in numpy.
        missing = value is None or (isinstance(value, (float, np.floating)) and value != value)
        if missing and not self.group.arrow(name)[self.index].is_valid:
            raise self.group.damaged(name, self.index, "no value is stored")
        return value

    def integer(self, name: str) -> int:
        """Return a plain field as an int; IntegrityError if it is null or not an integer, such as 1.5."""
        value = self.value(name)
        if isinstance(value, np.signedinteger):
            return int(value)
        # Another null value in the column makes the numpy column inexact.
        stored = self.group.arrow(name)[self.index].as_py()
        number = whole_number(stored)
        if number is None:
            found = "no value is stored" if stored is None else f"the value is {stored!r}"
            raise self.group.damaged(name, self.index, found, "an integer")
        return number

    def has(self, name: str) -> bool:
        """Return whether the data set has a column."""
        return name in self.group.names

    @property
    def path(self) -> str:
        """File of the row."""
        return self.group.path

    @property
    def number(self) -> int:
        """Number of the row in its file."""
        return self.group.first_row + self.index

    def equals(self, other: Row) -> bool:
        """Return whether two rows have the same columns and values, wherever they are stored."""
        one, another = (
            pa.table({name: row.group.arrow(name).slice(row.index, 1) for name in sorted(row.group.names)})
            for row in (self, other)
        )
        if one.schema != another.schema:
            return False
        # In Arrow, NaN is not equal to itself; as text it is.
        return bool(one.equals(another)) or repr(one.to_pydict()) == repr(another.to_pydict())

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle as a table of this row only, not of its row group."""
        content = table_bytes(self.group.table.slice(self.index, 1)).to_pybytes()
        return _row_from_ipc, (content, self.path, self.number)


def _row_from_ipc(content: bytes, path: str, number: int) -> Row:
    return Row(RowGroup(pa.ipc.open_stream(content).read_all(), path, number), 0)


class Record:
    """Base class of typed records of one row: immutable, lazy, picklable.

    Attributes
    ----------
    row : Row
        The row as it is stored, with all its columns.
    """

    __slots__ = ("_loaded", "row")
    row: Row
    _loaded: JsonDict

    def __init__(self, row: Row) -> None:
        object.__setattr__(self, "row", row)
        object.__setattr__(self, "_loaded", {})

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"{type(self).__name__} is frozen; {name!r} cannot be set")

    def __reduce__(self) -> tuple[object, ...]:
        return (type(self), (self.row,))

    def __eq__(self, other: object) -> bool:
        """Return whether the other is a record of the same class with the same stored values."""
        if not isinstance(other, Record) or type(other) is not type(self):
            return NotImplemented
        return self.row.equals(other.row)

    def __hash__(self) -> int:
        # From this row only, so that a damaged neighbour does not make a record differ from its pickled
        # copy.
        try:
            number = self.row.group.arrow("id")[self.row.index].as_py()
        except (KeyError, ValueError):
            number = None
        return hash((type(self), number))

    def tile_html(self) -> str:
        """Return HTML for notebooks of a small picture of the record, if there is any."""
        return ""

    def _once(self, name: str, load: Callable[[], T]) -> T:
        """Load a field on its first use and keep it."""
        loaded = self._loaded
        if name not in loaded:
            loaded[name] = load()
        value: T = loaded[name]
        return value
