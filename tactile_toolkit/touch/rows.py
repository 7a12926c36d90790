"""Rows of touches in the published schema: packed from arrays, taken apart by touch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from tactile_toolkit.read.columns import list_depth
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.touch.schema import MEDIA_TYPE, is_per_touch


def flat_row(row: Row) -> pa.Table:
    """Return a stored row as a table with structs ``a{b, c}`` as flat columns ``a.b``, ``a.c``."""
    table = row.group.table.slice(row.index, 1)
    # Unpacks one level of structs at a time.
    while any(pa.types.is_struct(field.type) for field in table.schema):
        table = table.flatten()
    return table


def number_lists(rows: Sequence[NDArray[Any]], data_type: pa.DataType) -> pa.Array:
    """Pack one array (T_i, width) or (T_i,) per row into an Arrow list column of the given type."""
    flat = np.concatenate([row.reshape(-1) for row in rows])
    depth, leaf = list_depth(data_type)
    inner = pa.array(flat.astype(leaf.to_pandas_dtype(), copy=False), leaf)
    if depth == 2:
        inner = pa.FixedSizeListArray.from_arrays(inner, data_type.value_type.list_size)
    return _outer_list(inner, [len(row) for row in rows], data_type)


def bytes_lists(
    rows: Sequence[Sequence[bytes | memoryview]], suffix: str, data_type: pa.DataType
) -> pa.Array:
    """Pack encoded images or clips into a list column of structs; their paths are ``TOUCH.suffix``."""
    blobs = pa.array([bytes(blob) for row in rows for blob in row], pa.binary())
    paths = pa.array([f"{touch:03d}.{suffix}" for row in rows for touch in range(len(row))], pa.string())
    inner = pa.StructArray.from_arrays([blobs, paths], fields=list(MEDIA_TYPE))
    return _outer_list(inner, [len(row) for row in rows], data_type)


def take_touches(table: pa.Table, touches: Sequence[int], count: int) -> pa.Table:
    """Return a flat table of one row of ``count`` touches with some of them only, in the order given."""
    chosen = pa.array(touches, pa.int64())
    columns = []
    for name in table.column_names:
        array = table.column(name).combine_chunks()
        # A column of another length does not say which of its entries belongs to which touch: it stays whole.
        if is_per_touch(name, array.type) and len(array.flatten()) == count:
            values = array.flatten().take(chosen)
            array = _outer_list(values, [len(touches)], pa.list_(array.type.value_type))
        columns.append(array)
    return pa.table(columns, names=table.column_names)


def _outer_list(inner: pa.Array, lengths: Sequence[int], data_type: pa.DataType) -> pa.Array:
    if pa.types.is_fixed_size_list(data_type):
        return pa.FixedSizeListArray.from_arrays(inner, type=data_type)
    offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)
    return pa.ListArray.from_arrays(pa.array(offsets), inner, type=data_type)
