"""Rows of data sets, each column declared in one line.

From a class of rows follow the Arrow schema and the table of a shard, and the tables of fields in cards and
documentation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from itertools import chain
from typing import Any, TypeVar, dataclass_transform

import numpy as np
import pyarrow as pa

from tactile_toolkit import read

T = TypeVar("T")
_COLUMN = "column"


@dataclass(frozen=True, slots=True)
class _Declared:
    data_type: Any
    unit: str
    meaning: str
    name: str | None


def column(data_type: Any, unit: str = "", meaning: str = "", *, name: str | None = None) -> Any:
    """Declare a column: its Arrow type, its shape, unit and frame, and its meaning.

    ``name`` is that of the stored column where the attribute cannot be called so (``mesh.vertices``).
    """
    return field(metadata={_COLUMN: _Declared(data_type, unit, meaning, name)})


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(column, field))
def row(declared: type[T]) -> type[T]:
    """Make a class whose attributes are columns: a frozen dataclass with slots."""
    return dataclass(frozen=True, slots=True, eq=False)(declared)


def _columns(row_type: Any) -> list[tuple[str, str, _Declared]]:
    """List attribute, name and declaration of each column; other attributes are not stored in shards."""
    found = [(each.name, each.metadata.get(_COLUMN)) for each in fields(row_type)]
    return [(attribute, each.name or attribute, each) for attribute, each in found if each is not None]


def meanings(row_type: type) -> dict[str, tuple[str, str]]:
    """Return shape, unit and frame of each column, and its meaning, by name."""
    return {name: (declared.unit, declared.meaning) for _, name, declared in _columns(row_type)}


def plain_schema(row_type: type) -> pa.Schema:
    """Return the Arrow schema of such rows, without metadata."""
    return pa.schema([(name, declared.data_type) for _, name, declared in _columns(row_type)])


def table_of(rows: Sequence[Any], schema: pa.Schema) -> pa.Table:
    """Pack rows of one class into a table; ``schema`` has their columns and any metadata."""
    if not rows:
        return schema.empty_table()
    attributes = [attribute for attribute, _, _ in _columns(type(rows[0]))]
    arrays = [
        _array([getattr(each, attribute) for each in rows], data_type)
        for attribute, data_type in zip(attributes, schema.types, strict=True)
    ]
    return pa.Table.from_arrays(arrays, schema=schema)


def _array(values: list[Any], data_type: pa.DataType) -> pa.Array:
    """Pack the values of a column: arrays of shape (n, w) as lists of vectors, tuples as lists of structs."""
    inner = data_type.value_type if pa.types.is_list(data_type) else None
    if inner is not None and pa.types.is_fixed_size_list(inner):
        return read.ragged_array(
            read.RaggedColumn(np.concatenate(values), _offsets(values)), inner.value_type
        )
    if inner is not None and pa.types.is_struct(inner):
        # Much faster than from a dict for each struct.
        parts = list(zip(*chain.from_iterable(values), strict=True))
        arrays = [
            pa.array(part, each.type) for part, each in zip(parts or [()] * len(inner), inner, strict=True)
        ]
        structs = pa.StructArray.from_arrays(arrays, fields=list(inner))
        return pa.ListArray.from_arrays(pa.array(_offsets(values), pa.int32()), structs, type=data_type)
    return pa.array(values, data_type)


def _offsets(values: list[Any]) -> Any:
    return np.cumsum([0, *map(len, values)])
