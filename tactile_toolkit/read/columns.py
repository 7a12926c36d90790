"""Arrow columns seen as numpy arrays, without passing through Python lists."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.errors import IntegrityError

__all__ = [
    "RaggedColumn",
    "RowGroup",
    "column_names",
    "list_array",
    "null_fields",
    "plain_schema",
    "plain_table",
    "ragged_column",
    "stored_class_names",
]


@dataclass(frozen=True, slots=True, eq=False)
class RaggedColumn:
    """A column of arrays of different lengths, as one flat array and the places where rows begin.

    Attributes
    ----------
    values : ndarray, shape (sum of row lengths, width)
        All rows one after another; a view of Arrow's memory.
    offsets : ndarray of int, shape (rows + 1,)
        Row i is ``values[offsets[i]:offsets[i + 1]]``.
    """

    values: NDArray[Any]
    offsets: NDArray[Any]

    def __len__(self) -> int:
        return len(self.offsets) - 1

    def __getitem__(self, row: int) -> NDArray[Any]:
        """Return the array of one row, shape (n, width), without a copy."""
        return self.values[self.offsets[row] : self.offsets[row + 1]]


def ragged_column(array: Any) -> RaggedColumn:
    """View an Arrow list column of fixed-width vectors as numpy.

    Parameters
    ----------
    array : pyarrow.Array
        ``list<fixed_size_list<T>[w]>`` or ``list<list<T>>`` whose inner lists all have one width, 32-bit or
        64-bit offsets, no nulls.

    Returns
    -------
    RaggedColumn

    Raises
    ------
    ValueError
        When the array holds nulls, or inner lists of several widths.
    """
    _refuse_nulls(array)
    offsets = array.offsets.to_numpy(zero_copy_only=True)
    inner = array.values
    first, last = (int(offsets[0]), int(offsets[-1])) if len(offsets) else (0, 0)
    values, width = _flat_vectors(inner.slice(first, last - first))
    return RaggedColumn(values.reshape(-1, width), offsets - first if first else offsets)


def _flat_vectors(inner: Any) -> tuple[NDArray[Any], int]:
    import pyarrow as pa

    _refuse_nulls(inner)
    if pa.types.is_fixed_size_list(inner.type):
        width = inner.type.list_size
        flat = inner.values.slice(inner.offset * width, len(inner) * width)
    else:
        flat = inner.flatten()
        widths = np.diff(inner.offsets.to_numpy(zero_copy_only=True))
        width = int(widths[0]) if len(widths) else 3
        if len(widths) and (widths != width).any():
            message = f"inner lists of {width} and {int(widths[widths != width][0])} values in one column"
            raise ValueError(message)
    _refuse_nulls(flat)
    return flat.to_numpy(zero_copy_only=True), width


def _refuse_nulls(array: Any) -> None:
    if array.null_count:
        message = f"{array.null_count} null values where every row needs one"
        raise ValueError(message)


def list_array(rows: list[NDArray[Any]], value_type: Any, width: int = 3) -> Any:
    """Pack arrays of shape (n_i, width) into an Arrow ``list<fixed_size_list<value_type>[width]>``."""
    import pyarrow as pa

    offsets = np.zeros(len(rows) + 1, dtype=np.int32)
    np.cumsum([len(row) for row in rows], out=offsets[1:])
    flat: Any = np.concatenate([row.reshape(-1) for row in rows]) if rows else []
    # Not value_type.to_pandas_dtype(): it imports pandas, which takes a second.
    inner = pa.FixedSizeListArray.from_arrays(pa.array(flat, value_type), width)
    return pa.ListArray.from_arrays(pa.array(offsets), inner, type=pa.list_(pa.list_(value_type, width)))


def column_names(schema: Any) -> tuple[str, ...]:
    """List columns by dotted name, at any depth; struct ``a<b, c>`` and flat ``a.b``, ``a.c`` read alike."""
    return tuple(name for column in schema for name in _leaf_names(column.name, column.type))


def _leaf_names(name: str, data_type: Any) -> list[str]:
    import pyarrow as pa

    if not pa.types.is_struct(data_type):
        return [name]
    return [leaf for child in data_type for leaf in _leaf_names(f"{name}.{child.name}", child.type)]


def stored_class_names(schema: Any, where: str) -> tuple[str, ...] | None:
    """Return the names of the classes that `datasets` stored in a schema; None where it stored none.

    Parameters
    ----------
    schema : pyarrow.Schema
        Schema of a file.
    where : str
        The file, for messages.

    Raises
    ------
    IntegrityError
        What is stored there is no description of features.
    """
    text = (schema.metadata or {}).get(b"huggingface")
    if text is None:
        return None
    try:
        found = json.loads(text)
        for part in ("info", "features", "label", "names"):
            found = None if found is None else found.get(part)
    except (ValueError, AttributeError, RecursionError) as error:
        raise _no_features(where, text) from error
    if found is None:
        return None
    if not isinstance(found, list) or not all(isinstance(name, str) for name in found):
        raise _no_features(where, text)
    return tuple(found)


def _no_features(where: str, text: bytes) -> IntegrityError:
    found = text[:80].decode(errors="replace")
    return IntegrityError(
        f"{where!r}, field 'label': the metadata 'huggingface' begins with {found!r}; expected the features "
        "of the data set, class names among them, in JSON; next: download or convert the data set again"
    )


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
    group = RowGroup(table)
    found: dict[int, str] = {}
    for name in names:
        if name not in group.names:
            continue
        for place, rows in _nulls(group.arrow(name), name):
            for row in np.flatnonzero(rows).tolist():
                found.setdefault(row, place)
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


@dataclass(frozen=True, eq=False)
class RowGroup:
    """One unpacked row group, or a block of a large one: columns as numpy views of mapped memory.

    Parameters
    ----------
    table : pyarrow.Table
        The rows, one chunk per column.
    path : str
        File that the rows come from, for messages.
    first_row : int
        Number of the first row in that file.
    mapped : bool
        Whether the rows lie in a mapped file of the cache, so that holding on to them costs no memory.
    """

    table: Any
    path: str = ""
    first_row: int = 0
    mapped: bool = False
    _ragged: dict[str, RaggedColumn] = field(default_factory=dict, repr=False)
    _flat: dict[str, NDArray[Any]] = field(default_factory=dict, repr=False)
    _views: dict[str, Any] = field(default_factory=dict, repr=False)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Columns by dotted name."""
        return column_names(self.table.schema)

    def once(self, key: str, build: Callable[[], Any]) -> Any:
        """Build a view of the rows on its first use and keep it with them."""
        view = self._views.get(key)
        return self._views.setdefault(key, build()) if view is None else view

    def ragged(self, name: str) -> RaggedColumn:
        """Return a column of arrays of shape (n_i, width), by dotted name."""
        column = self._ragged.get(name)
        if column is None:
            column = self._ragged.setdefault(name, ragged_column(self.arrow(name)))
        return column

    def flat(self, name: str) -> NDArray[Any]:
        """Return a column of plain values as a numpy array."""
        column = self._flat.get(name)
        if column is None:
            column = self._flat.setdefault(name, self.arrow(name).to_numpy(zero_copy_only=False))
        return column

    def arrow(self, name: str) -> Any:
        """Return a column as an Arrow array, by dotted name, whether stored flat or as a struct's field.

        Raises
        ------
        KeyError
            When there is no such column.
        """
        outer, *inner = _split_name(name, self.table.column_names)
        array = _one_chunk(self.table.column(outer))
        for part in inner:
            array = _struct_field(array, part, name)
        return array


def _split_name(name: str, columns: Sequence[str]) -> list[str]:
    """Split ``a.b.c`` into the stored column, which may hold dots itself, and the fields inside it."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        outer = ".".join(parts[:count])
        if outer in columns:
            return [outer, *parts[count:]]
    raise KeyError(name)


def _struct_field(array: Any, part: str, name: str) -> Any:
    import pyarrow as pa

    if not pa.types.is_struct(array.type) or array.type.get_field_index(part) < 0:
        raise KeyError(name)
    return array.flatten()[array.type.get_field_index(part)]


def _one_chunk(column: Any) -> Any:
    return column.chunk(0) if column.num_chunks == 1 else column.combine_chunks()
