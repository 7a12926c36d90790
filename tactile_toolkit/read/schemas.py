"""Columns of Arrow schemas by dotted name, their nesting, and checks of their types."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import pyarrow as pa

Expected = tuple[int, tuple[Callable[[pa.DataType], bool], ...], str]
"""Required type of a column: depth of nesting, tests of the innermost type (one must hold), description."""


def list_depth(data_type: pa.DataType) -> tuple[int, pa.DataType]:
    """Return the number of nested lists in an Arrow type, and the innermost type."""
    depth = 0
    while isinstance(data_type, (pa.ListType, pa.FixedSizeListType)):
        depth, data_type = depth + 1, data_type.value_type
    return depth, data_type


def column_types(fields: Iterable[pa.Field], prefix: str = "") -> dict[str, pa.DataType]:
    """Return the Arrow type of each column of a schema by dotted name; structs precede their fields.

    Struct ``a<b, c>`` and flat columns ``a.b``, ``a.c`` have the same names.
    """
    types = {}
    for each in fields:
        name = prefix + each.name
        types[name] = each.type
        if pa.types.is_struct(each.type):
            types |= column_types(each.type, f"{name}.")
    return types


def column_names(schema: pa.Schema) -> tuple[str, ...]:
    """List columns by dotted name, at any depth, with the fields of structs."""
    types = column_types(schema).items()
    return tuple([name for name, data_type in types if not pa.types.is_struct(data_type)])


def wrong_type(types: Mapping[str, pa.DataType], expected: Mapping[str, Expected]) -> str:
    """Describe the first existing column with an unreadable type; empty if there is none."""
    for name in filter(types.__contains__, expected):
        depth, tests, words = expected[name]
        found_depth, leaf = list_depth(types[name])
        if pa.types.is_struct(leaf) and leaf.get_field_index("bytes") >= 0:
            leaf = leaf.field("bytes").type
        if found_depth != depth or not any(test(leaf) for test in tests):
            return f"field {name!r}: the column has the type {types[name]}; expected {words}"
    return ""
