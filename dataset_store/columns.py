"""Arrow columns seen as numpy arrays, without passing through Python lists."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dataset_store.errors import IntegrityError

__all__ = ["RaggedColumn", "column_names", "list_array", "ragged_column", "stored_class_names"]


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
