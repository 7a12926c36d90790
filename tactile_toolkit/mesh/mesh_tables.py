"""Meshes as a flat table for other libraries: a row for each, with its size and its file."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from tactile_toolkit import read
from tactile_toolkit.mesh.files import pack_mesh
from tactile_toolkit.mesh.mesh import Mesh
from tactile_toolkit.mesh.mesh_columns import FACES, VERTICES

MESH = "mesh"
"""Column of GLB files, in metres; `datasets` reads it as its feature ``Mesh``."""

SIZES = ("size_x_m", "size_y_m", "size_z_m")


def flat_table(rows: read.AnyRecords) -> pa.Table:
    """Return an Arrow table: all stored columns but the mesh, then class name, size and GLB file."""
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
        # `datasets` infers the file format from the name.
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
    return table.replace_schema_metadata(read.feature_metadata(described))
