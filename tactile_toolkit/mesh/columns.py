"""Mesh columns: how a data set of meshes is laid out, the published way, and as a flat table.

The published data sets store a mesh as two flat columns whose names begin with ``mesh.``: readers hand every
such column to the mesh class, so that no other column may begin so (package tactile-mnist 0.13.0).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa

from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.files import pack_mesh
from tactile_toolkit.mesh.mesh import Mesh
from tactile_toolkit.read.columns import (
    column_names,
    dtype_name,
    feature_metadata,
    label_feature,
    vectors_type,
)
from tactile_toolkit.read.dataset import RecordDataset
from tactile_toolkit.rows import column, plain_schema, row

VERTICES = "mesh.vertices"
"""Column of corner positions: ``list<float32[3]>``, metres."""

FACES = "mesh.faces"
"""Column of triangles: ``list<int32[3]>``, rows of the vertices."""


def require_mesh_columns(schema: Any, name: str, made_by: str) -> None:
    """Refuse the data set ``name`` where it has not all columns of the published mesh layout.

    ``made_by`` is the command that writes such data sets, for the message of the InputError.
    """
    found = column_names(schema)
    missing = [each for each in ("id", "label", VERTICES, FACES) if each not in found]
    if missing:
        raise InputError(
            f"{name!r} is not a data set of meshes: column {missing[0]!r} is missing (found "
            f"{', '.join(found)})",
            next=f"name a data set such as one written by `{made_by}`",
        )


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


MESH = "mesh"
"""Column of the GLB files, metres, which `datasets` knows as its feature ``Mesh``."""

SIZES = ("size_x_m", "size_y_m", "size_z_m")


def flat_table(rows: RecordDataset[Any]) -> Any:
    """Return an Arrow table of rows: all stored columns but the mesh, its class by name, size and file."""
    stored = rows.to_hf()
    kept = [name for name in stored.column_names if name not in (VERTICES, FACES)]
    table = stored.select_columns(kept).with_format("arrow")[:]
    features = stored.features.to_dict()
    classes = dict(enumerate(rows.label_names))
    names = [classes.get(label, str(label)) for label in rows.labels.tolist()]
    table = table.add_column(kept.index("label") + 1, "label_name", pa.array(names, pa.string()))
    sizes, files = [], []
    for number, record in enumerate(rows):
        mesh = Mesh(record.vertices_m, record.faces)
        sizes.append(np.ptp(np.asarray(mesh.vertices_m, np.float64), axis=0))
        # `datasets` takes the kind of file from the name.
        files.append({"bytes": pack_mesh(mesh, ".glb"), "path": f"{number:05d}.glb"})
    for name, values in zip(SIZES, np.reshape(sizes, (-1, 3)).T, strict=True):
        table = table.append_column(name, pa.array(values, pa.float64()))
    table = table.append_column(
        MESH, pa.array(files, pa.struct([("bytes", pa.binary()), ("path", pa.string())]))
    )
    described = {
        name: features.get(name, {"dtype": "float64", "_type": "Value"}) for name in table.column_names
    }
    described |= {"label_name": {"dtype": "string", "_type": "Value"}, MESH: {"_type": "Mesh"}}
    return table.replace_schema_metadata(feature_metadata(described))
