"""Mesh columns: how a data set of meshes is laid out, the published way.

The published data sets store a mesh as two flat columns whose names begin with ``mesh.``: readers hand every
such column to the mesh class, so that no other column may begin so (package tactile-mnist 0.13.0).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tactile_toolkit.errors import InputError
from tactile_toolkit.read.columns import column_names, vectors_type
from tactile_toolkit.read.features import dtype_name, feature_metadata, label_feature, stored_class_names

__all__ = [
    "FACES",
    "VERTICES",
    "class_names",
    "mesh_set_schema",
    "require_mesh_columns",
]

VERTICES = "mesh.vertices"
"""Column of corner positions: ``list<float32[3]>``, metres."""

FACES = "mesh.faces"
"""Column of triangles: ``list<int32[3]>``, rows of the vertices."""


def mesh_set_schema(class_names: tuple[str, ...], further: Sequence[tuple[str, Any]] = ()) -> Any:
    """Return the Arrow schema of a set of meshes: the published flat columns, then ``further`` of ours.

    Its metadata describe all columns to `datasets`.
    """
    import pyarrow as pa

    numbers = [("id", pa.int64()), ("label", pa.int64())]
    vectors = [(VERTICES, vectors_type(pa.float32())), (FACES, vectors_type(pa.int32()))]
    schema = pa.schema([*numbers, *vectors, *further])
    features = {field.name: _feature(field.type) for field in schema}
    return schema.with_metadata(feature_metadata({**features, "label": label_feature(class_names)}))


def _feature(data_type: Any) -> Any:
    """Describe a column to `datasets`, in the spellings that both old and new releases read."""
    import pyarrow as pa

    if pa.types.is_list(data_type) and pa.types.is_struct(data_type.value_type):
        return [{field.name: _feature(field.type) for field in data_type.value_type}]
    if pa.types.is_fixed_size_list(data_type):
        inner = _feature(data_type.value_type)
        return {"feature": inner, "length": data_type.list_size, "_type": "Sequence"}
    if pa.types.is_list(data_type):
        return {"feature": _feature(data_type.value_type), "_type": "Sequence"}
    return {"dtype": dtype_name(data_type), "_type": "Value"}


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
    found = column_names(schema)
    missing = [column for column in ("id", "label", VERTICES, FACES) if column not in found]
    if missing:
        message = (
            f"{name!r} is not a data set of meshes: column {missing[0]!r} is missing (found "
            f"{', '.join(found)}); next: name a data set such as one written by `{made_by}`"
        )
        raise InputError(message)
