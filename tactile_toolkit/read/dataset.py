"""Record data sets: lazy sequences of typed records over stored rows."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.read.columns import RowGroup, column_types, table_bytes
from tactile_toolkit.read.order import StoredParts
from tactile_toolkit.read.parquet import Shard, ShardedTable
from tactile_toolkit.read.sequence import LazySequence
from tactile_toolkit.wording import counted

T = TypeVar("T")


class Row:
    """One stored row, its fields read on demand: ``group`` is the rows it belongs to, ``index`` its own."""

    __slots__ = ("group", "index")

    def __init__(self, group: RowGroup, index: int) -> None:
        self.group = group
        self.index = index

    def array(self, name: str) -> NDArray[Any]:
        """Return a field of shape (n, width) as a read-only view of the stored values."""
        try:
            return self.group.ragged(name)[self.index]
        except IntegrityError:  # of another row, maybe: this one alone
            alone = self.group.table.slice(self.index, 1)
            return RowGroup(alone, self.path, self.number).ragged(name)[0]

    def value(self, name: str) -> Any:
        """Return a plain field as numpy's scalar or Python's object."""
        return self.group.flat(name)[self.index]

    def required(self, name: str) -> Any:
        """Return a plain field as :meth:`value` does; IntegrityError where it is null."""
        value = self.value(name)
        # Of a column with nulls, numpy makes NaN of those of numbers.
        missing = value is None or (isinstance(value, (float, np.floating)) and value != value)
        if missing and not self.group.arrow(name)[self.index].is_valid:
            raise self.group.damaged(name, self.index, "no value is stored")
        return value

    def has(self, name: str) -> bool:
        """Return whether the data set has a column."""
        return name in self.group.names

    @property
    def path(self) -> str:
        """File that it is stored in."""
        return self.group.path

    @property
    def number(self) -> int:
        """Its row number in that file."""
        return self.group.first_row + self.index

    def equals(self, other: Row) -> bool:
        """Return whether two rows have the same columns and values, wherever they are stored."""
        import pyarrow as pa

        one, another = (
            pa.table({name: row.group.arrow(name).slice(row.index, 1) for name in sorted(row.group.names)})
            for row in (self, other)
        )
        if one.schema != another.schema:
            return False
        # To Arrow a NaN equals nothing; written it equals itself.
        return bool(one.equals(another)) or repr(one.to_pydict()) == repr(another.to_pydict())

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as a table of this one row, not as its entire row group."""
        content = table_bytes(self.group.table.slice(self.index, 1)).to_pybytes()
        return _row_from_ipc, (content, self.path, self.number)


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
        raise AttributeError(f"{type(self).__name__} is frozen; {name!r} cannot be set")

    def __reduce__(self) -> tuple[Any, ...]:
        return (type(self), (self._row,))

    def __eq__(self, other: object) -> bool:
        """Return whether the other is a record of the same kind with the same stored values."""
        if not isinstance(other, Record) or type(other) is not type(self):
            return NotImplemented
        return self._row.equals(other._row)

    def __hash__(self) -> int:
        # Of this row alone: a neighbour's damage must not make a record differ from its pickled copy.
        try:
            number = self._row.group.arrow("id")[self._row.index].as_py()
        except (KeyError, ValueError):
            number = None
        return hash((type(self), number))

    def _tile_html(self) -> str:
        """Return what a notebook shows of the record among others: a small picture, where there is any."""
        return ""

    def _once(self, name: str, load: Callable[[], T]) -> T:
        """Load a field on its first use and keep it."""
        loaded = self._loaded
        if name not in loaded:
            loaded[name] = load()
        value: T = loaded[name]
        return value


class RecordDataset(LazySequence[T]):
    """A lazy sequence of records.

    Indexing with an int gives a record; with a slice, a list or array of ints, or a boolean mask gives a
    view that copies no data. ``a + b`` joins data sets of one kind. Opening reads no row; safe to share
    between threads, to fork and to pickle. Data sets are equal that hold equal records in the same order.

    Parameters
    ----------
    table : ShardedTable
        Stored rows.
    rows : sequence of int, optional
        Which of them, in which order; all by default.
    label_names : sequence of str
        Name of each class.
    """

    record_class: ClassVar[Any] = Record

    def __init__(
        self,
        table: ShardedTable,
        rows: range | NDArray[np.int64] | None = None,
        label_names: Sequence[str] = (),
    ) -> None:
        self._table = table
        self._rows = range(len(table)) if rows is None else rows
        self._label_names = tuple(label_names)

    @property
    def label_names(self) -> tuple[str, ...]:
        """Name of each class, in order of the label."""
        return self._label_names

    @property
    def ids(self) -> NDArray[Any]:
        """Id of each row, shape (len,); reads the id column only."""
        return self.column("id")

    @property
    def column_names(self) -> tuple[str, ...]:
        """Columns that all rows have, as they are stored; a struct goes by its fields: ``info.gel_id``."""
        return tuple(self._types)

    @property
    def _types(self) -> dict[str, Any]:
        """Arrow type of each column that joined sets store alike, by dotted name; structs are left out."""
        import pyarrow as pa

        found, *others = [column_types(schema) for schema in self._table.schemas] or [{}]
        return {
            name: each
            for name, each in found.items()
            if not pa.types.is_struct(each) and all(other.get(name) == each for other in others)
        }

    @property
    def _plain_columns(self) -> tuple[str, ...]:
        import pyarrow as pa

        large = (pa.types.is_nested, pa.types.is_binary, pa.types.is_large_binary)
        return tuple(name for name, each in self._types.items() if not any(test(each) for test in large))

    def to_hf(self) -> Any:
        """Return the rows as a data set of the library `datasets`, with their features.

        Nothing is copied where the cache can be written: it views the rows where they lie unpacked, and only
        row groups that hold some of these rows are unpacked. (Pickled, as for workers that are spawned, it
        takes its rows along; ours takes their addresses.)

        Returns
        -------
        datasets.Dataset
            The same rows in the same order, with the columns that all of them have.

        Raises
        ------
        IntegrityError
            A file is damaged.
        """
        import pyarrow as pa
        from datasets import Dataset

        rows = [self._row(int(number)) for number in self._rows]
        blocks = {(row.path, row.group.first_row): row.group.table for row in rows}
        starts = dict(zip(blocks, np.cumsum([0, *map(len, blocks.values())]).tolist(), strict=False))
        places = [starts[row.path, row.group.first_row] + row.index for row in rows]
        parts = list(blocks.values()) or [schema.empty_table() for schema in self._table.schemas[:1]]
        if not parts:
            return Dataset.from_dict({})
        shared = set.intersection(*({(each.name, each.type) for each in part.schema} for part in parts))
        names = [each.name for each in parts[0].schema if (each.name, each.type) in shared]
        table = pa.concat_tables([part.select(names) for part in parts])
        # Its own fingerprint would be that of all bytes.
        content = repr([names, list(starts), self.identity])
        stored = Dataset(table, fingerprint=hashlib.sha256(content.encode()).hexdigest()[:16])
        return stored if places == list(range(len(table))) else stored.select(places)

    def column(self, name: str) -> NDArray[Any]:
        """Read one plain column, shape (len,), without touching any other.

        Raises
        ------
        InputError
            When the data set has no such column.
        """
        try:
            values = self._table.column(name)
        except KeyError as error:
            raise InputError(f"no column {name!r} in this data set") from error
        rows = self._rows
        if isinstance(rows, range):
            # One that runs down to row 0 stops at -1, which to a slice is the last row.
            return values[rows.start : rows.stop if rows.stop >= 0 else None : rows.step]
        return values[rows]

    def int_column(self, name: str) -> NDArray[np.int64]:
        """Read one column of integers, shape (len,), int64, without touching any other.

        Raises
        ------
        InputError
            When the data set has no such column.
        IntegrityError
            A value is missing or does not fit into 64 bits; names file and row.
        """
        values = self.column(name)
        # With a missing value in any row, chosen or not, all are floats; no comparison holds for NaN.
        kind = values.dtype.kind
        bits = 53 if kind == "f" else 63
        usable = np.abs(values) < 2**bits if kind in "uf" else np.full(len(values), kind in "bi")
        if not usable.all():
            row = self._row(int(self._rows[int(np.argmin(usable))]))
            value = row.group.arrow(name)[row.index].as_py()
            found = "no value is stored" if value is None else f"the value is {value}"
            expected = f"expected an integer below 2**{bits}"
            raise IntegrityError.in_file(row.path, f", row {row.number}, field {name!r}: {found}; {expected}")
        return np.ascontiguousarray(values, np.int64)

    @property
    def identity(self) -> str:
        """What distinguishes the stored rows that this is a view of from all others, later ones there too."""
        return self._table.identity

    def _row(self, number: int) -> Row:
        """Return a row by its number among those that are stored."""
        return Row(*self._table.locate(number))

    def _stored(self, row: int) -> T:
        record: T = self.record_class(self._row(row))
        return record

    def _concat(self, other: Self) -> Self:
        joined = self._view(np.concatenate([self._row_numbers, other._row_numbers + len(self._table)]))
        joined._table = ShardedTable((*self._table.shards, *other._table.shards))
        return joined

    def _stored_parts(self) -> StoredParts:
        rows, starts = self._rows, self._table.part_starts
        if isinstance(rows, range) and rows.step == 1:
            return StoredParts(np.unique(np.clip(starts, rows.start, rows.stop) - rows.start))
        order = np.argsort(self._row_numbers, kind="stable")
        return StoredParts(np.unique(np.searchsorted(self._row_numbers[order], starts)), order)

    def _row_groups(self, chosen: NDArray[np.int64]) -> list[tuple[Shard, int]]:
        rows = self._rows
        numbers = np.unique(rows.start + rows.step * chosen if isinstance(rows, range) else rows[chosen])
        return self._table.row_groups(numbers)

    def _description(self) -> list[str]:
        return with_origins(counted(len(self), self.things), self._table)

    @property
    def splits(self) -> tuple[str, ...]:
        """Splits that the rows are of, by the names of their files."""
        return tuple(dict.fromkeys(split for _, split in self._table.origins if split))


def with_origins(things: str, table: ShardedTable) -> list[str]:
    """Say of what data sets and splits some things are, such as ``20 rows``."""
    origins = table.origins
    names = dict.fromkeys(name for name, _ in origins)
    splits = dict.fromkeys(f"split {split}" for _, split in origins if split)
    return [f"{things} of {' and '.join(names)}" if names else things, *splits]
