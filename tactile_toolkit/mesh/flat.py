"""Meshes as one table that every reader of Parquet reads: plain columns, and each mesh as a GLB file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tactile_toolkit.mesh.columns import FACES, VERTICES
from tactile_toolkit.mesh.files import pack_mesh
from tactile_toolkit.mesh.mesh import Mesh
from tactile_toolkit.read.features import feature_metadata

if TYPE_CHECKING:
    from tactile_toolkit.read.dataset import RecordDataset


MESH = "mesh"
"""Column of the GLB files, metres, which `datasets` knows as its feature ``Mesh``."""

SIZES = ("size_x_m", "size_y_m", "size_z_m")


def flat_table(rows: RecordDataset[Any]) -> Any:
    """Return an Arrow table of rows: all stored columns but the mesh, its class by name, size and file."""
    import pyarrow as pa

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
        # `datasets` tells by the name what kind of file the bytes are.
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
