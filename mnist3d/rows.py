"""Rows of MNIST 3D: the published flat columns first, then ours."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from dataset_store.columns import list_array
from dataset_store.shards import ParquetStyle
from mnist3d.mesh import Mesh

__all__ = ["CLASS_NAMES", "PARQUET_STYLE", "MeshRow", "mesh_schema", "mesh_table"]

CLASS_NAMES = tuple(str(digit) for digit in range(10))

PARQUET_STYLE = ParquetStyle(
    rows_per_group=32,
    compression="zstd",
    compression_level=9,
    encodings=(
        ("mesh.vertices.list.element.list.element", "BYTE_STREAM_SPLIT"),
        ("mesh.faces.list.element.list.element", "DELTA_BINARY_PACKED"),
    ),
)
"""32 meshes are about 6 MB unpacked: small enough to unpack for one row, large enough to compress well."""


@dataclass(frozen=True, slots=True, eq=False)
class MeshRow:
    """One row before it becomes Arrow.

    Attributes
    ----------
    id, label, writer : int
        As in the source.
    mesh : Mesh
        The solid, metres.
    volume_m3 : float
        Its volume.
    """

    id: int
    label: int
    mesh: Mesh
    writer: int
    volume_m3: float


@cache
def mesh_schema() -> Any:
    """Return the Arrow schema of a shard, with the metadata that `datasets` reads features from."""
    import pyarrow as pa

    fields = [
        pa.field("id", pa.int64()),
        pa.field("label", pa.int64()),
        pa.field("mesh.vertices", pa.list_(pa.list_(pa.float32(), 3))),
        pa.field("mesh.faces", pa.list_(pa.list_(pa.int32(), 3))),
        pa.field("writer", pa.int64()),
        pa.field("volume_m3", pa.float64()),
        pa.field("source", pa.string()),
    ]
    features = {
        "id": _value("int64"),
        "label": {"names": list(CLASS_NAMES), "_type": "ClassLabel"},
        "mesh.vertices": _vectors("float32"),
        "mesh.faces": _vectors("int32"),
        "writer": _value("int64"),
        "volume_m3": _value("float64"),
        "source": _value("string"),
    }
    return pa.schema(fields, metadata={"huggingface": json.dumps({"info": {"features": features}})})


def _value(dtype: str) -> dict[str, Any]:
    return {"dtype": dtype, "_type": "Value"}


def _vectors(dtype: str) -> dict[str, Any]:
    # "Sequence" is the spelling that both old and new releases of `datasets` read as a list.
    inner = {"feature": _value(dtype), "length": 3, "_type": "Sequence"}
    return {"feature": inner, "_type": "Sequence"}


def mesh_table(rows: Sequence[MeshRow], source: str) -> Any:
    """Pack rows into an Arrow table of :func:`mesh_schema`."""
    import pyarrow as pa

    columns = [
        pa.array([row.id for row in rows], pa.int64()),
        pa.array([row.label for row in rows], pa.int64()),
        list_array([row.mesh.vertices_m for row in rows], pa.float32()),
        list_array([row.mesh.faces for row in rows], pa.int32()),
        pa.array([row.writer for row in rows], pa.int64()),
        pa.array([row.volume_m3 for row in rows], pa.float64()),
        pa.array([source] * len(rows), pa.string()),
    ]
    return pa.Table.from_arrays(columns, schema=mesh_schema())
