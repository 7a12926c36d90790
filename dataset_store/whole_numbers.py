"""Columns of whole numbers, checked: a value that is missing or too large is named, not made into another."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dataset_store.errors import IntegrityError
from dataset_store.rowgroups import ShardedTable

__all__ = ["whole_numbers"]

_LARGEST = np.iinfo(np.int64).max


def whole_numbers(tables: Sequence[ShardedTable], name: str, rows: Any) -> NDArray[np.int64]:
    """Read one column of whole numbers, without touching any other.

    Parameters
    ----------
    tables : sequence of ShardedTable
        Stored rows; their numbering is joined in this order.
    name : str
        The column, by dotted name.
    rows : slice or ndarray of int
        Which rows of the joined numbering; what others hold does not matter.

    Returns
    -------
    ndarray of int64, shape (number of rows,)

    Raises
    ------
    KeyError
        There is no such column.
    IntegrityError
        A value is missing or does not fit into 64 bits; names file and row.
    """
    key = f"whole numbers of {name}"
    parts = [table.per_shard(key, lambda shard: [_of_shard(shard.column(name))]) for table in tables]
    pairs = np.concatenate([part.reshape(-1, 2) for part in parts] or [np.zeros((0, 2), np.int64)])
    chosen = pairs[rows]
    for place in np.flatnonzero(chosen[:, 1])[:1].tolist():
        raise _unusable(tables, name, int(np.arange(len(pairs))[rows][place]))
    values: NDArray[np.int64] = chosen[:, 0].astype(np.int64)
    return values


def _of_shard(array: Any) -> NDArray[np.int64]:
    """Return each value of a column, and whether it is none; shape (rows, 2)."""
    unusable = array.is_null().to_numpy(zero_copy_only=False)
    # Filled first: numpy has no null, and would make all of the column floats, which round large ids.
    values = array.fill_null(0).to_numpy(zero_copy_only=False)
    if values.dtype.kind == "u":
        unusable = unusable | (values > _LARGEST)
    elif values.dtype.kind == "f":
        unusable = unusable | ~(np.abs(values) < float(_LARGEST))
        values = np.where(unusable, 0, values)
    return np.column_stack([values.astype(np.int64), unusable])


def _unusable(tables: Sequence[ShardedTable], name: str, row: int) -> IntegrityError:
    for shard in (shard for table in tables for shard in table.shards):
        if row < len(shard):
            value = shard.column(name)[row].as_py()
            found = "no value is stored" if value is None else f"the value is {value}"
            return IntegrityError(
                f"{shard.path!r}, row {row}, field {name!r}: {found}; expected a whole number below 2**63; "
                "next: run `verify` on the data set, then generate or download it again"
            )
        row -= len(shard)
    message = f"no row {row} in {len(tables)} tables"
    raise IndexError(message)
