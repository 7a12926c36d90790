"""Record data sets: lazy sequences of typed records over stored rows."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, ClassVar, Generic, Self, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.read.parquet import RowGroup, ShardedTable

__all__ = ["Record", "RecordDataset", "Row", "positions"]


def positions(index: Any, length: int) -> NDArray[Any]:
    """Turn ints or a boolean mask into positions, shape (n,), of a sequence of that length.

    Raises IndexError for a mask of another length, TypeError for anything else.
    """
    chosen = np.asarray(index)
    if chosen.dtype == bool:
        if chosen.shape != (length,):
            message = f"a boolean mask of shape {chosen.shape} for {length} rows"
            raise IndexError(message)
        return np.flatnonzero(chosen)
    if chosen.size == 0:
        return chosen.astype(np.int64)
    if chosen.dtype.kind not in "iu" or chosen.ndim != 1:
        message = f"rows are chosen by ints or booleans in one dimension, not {chosen.dtype} {chosen.shape}"
        raise TypeError(message)
    return chosen


_LARGEST = np.iinfo(np.int64).max


def _int_column(tables: Sequence[ShardedTable], name: str, rows: Any) -> NDArray[np.int64]:
    """Read chosen rows (slice or ints, through all tables) of one column of integers; KeyError without it.

    Raises IntegrityError when a value of these rows is missing or does not fit into 64 bits.
    """
    # With each value, kept with the table: whether it is unusable. What other rows hold does not matter.
    parts = [
        table.per_shard(f"ints of {name}", lambda shard: [_ints(shard.column(name))]) for table in tables
    ]
    pairs = np.concatenate([part.reshape(-1, 2) for part in parts] or [np.zeros((0, 2), np.int64)])
    chosen = pairs[rows]
    if not chosen[:, 1].any():
        return np.ascontiguousarray(chosen[:, 0], np.int64)
    row = int(np.arange(len(pairs))[rows][np.argmax(chosen[:, 1])])
    for shard in (shard for table in tables for shard in table.shards):
        if row < len(shard):
            break
        row -= len(shard)
    value = shard.column(name)[row].as_py()
    found = "no value is stored" if value is None else f"the value is {value}"
    message = (
        f"{shard.path!r}, row {row}, field {name!r}: {found}; expected a whole number below 2**63; "
        "next: run `verify` on the data set, then generate or download it again"
    )
    raise IntegrityError(message)


def _ints(array: Any) -> NDArray[np.int64]:
    """Return each value of an Arrow array, and whether it is unusable; shape (rows, 2)."""
    unusable = array.is_null().to_numpy(zero_copy_only=False)
    # Filled first: numpy has no null, and would make all of the column floats, which round large ids.
    values = array.fill_null(0).to_numpy(zero_copy_only=False)
    if values.dtype.kind == "u":
        unusable = unusable | (values > _LARGEST)
    elif values.dtype.kind == "f":
        unusable = unusable | ~(np.abs(values) < float(_LARGEST))
        values = np.where(unusable, 0, values)
    return np.column_stack([values.astype(np.int64), unusable])


T = TypeVar("T")


class Row:
    """One stored row, its fields read on demand: ``group`` is the rows it belongs to, ``index`` its own."""

    __slots__ = ("group", "index")

    def __init__(self, group: RowGroup, index: int) -> None:
        self.group = group
        self.index = index

    def array(self, name: str) -> NDArray[Any]:
        """Return a field of shape (n, width) as a read-only view of the stored values."""
        return self.group.ragged(name)[self.index]

    def value(self, name: str) -> Any:
        """Return a plain field as numpy's scalar or Python's object."""
        return self.group.flat(name)[self.index]

    def has(self, name: str) -> bool:
        """Tell whether the data set has a column."""
        return name in self.group.names

    @property
    def path(self) -> str:
        """File that it is stored in."""
        return self.group.path

    @property
    def number(self) -> int:
        """Its row number in that file."""
        return self.group.first_row + self.index

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as a table of this one row, not as its whole row group."""
        import pyarrow as pa

        table = self.group.table.slice(self.index, 1)
        sink = pa.BufferOutputStream()
        with pa.ipc.new_stream(sink, table.schema) as writer:
            writer.write_table(table)
        return (_row_from_ipc, (sink.getvalue().to_pybytes(), self.path, self.number))


def _row_from_ipc(content: bytes, path: str, number: int) -> Row:
    import pyarrow as pa

    return Row(RowGroup(pa.ipc.open_stream(content).read_all(), path, number), 0)


class Record:
    """Base of typed records of one row: frozen, each field loaded on first use, picklable."""

    __slots__ = ("_loaded", "_row")
    _row: Row
    _loaded: dict[str, Any]

    def __init__(self, row: Row) -> None:
        object.__setattr__(self, "_row", row)
        object.__setattr__(self, "_loaded", {})

    def __setattr__(self, name: str, value: object) -> None:
        message = f"{type(self).__name__} is frozen; {name!r} cannot be set"
        raise AttributeError(message)

    def __reduce__(self) -> tuple[Any, ...]:
        return (type(self), (self._row,))

    def _once(self, name: str, load: Callable[[], T]) -> T:
        """Load a field on its first use and keep it."""
        loaded = self._loaded
        if name not in loaded:
            loaded[name] = load()
        value: T = loaded[name]
        return value


class RecordDataset(Sequence[T], Generic[T]):
    """A lazy sequence of records.

    Indexing with an int gives a record; with a slice, a list or array of ints, or a boolean mask gives a
    view that copies no data. ``a + b`` joins data sets of one kind. Opening reads no row; safe to share
    between threads, to fork and to pickle.

    Parameters
    ----------
    tables : sequence of ShardedTable
        Stored rows; their numbering is joined in this order.
    rows : sequence of int, optional
        Which rows of the joined numbering, in which order; all by default.
    label_names : sequence of str
        Name of each class.
    """

    record: ClassVar[Any] = Record

    def __init__(
        self,
        tables: Sequence[ShardedTable],
        rows: range | NDArray[np.int64] | None = None,
        label_names: Sequence[str] = (),
    ) -> None:
        self._tables = tuple(tables)
        self._starts = np.cumsum([0, *map(len, self._tables)])
        self._rows = range(int(self._starts[-1])) if rows is None else rows
        self._label_names = tuple(label_names)

    @property
    def label_names(self) -> tuple[str, ...]:
        """Name of each class, in order of the label."""
        return self._label_names

    @property
    def labels(self) -> NDArray[np.int64]:
        """Label of each row, shape (len,), int64; reads the label column only.

        Raises
        ------
        IntegrityError
            As :meth:`int_column`.
        """
        return self.int_column("label")

    @property
    def ids(self) -> NDArray[Any]:
        """Id of each row, shape (len,); reads the id column only."""
        return self.column("id")

    def column(self, name: str) -> NDArray[Any]:
        """Read one plain column, shape (len,), without touching any other.

        Raises
        ------
        InputError
            When the data set has no such column.
        """
        try:
            parts = [table.column(name) for table in self._tables]
        except (KeyError, IndexError) as error:
            message = f"no column {name!r} in this data set"
            raise InputError(message) from error
        joined = parts[0] if len(parts) == 1 else np.concatenate(parts) if parts else np.zeros(0)
        return joined[self._selection]

    def int_column(self, name: str) -> NDArray[np.int64]:
        """Read one column of whole numbers, shape (len,), int64, without touching any other.

        Raises
        ------
        InputError
            When the data set has no such column.
        IntegrityError
            A value is missing or does not fit into 64 bits; names file and row.
        """
        try:
            return _int_column(self._tables, name, self._selection)
        except KeyError as error:
            message = f"no column {name!r} in this data set"
            raise InputError(message) from error

    @property
    def _selection(self) -> slice | NDArray[np.int64]:
        rows = self._rows
        if isinstance(rows, np.ndarray):
            return rows
        return slice(rows.start, rows.stop if rows.stop >= 0 else None, rows.step)

    def filter_labels(self, labels: int | str | Iterable[int | str]) -> Self:
        """Return the rows of some classes, given as numbers or names.

        Raises
        ------
        InputError
            When a class is not one of :attr:`label_names`.
        """
        wanted = [labels] if isinstance(labels, (int, str, np.integer)) else list(labels)
        return self[np.isin(self.labels, [self._label_number(label) for label in wanted])]

    def by_label(self) -> dict[str, Self]:
        """Return one view per class, by class name."""
        labels = self.labels
        return {name: self[labels == number] for number, name in enumerate(self._label_names)}

    @classmethod
    def concatenate(cls, datasets: Iterable[Self]) -> Self:
        """Join data sets of one kind end to end; same as ``a + b + ...``.

        Raises
        ------
        InputError
            When there is nothing to join, or class names differ.
        """
        parts = list(datasets)
        if not parts:
            message = "nothing to concatenate; expected at least one data set"
            raise InputError(message)
        joined = parts[0]
        for part in parts[1:]:
            joined = joined + part
        return joined

    def __add__(self, other: Self) -> Self:
        if type(other) is not type(self):
            return NotImplemented
        if other._label_names != self._label_names:
            message = f"cannot join data sets with classes {self._label_names} and {other._label_names}"
            raise InputError(message)
        offset = int(self._starts[-1])
        rows = np.concatenate([np.asarray(self._rows, np.int64), np.asarray(other._rows, np.int64) + offset])
        return self._view((*self._tables, *other._tables), rows)

    def __len__(self) -> int:
        return len(self._rows)

    @overload
    def __getitem__(self, index: int) -> T: ...
    @overload
    def __getitem__(self, index: slice | Sequence[int] | Sequence[bool] | NDArray[Any]) -> Self: ...
    def __getitem__(self, index: Any) -> T | Self:
        """Return a record (int) or a view (slice, ints, boolean mask)."""
        if isinstance(index, slice):
            return self._view(self._tables, self._rows[index])
        if isinstance(index, (list, tuple, np.ndarray)) and np.ndim(index) > 0:
            return self._view(self._tables, np.asarray(self._rows, np.int64)[positions(index, len(self))])
        return self._record_at(operator.index(index))

    def __iter__(self) -> Iterator[T]:
        for position in range(len(self)):
            yield self._record_at(position)

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({len(self):,} rows, classes {', '.join(self._label_names) or 'unknown'})"
        )

    def _record_at(self, position: int) -> T:
        length = len(self._rows)
        if not -length <= position < length:
            message = f"index {position} is out of range for {length} rows"
            raise IndexError(message)
        row = int(self._rows[position])
        if len(self._tables) == 1:
            return self._make(Row(*self._tables[0].locate(row)))
        part = int(np.searchsorted(self._starts, row, side="right")) - 1
        return self._make(Row(*self._tables[part].locate(row - int(self._starts[part]))))

    def _make(self, row: Row) -> T:
        record: T = type(self).record(row)
        return record

    def _view(self, tables: Sequence[ShardedTable], rows: range | NDArray[np.int64]) -> Self:
        return type(self)(tables, rows, self._label_names)

    def _label_number(self, label: int | str) -> int:
        known = self._label_names
        if isinstance(label, str) and label in known:
            return known.index(label)
        if not isinstance(label, str) and 0 <= label < len(known):
            return int(label)
        message = f"no class {label!r}; expected a number below {len(known)} or one of {', '.join(known)}"
        raise InputError(message)
