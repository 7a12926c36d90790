"""Rows in memory: Arrow columns as numpy views, groups of rows, stored rows, and typed records of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn, TypeVar

import numpy as np
import pyarrow as pa

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.read.schemas import column_names, list_depth
from tactile_toolkit.value_types import AnyArray, Bool, Int64, JsonDict
from tactile_toolkit.wording import did_you_mean

T = TypeVar("T")

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
        offsets = self.levels[level]
        if isinstance(offsets, int):
            return start * offsets, stop * offsets
        return int(offsets[start]), int(offsets[stop])

    def flat(self, level: int, start: int, stop: int) -> AnyArray:
        """Return all values in lists ``start`` to ``stop`` of a level, flat."""
        for deeper in range(level, len(self.levels)):
            start, stop = self.inside(deeper, start, stop)
        values: AnyArray = self.values[start:stop]
        return values

    def padded(self, first: int, last: int, width: int) -> AnyArray | None:
        """View lists ``first`` to ``last`` of level 1 as one array (n, m, width), or (n, m) for a width of 0.

        None unless each of them has m inner lists of ``width`` values, or m values.
        """
        start, stop = self.inside(1, first, last)
        length = (stop - start) // max(last - first, 1)
        values = self.flat(1, first, last)
        starts = self.levels[1]
        is_even = isinstance(starts, int) or (np.diff(starts[first : last + 1]) == length).all()
        if not is_even or len(values) != (last - first) * length * max(width, 1):
            return None
        return values.reshape((last - first, length, width) if width else (last - first, length))

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


class RowGroup:
    """An unpacked row group, or a block of a large one; its columns are numpy views, built on first use.

    ``table`` holds all columns, one chunk each; subclasses may make it on first use. ``path`` and
    ``first_row`` are the origin of the rows, for messages. ``mapped_bytes`` is the size in a mapped file of
    the cache; 0 if the rows are in memory.
    """

    table: pa.Table

    def __init__(
        self, table: pa.Table | None = None, path: str = "", first_row: int = 0, mapped_bytes: int = 0
    ) -> None:
        if table is not None:
            self.table = table
        self.path = path
        self.first_row = first_row
        self.mapped_bytes = mapped_bytes
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
        kept: T = self._views.setdefault(key, build()) if view is None else view
        return kept

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
        position = "" if row is None else f", row {self.first_row + row}"
        return IntegrityError.in_file(
            self.path, f"{position}, field {name!r}: {problem}; expected {expected}"
        )

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


class Row:
    """A stored row, whose fields are read on demand: row ``index`` of ``group``."""

    __slots__ = ("group", "index")

    def __init__(self, group: RowGroup, index: int) -> None:
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
            problem = "no value is stored" if stored is None else f"the value is {stored!r}"
            raise self.group.damaged(name, self.index, problem, "an integer")
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
        own, theirs = (
            pa.table({name: row.group.arrow(name).slice(row.index, 1) for name in sorted(row.group.names)})
            for row in (self, other)
        )
        if own.schema != theirs.schema:
            return False
        # In Arrow, NaN is not equal to itself; as text it is.
        return bool(own.equals(theirs)) or repr(own.to_pydict()) == repr(theirs.to_pydict())

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle as a table of this row only, not of its row group."""
        content = table_bytes(self.group.table.slice(self.index, 1)).to_pybytes()
        return _row_from_ipc, (type(self), content, self.path, self.number)


def _row_from_ipc(row_class: type[Row], content: bytes, path: str, number: int) -> Row:
    return row_class(RowGroup(pa.ipc.open_stream(content).read_all(), path, number), 0)


class FieldAccess:
    """Base class of records that answers habits of dictionaries, such as ``touch["image"]``.

    Fields are attributes: each is read when it is accessed, which a dictionary of all would not allow.
    """

    __slots__ = ()
    TENSORS: ClassVar[str] = "tactile_toolkit.mesh.SolidTensors"
    """Class that makes tensors of such records, for batches."""

    def __getitem__(self, name: object) -> NoReturn:
        """Raise TypeError, which names the attribute."""
        raise TypeError(self._answer(name))

    if not TYPE_CHECKING:  # else every attribute would pass for one that is there

        def __getattr__(self, name: str) -> NoReturn:
            if name.startswith("_"):
                raise AttributeError(name)
            raise AttributeError(self._answer(name))

    def _answer(self, name: object) -> str:
        fields = [known for known in dir(type(self)) if known.islower() and not known.startswith("_")]
        what = f"a {type(self).__name__} is not a dictionary, its fields are attributes"
        if name in fields:
            return f"{what}; next: write .{name}"
        if "extra" in fields and name in self.extra:  # type: ignore[attr-defined]
            return f"{what}; next: write .extra[{name!r}]"
        return f"{what}: {', '.join(fields)}{did_you_mean(str(name), fields)}"


class Record(FieldAccess):
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


def null_fields(table: pa.Table, names: Sequence[str]) -> dict[int, str]:
    """Find rows of a table, with one chunk per column, in which given columns hold a null at any depth.

    Returns the number of each such row with the first null field: ``"placements.shape"``. Absent columns are
    ignored.
    """
    group = RowGroup(table)
    fields: dict[int, str] = {}
    for name in filter(group.names.__contains__, names):
        array = group.arrow(name)
        if not _first_null(array, name):
            continue
        for row in range(len(array)):
            field = _first_null(array.slice(row, 1), name)
            if field:
                fields.setdefault(row, field)
    return fields


def _first_null(array: pa.Array, name: str) -> str:
    """Return the first field in or below a column with a null value; "" if there is none."""
    if array.null_count:
        return name
    if pa.types.is_struct(array.type):
        fields = zip(array.type, array.flatten(), strict=True)
        return next(filter(None, (_first_null(child, f"{name}.{field.name}") for field, child in fields)), "")
    return _first_null(array.flatten(), name) if list_depth(array.type)[0] else ""
