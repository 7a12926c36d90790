"""Rows in which a value is missing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["null_fields"]


def null_fields(table: Any, names: Sequence[str]) -> dict[int, str]:
    """Find the rows of a table in which a column holds a null, at any depth.

    Parameters
    ----------
    table : pyarrow.Table
        Rows, one chunk per column.
    names : sequence of str
        Columns to look through, by dotted name; those that are absent are passed over.

    Returns
    -------
    dict of int to str
        Number of each such row, and the first field in which the null lies: ``"placements.shape"``.
    """
    from dataset_store.rowgroup import RowGroup

    group = RowGroup(table)
    found: dict[int, str] = {}
    for name in names:
        if name not in group.names:
            continue
        for field, rows in _nulls(group.arrow(name), name):
            for row in np.flatnonzero(rows).tolist():
                found.setdefault(row, field)
    return found


def _nulls(array: Any, name: str) -> list[tuple[str, NDArray[np.bool_]]]:
    """Return fields with the rows in which they are null; fields without any are left out."""
    import pyarrow as pa
    import pyarrow.compute as pc

    found = [(name, array.is_null().to_numpy(zero_copy_only=False))] if array.null_count else []
    if pa.types.is_struct(array.type):
        for place, child in enumerate(array.flatten()):
            part = f"{name}.{array.type.field(place).name}"
            found += _nulls(child, part)
    elif isinstance(array.type, (pa.ListType, pa.LargeListType, pa.FixedSizeListType)):
        inner = _nulls(array.flatten(), name)
        parents = pc.list_parent_indices(array).to_numpy(zero_copy_only=False) if inner else np.zeros(0, int)
        for field, entries in inner:
            rows = np.zeros(len(array), dtype=bool)
            rows[parents[entries]] = True
            found.append((field, rows))
    return found
