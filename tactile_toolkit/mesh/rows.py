"""The columns that all rows with a mesh have, in the published layout."""

from __future__ import annotations

from typing import Any

import pyarrow as pa

from tactile_toolkit.mesh.columns import FACES, VERTICES
from tactile_toolkit.read.columns import vectors_type
from tactile_toolkit.read.features import dtype_name, feature_metadata, label_feature
from tactile_toolkit.rows import column, plain_schema, row


@row
class MeshRow:
    """A row with a mesh; the classes of rows of each kind add their own columns after these."""

    id: int = column(pa.int64())
    label: int = column(pa.int64())
    vertices_m: Any = column(
        vectors_type(pa.float32()), "V x 3, m, frame below", "corner positions", name=VERTICES
    )
    faces: Any = column(
        vectors_type(pa.int32()),
        "F x 3",
        "triangles: rows of the corners, counter-clockwise seen from outside",
        name=FACES,
    )


def mesh_schema(row_type: type[MeshRow], class_names: tuple[str, ...]) -> pa.Schema:
    """Return the Arrow schema of rows with a mesh; its metadata describe all columns to `datasets`."""
    schema = plain_schema(row_type)
    features = {field.name: _feature(field.type) for field in schema}
    return schema.with_metadata(feature_metadata({**features, "label": label_feature(class_names)}))


def _feature(data_type: pa.DataType) -> Any:
    """Describe a column to `datasets`, in the spellings that both old and new releases read."""
    if pa.types.is_list(data_type) and pa.types.is_struct(data_type.value_type):
        return [{field.name: _feature(field.type) for field in data_type.value_type}]
    if pa.types.is_fixed_size_list(data_type):
        inner = _feature(data_type.value_type)
        return {"feature": inner, "length": data_type.list_size, "_type": "Sequence"}
    if pa.types.is_list(data_type):
        return {"feature": _feature(data_type.value_type), "_type": "Sequence"}
    return {"dtype": dtype_name(data_type), "_type": "Value"}
