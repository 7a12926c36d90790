"""Mesh columns: how a data set of meshes is laid out, the published way.

The published data sets store a mesh as two flat columns whose names begin with ``mesh.``: readers hand every
such column to the mesh class, so that no other column may begin so (package tactile-mnist 0.13.0).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from tactile_toolkit.errors import InputError
from tactile_toolkit.read.columns import RaggedColumn, stored_class_names

__all__ = [
    "FACES",
    "VERTICES",
    "class_names",
    "feature_metadata",
    "label_feature",
    "ragged_array",
    "require_mesh_columns",
    "value_feature",
    "vectors_feature",
    "vectors_type",
]

VERTICES = "mesh.vertices"
"""Column of corner positions: ``list<float32[3]>``, metres."""

FACES = "mesh.faces"
"""Column of triangles: ``list<int32[3]>``, rows of the vertices."""


def vectors_type(value_type: Any, width: int = 3) -> Any:
    """Return the Arrow type ``list<value_type[width]>``."""
    import pyarrow as pa

    return pa.list_(pa.list_(value_type, width))


def ragged_array(column: RaggedColumn, value_type: Any) -> Any:
    """Pack rows that already lie one after another into ``list<value_type[width]>``, with no Python list."""
    import pyarrow as pa

    width = column.values.shape[1]
    flat = pa.array(column.values.reshape(-1), value_type)
    inner = pa.FixedSizeListArray.from_arrays(flat, width)
    offsets = pa.array(column.offsets, pa.int32())
    return pa.ListArray.from_arrays(offsets, inner, type=vectors_type(value_type, width))


def value_feature(dtype: str) -> dict[str, Any]:
    """Describe a plain column to `datasets`."""
    return {"dtype": dtype, "_type": "Value"}


def vectors_feature(dtype: str, width: int = 3) -> dict[str, Any]:
    """Describe a column of lists of vectors to `datasets`."""
    # "Sequence" is the spelling that both old and new releases of `datasets` read as a list.
    inner = {"feature": value_feature(dtype), "length": width, "_type": "Sequence"}
    return {"feature": inner, "_type": "Sequence"}


def label_feature(names: tuple[str, ...]) -> dict[str, Any]:
    """Describe the label column to `datasets`."""
    return {"names": list(names), "_type": "ClassLabel"}


def feature_metadata(features: Mapping[str, Any]) -> dict[str, str]:
    """Return schema metadata from which `datasets` reads the features of a Parquet file."""
    return {"huggingface": json.dumps({"info": {"features": dict(features)}})}


def class_names(schema: Any, default: tuple[str, ...], where: str = "") -> tuple[str, ...]:
    """Read the names of the classes from a schema; ``default`` where it names none.

    Raises IntegrityError, naming the data set, ``where``, for what does not describe features.
    """
    found = stored_class_names(schema, where)
    return default if found is None else found


def require_mesh_columns(schema: Any, name: str, made_by: str) -> None:
    """Refuse the data set ``name`` where it lacks a column of the published mesh layout.

    ``made_by`` is the command that writes such data sets, for the message of the InputError.
    """
    from tactile_toolkit.read.columns import column_names

    found = column_names(schema)
    missing = [column for column in ("id", "label", VERTICES, FACES) if column not in found]
    if missing:
        message = (
            f"{name!r} is not a data set of meshes: column {missing[0]!r} is missing (found "
            f"{', '.join(found)}); next: name a data set such as one written by `{made_by}`"
        )
        raise InputError(message)
