"""The stored rows of a data set, and their columns as arrays and tables."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from tactile_toolkit.array_types import AnyArray, Int64
from tactile_toolkit.errors import InputError
from tactile_toolkit.read import integer_columns, schemas, shard, sharded_table, source
from tactile_toolkit.read.order import StoredParts
from tactile_toolkit.read.record import Row

if TYPE_CHECKING:
    import pandas as pd
    from datasets import Dataset


class RowColumns:
    """Numbers of stored rows, and the columns of these rows.

    Parameters
    ----------
    table : ShardedTable
        Stored rows.
    rows : sequence of int, optional
        Numbers of the rows, in order; all by default.
    label_names : sequence of str
        Name of each class.
    """

    def __init__(
        self,
        table: sharded_table.ShardedTable,
        rows: range | Int64 | None = None,
        label_names: Sequence[str] = (),
    ) -> None:
        self.table = table
        self._rows = range(len(table)) if rows is None else rows
        self._label_names = tuple(label_names)

    @property
    def label_names(self) -> tuple[str, ...]:
        """Name of each class, in order of the label."""
        return self._label_names

    @property
    def ids(self) -> AnyArray:
        """Id of each row, shape (len,); reads the id column only."""
        values = self.column("id")
        are_whole = values.dtype.kind == "f" and integer_columns.whole_numbers(values).all()
        if are_whole:
            values = values.astype(np.int64)
        return values

    @property
    def object_ids(self) -> AnyArray:
        """Id of the object of each row, shape (len,), by which users choose; usually that of the row."""
        return self.ids

    @property
    def column_names(self) -> tuple[str, ...]:
        """Stored columns that all rows have; fields of structs have dotted names: ``info.gel_id``."""
        return tuple(self._types)

    @property
    def _types(self) -> dict[str, pa.DataType]:
        """Arrow type of each column that joined sets share, by dotted name, without structs."""
        found, *others = [schemas.column_types(schema) for schema in self.table.schemas] or [{}]
        return {
            name: each
            for name, each in found.items()
            if not pa.types.is_struct(each) and all(other.get(name) == each for other in others)
        }

    def _stores(self, name: str) -> list[bool]:
        return [name in schemas.column_types(schema) for schema in self.table.schemas]

    def has_column(self, name: str) -> bool:
        """Return whether all rows have a stored column, by dotted name."""
        return all(self._stores(name))

    @property
    def plain_columns(self) -> tuple[str, ...]:
        """Names of the columns of numbers and texts."""
        large = (pa.types.is_nested, pa.types.is_binary)
        return tuple(name for name, each in self._types.items() if not any(test(each) for test in large))

    def to_hf(self) -> Dataset:
        """Return the rows as a data set of the library `datasets`, with their features.

        Nothing is copied if the cache can be written: the result views unpacked rows, and only row groups
        with rows of this data set are unpacked. When pickled, as for spawned workers, it contains its rows,
        unlike this class, which pickles their addresses.

        Returns
        -------
        datasets.Dataset
            The same rows in the same order, with their common columns.

        Raises
        ------
        IntegrityError
            A file is damaged.
        """
        # `datasets` takes seconds to import.
        from datasets import Dataset

        rows = [self._row_at(int(number)) for number in self._rows]
        blocks = {(row.path, row.group.first_row): row.group.table for row in rows}
        starts = dict(zip(blocks, np.cumsum([0, *map(len, blocks.values())]).tolist(), strict=False))
        places = [starts[row.path, row.group.first_row] + row.index for row in rows]
        parts = list(blocks.values()) or [schema.empty_table() for schema in self.table.schemas[:1]]
        if not parts:
            return Dataset.from_dict({})
        shared = set.intersection(*({(each.name, each.type) for each in part.schema} for part in parts))
        names = [each.name for each in parts[0].schema if (each.name, each.type) in shared]
        table = pa.concat_tables([part.select(names) for part in parts])
        # Its default fingerprint would hash all bytes.
        content = repr([names, list(starts), self.identity])
        stored = Dataset(table, fingerprint=hashlib.sha256(content.encode()).hexdigest()[:16])
        if places != list(range(len(table))):
            stored = stored.select(places)
        return stored

    def column(self, name: str) -> AnyArray:
        """Read one plain column, shape (len,), and no other.

        Raises
        ------
        InputError
            When the data set has no such column.
        """
        try:
            values = self.table.column(name)
        except KeyError as error:
            raise InputError(f"no column {name!r} in this data set") from error
        rows = self._rows
        if isinstance(rows, range):
            # A range down to row 0 stops at -1, which a slice takes for the last row.
            return values[rows.start : rows.stop if rows.stop >= 0 else None : rows.step]
        return values[rows]

    def int_column(self, name: str) -> Int64:
        """Read one column of integers, shape (len,), int64, and no other.

        Raises
        ------
        InputError
            When the data set has no such column.
        IntegrityError
            A value is missing, not an integer, or does not fit into 64 bits; names file and row.
        """
        values = self.column(name)
        usable = integer_columns.whole_numbers(values)
        if usable.all():
            return np.ascontiguousarray(values, np.int64)
        # A missing value in any row makes large ones inexact, so they are read from the row itself.
        found = np.where(usable, values, 0).astype(np.int64)
        for position in np.flatnonzero(~usable).tolist():
            found[position] = self._row_at(int(self._rows[position])).integer(name)
        return found

    @property
    def identity(self) -> str:
        """Text that identifies the stored rows, which changes when files are replaced."""
        return self.table.identity

    @property
    def files(self) -> tuple[shard.Shard, ...]:
        """The Parquet files that the data set was opened from, whichever rows of them it holds."""
        return self.table.files

    @property
    def labels(self) -> Int64:
        """Label of each item, shape (len,), int64; reads the label column only.

        Raises
        ------
        IntegrityError
            A label is missing, not an integer, or does not fit into 64 bits.
        """
        return self.int_column("label")

    @property
    def splits(self) -> tuple[str, ...]:
        """Splits of the rows, by the names of their files."""
        return tuple(dict.fromkeys(split for _, split in self.table.origins if split))

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def row_numbers(self) -> Int64:
        """Number of each item among all rows of the files, shape (len,)."""
        return np.asarray(self._rows, np.int64)

    def to_pandas(self) -> pd.DataFrame:
        """Return the plain columns as a table with one row for each item.

        Meshes, images and other lists are left out; ``to_hf().to_pandas()`` includes them.

        Returns
        -------
        pandas.DataFrame
        """
        # pandas takes half a second to import.
        import pandas as pd

        return pd.DataFrame({name: self.column(name) for name in self.plain_columns})

    def _row_at(self, number: int) -> Row:
        """Return a stored row by number."""
        return Row(*self.table.locate(number))

    def stored_parts(self) -> StoredParts:
        """Return which rows are stored together, in files and row groups."""
        rows, starts = self._rows, self.table.part_starts
        if isinstance(rows, range) and rows.step == 1:
            return StoredParts(np.unique(np.clip(starts, rows.start, rows.stop) - rows.start))
        order = np.argsort(self.row_numbers, kind="stable")
        return StoredParts(np.unique(np.searchsorted(self.row_numbers[order], starts)), order)

    def row_groups(self, chosen: Int64) -> list[tuple[source.RowSource, int]]:
        """Return the row groups of rows at positions (n,), each once: a source, and a number in it."""
        rows = self._rows
        numbers = np.unique(rows.start + rows.step * chosen if isinstance(rows, range) else rows[chosen])
        return self.table.row_groups(numbers)
