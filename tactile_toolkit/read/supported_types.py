"""Conversion of Arrow types of other writers to those that the toolkit reads."""

from __future__ import annotations

import pyarrow as pa


def supported_type(data_type: pa.DataType) -> pa.DataType:
    """Return the supported type for the same values: no dictionary, view, 64-bit offset or half float."""
    kinds = pa.types
    if kinds.is_dictionary(data_type):
        return supported_type(data_type.value_type)
    if kinds.is_string_view(data_type) or kinds.is_large_string(data_type):
        return pa.string()
    if kinds.is_binary_view(data_type) or kinds.is_large_binary(data_type):
        return pa.binary()
    if kinds.is_float16(data_type):
        return pa.float32()
    if kinds.is_struct(data_type):
        return pa.struct([each.with_type(supported_type(each.type)) for each in data_type])
    if kinds.is_map(data_type):
        return pa.map_(supported_type(data_type.key_type), supported_type(data_type.item_type))
    lists = (pa.ListType, pa.LargeListType, pa.ListViewType, pa.LargeListViewType, pa.FixedSizeListType)
    if not isinstance(data_type, lists):
        return data_type
    element = data_type.value_field.with_type(supported_type(data_type.value_type))
    return pa.list_(element, getattr(data_type, "list_size", -1))


def supported_schema(schema: pa.Schema) -> pa.Schema:
    """Return a schema with :func:`supported_type` of each column; unchanged if all are supported."""
    types = list(map(supported_type, schema.types))
    if types == schema.types:
        return schema
    # Metadata of a changed field, such as its categories, are no longer valid.
    fields = [
        each if each.type == data_type else pa.field(each.name, data_type, each.nullable)
        for each, data_type in zip(schema, types, strict=True)
    ]
    return pa.schema(fields, schema.metadata)


def supported_table(table: pa.Table) -> pa.Table:
    """Return a table with the types of :func:`supported_schema`; the same table where it has them."""
    schema = supported_schema(table.schema)
    if schema is table.schema or schema.types == table.schema.types:
        return table
    columns = [_converted(*each) for each in zip(table.columns, schema.types, strict=True)]
    return pa.table(columns, schema=schema)


def _converted(column: pa.ChunkedArray, data_type: pa.DataType) -> pa.ChunkedArray:
    if "list_view" not in str(column.type):
        return column.cast(data_type)
    # pyarrow 26 casts list views with nulls incorrectly.
    return pa.chunked_array([pa.array(chunk.to_pylist(), data_type) for chunk in column.chunks], data_type)
