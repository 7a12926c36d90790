"""Extension types seen as what they are stored as.

Which types Arrow knows depends on what a process has imported: arrays of several dimensions, as `datasets`
writes them, are an extension type where it was imported and lists of lists elsewhere. Here they are lists.
"""

from __future__ import annotations

from typing import Any

__all__ = ["plain_schema", "plain_table"]


def plain_schema(schema: Any) -> Any:
    """Return a schema whose extension types, at any depth, are those that they are stored as."""
    import pyarrow as pa

    if not _is_extended(schema):
        return schema
    fields = [pa.field(field.name, _plain_type(field.type), field.nullable) for field in schema]
    return pa.schema(fields, schema.metadata)


def plain_table(table: Any) -> Any:
    """Return a table whose columns have the types of :func:`plain_schema`; no value is copied."""
    import pyarrow as pa

    if not _is_extended(table.schema):
        return table
    schema = plain_schema(table.schema)
    columns = [
        pa.chunked_array([_plain_array(chunk) for chunk in column.chunks], field.type)
        for column, field in zip(table.columns, schema, strict=True)
    ]
    return pa.Table.from_arrays(columns, schema=schema)


def _is_extended(data_type: Any) -> bool:
    """Tell whether a type, or one inside a type or schema, is an extension type."""
    import pyarrow as pa

    if isinstance(data_type, pa.BaseExtensionType):
        return True
    if isinstance(data_type, pa.DataType):
        return any(_is_extended(data_type.field(index).type) for index in range(data_type.num_fields))
    return any(_is_extended(field.type) for field in data_type)


def _plain_array(array: Any) -> Any:
    import pyarrow as pa

    if isinstance(array, pa.ExtensionArray):
        return _plain_array(array.storage)
    return array.cast(_plain_type(array.type)) if _is_extended(array.type) else array


def _plain_type(data_type: Any) -> Any:
    import pyarrow as pa

    if isinstance(data_type, pa.BaseExtensionType):
        return _plain_type(data_type.storage_type)
    if not _is_extended(data_type):
        return data_type
    inner = [data_type.field(index) for index in range(data_type.num_fields)]
    plain = [pa.field(field.name, _plain_type(field.type), field.nullable) for field in inner]
    if pa.types.is_struct(data_type):
        return pa.struct(plain)
    if pa.types.is_fixed_size_list(data_type):
        return pa.list_(plain[0], data_type.list_size)
    if pa.types.is_large_list(data_type):
        return pa.large_list(plain[0])
    return pa.list_(plain[0]) if pa.types.is_list(data_type) else data_type
