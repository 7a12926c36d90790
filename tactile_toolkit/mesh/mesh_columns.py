"""Columns of stored meshes, as in the published data sets.

These store a mesh as two flat columns whose names begin with ``mesh.``. Readers pass each such column to the
mesh class, so no other column may have this prefix (package tactile-mnist 0.13.0).
"""

from __future__ import annotations

import pyarrow as pa

from tactile_toolkit import read, rows
from tactile_toolkit.array_types import AnyArray
from tactile_toolkit.errors import InputError
from tactile_toolkit.json_types import JsonValue

VERTICES = "mesh.vertices"
"""Column of corner positions: ``list<float32[3]>``, metres."""

FACES = "mesh.faces"
"""Column of triangles: ``list<int32[3]>``, rows of the vertices."""


# Ids and labels are checked row by row: a float may hold an integer.
_MESH_TYPES: dict[str, read.Expected] = {
    VERTICES: (2, (pa.types.is_floating,), "three floats per vertex"),
    FACES: (2, (pa.types.is_integer,), "three integers per triangle"),
}


def require_mesh_columns(schema: pa.Schema, name: str, made_by: str) -> None:
    """Raise InputError if the data set ``name`` lacks a column of the published mesh layout.

    ``made_by`` is the command that writes such data sets, for the message.
    """
    found = read.column_names(schema)
    missing = [each for each in ("id", "label", VERTICES, FACES) if each not in found]
    problem = f"column {missing[0]!r} is missing (found {', '.join(found)})" if missing else ""
    problem = problem or read.wrong_type(read.column_types(schema), _MESH_TYPES)
    if problem:
        raise InputError(
            f"{name!r} is not a data set of meshes: {problem}",
            next=f"name a data set such as one written by `{made_by}`",
        )


@rows.row
class MeshRow:
    """A row with a mesh; row classes of each kind add their own columns after these."""

    id: int = rows.column(pa.int64())
    label: int = rows.column(pa.int64())
    vertices_m: AnyArray = rows.column(
        read.vectors_type(pa.float32()), "V x 3, m, frame below", "corner positions", name=VERTICES
    )
    faces: AnyArray = rows.column(
        read.vectors_type(pa.int32()),
        "F x 3",
        "triangles: rows of the corners, counter-clockwise seen from outside",
        name=FACES,
    )


def mesh_schema(row_type: type[MeshRow], class_names: tuple[str, ...]) -> pa.Schema:
    """Return the Arrow schema of rows with a mesh; its metadata describe the columns to `datasets`."""
    schema = rows.plain_schema(row_type)
    return schema.with_metadata(mesh_metadata(schema, class_names))


def mesh_metadata(schema: pa.Schema, class_names: tuple[str, ...]) -> JsonValue:
    """Return the metadata of a schema, which describe its columns to `datasets`."""
    features = {field.name: _feature(field.type) for field in schema}
    return read.feature_metadata({**features, "label": read.label_feature(class_names)})


def _feature(data_type: pa.DataType) -> JsonValue:
    """Describe a column to `datasets`, in a form that both old and new releases read."""
    if pa.types.is_list(data_type) and pa.types.is_struct(data_type.value_type):
        return [{field.name: _feature(field.type) for field in data_type.value_type}]
    if pa.types.is_fixed_size_list(data_type):
        inner = _feature(data_type.value_type)
        return {"feature": inner, "length": data_type.list_size, "_type": "Sequence"}
    if pa.types.is_list(data_type):
        return {"feature": _feature(data_type.value_type), "_type": "Sequence"}
    return {"dtype": read.dtype_name(data_type), "_type": "Value"}
