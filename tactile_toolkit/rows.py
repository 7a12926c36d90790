"""Rows of data sets, each column declared once.

The Arrow schema and table of a shard, the tables of fields in cards and documentation, the filters and
measures of a gallery, and the figures of a split in cards and commands follow from a class of rows.
"""

from __future__ import annotations

from collections.abc import Sequence, Sized
from dataclasses import MISSING, dataclass, field, fields, replace
from itertools import chain
from typing import Literal, TypeAlias, dataclass_transform

import numpy as np
import pyarrow as pa

from tactile_toolkit import checked_fields, read
from tactile_toolkit.read import record
from tactile_toolkit.value_types import Int64, JsonValue

Role: TypeAlias = Literal["plain", "facet", "measure", "hidden"]

_COLUMN = "column"


@dataclass(frozen=True, slots=True)
class Column:
    """Facts of a column.

    Attributes
    ----------
    data_type : pyarrow.DataType
        Type in files.
    unit : str
        Shape, unit and frame.
    meaning : str
        Meaning of its values, a phrase.
    name : str
        Name of the stored column; that of the attribute by default.
    role : str
        Use of the column. Objects are filtered and counted by the values of a ``"facet"``, which may be
        lists. A ``"measure"`` is a number of each object, with minimum, median and maximum of a split. A
        ``"hidden"`` column is not stored.
    title : str
        Heading in tables and galleries.
    decimals : int
        Number of decimals shown.
    values : tuple of str
        Values of a facet in the order of display; others follow.
    """

    data_type: pa.DataType
    unit: str = ""
    meaning: str = ""
    name: str = ""
    role: Role = "plain"
    title: str = ""
    decimals: int = 0
    values: tuple[str, ...] = ()


def column(
    data_type: pa.DataType,
    unit: str = "",
    meaning: str = "",
    *,
    default: object = MISSING,
    **facts: JsonValue,
) -> checked_fields.Declared:
    """Declare an attribute of a row as a column; ``facts`` are further attributes of :class:`Column`.

    ``name`` is for columns whose name is not an identifier (``mesh.vertices``).
    """
    return field(default=default, metadata={_COLUMN: Column(data_type, unit, meaning, **facts)})


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(column, field))
class TypedRow:
    """Base class of rows, frozen dataclasses whose attributes are columns; facts follow from these."""

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True, eq=False)(cls)

    @classmethod
    def columns(cls) -> dict[str, Column]:
        """Return the columns by attribute, each with its name."""
        declared = {column.name: column.metadata.get(_COLUMN) for column in fields(cls)}  # type: ignore[arg-type]
        return {
            attribute: replace(column, name=column.name or attribute)
            for attribute, column in declared.items()
            if column is not None
        }

    @classmethod
    def with_role(cls, *roles: Role) -> tuple[Column, ...]:
        """Return the columns that have one of some roles."""
        return tuple(column for column in cls.columns().values() if column.role in roles)

    @classmethod
    def meanings(cls) -> dict[str, tuple[str, str]]:
        """Return shape, unit and frame of each column, and its meaning, by name."""
        return {column.name: (column.unit, column.meaning) for column in cls.columns().values()}

    @classmethod
    def plain_schema(cls) -> pa.Schema:
        """Return the Arrow schema, without metadata."""
        return pa.schema(
            [(column.name, column.data_type) for column in cls.columns().values() if column.role != "hidden"]
        )

    @classmethod
    def table(cls, rows: Sequence[TypedRow], schema: pa.Schema | None = None) -> pa.Table:
        """Pack rows into a table of the columns that ``schema`` has, all stored ones by default."""
        schema = schema or cls.plain_schema()
        if not rows:
            return schema.empty_table()
        attributes = {entry.name: attribute for attribute, entry in cls.columns().items()}
        arrays = [
            _array([getattr(entry, attributes[field.name]) for entry in rows], field.type) for field in schema
        ]
        return pa.Table.from_arrays(arrays, schema=schema)


def _array(values: list[JsonValue], data_type: pa.DataType) -> pa.Array:
    """Pack the values of a column: arrays of shape (n, w) as lists of vectors, tuples as lists of structs."""
    inner = data_type.value_type if pa.types.is_list(data_type) else None
    if inner is not None and pa.types.is_fixed_size_list(inner):
        vectors = read.RaggedColumn(np.concatenate(values), _offsets(values))
        return record.ragged_array(vectors, inner.value_type)
    if inner is not None and pa.types.is_struct(inner):
        # Much faster than a dict for each struct.
        parts = list(zip(*chain.from_iterable(values), strict=True))
        arrays = [
            pa.array(part, child.type) for part, child in zip(parts or [()] * len(inner), inner, strict=True)
        ]
        structs = pa.StructArray.from_arrays(arrays, fields=list(inner))
        return pa.ListArray.from_arrays(pa.array(_offsets(values), pa.int32()), structs, type=data_type)
    return pa.array(values, data_type)


def _offsets(values: list[Sized]) -> Int64:
    return np.cumsum([0, *map(len, values)])
