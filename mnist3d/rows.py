"""Rows of MNIST 3D (published columns first) and of the printability report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from mnist3d.kind import KIND
from tactile_toolkit.mesh.columns import FACES, VERTICES, mesh_set_schema
from tactile_toolkit.mesh.mesh import Mesh
from tactile_toolkit.mesh.printability import REPORT_COLUMNS, PrintReport
from tactile_toolkit.read.columns import list_array
from tactile_toolkit.store.parquet import ParquetStyle
from tactile_toolkit.store.shards import ShardName

__all__ = [
    "CLASS_NAMES",
    "MeshRow",
    "PARQUET_STYLE",
    "REPORT_FILE",
    "mesh_schema",
    "mesh_table",
    "report_table",
]

CLASS_NAMES = KIND.class_names

PARQUET_STYLE = ParquetStyle(
    rows_per_group=32,
    compression="zstd",
    compression_level=3,
    encodings=(
        (f"{VERTICES}.list.element.list.element", "BYTE_STREAM_SPLIT"),
        (f"{FACES}.list.element.list.element", "DELTA_BINARY_PACKED"),
    ),
)
"""32 meshes are about 6 MB unpacked: small enough to unpack for one row, large enough to compress well.

Level 3 of zstd takes 1.0 ms and 52.6 kB a mesh, level 9 takes 1.7 ms and 51.1 kB; without the encodings
level 3 would give 65.8 kB.
"""


@dataclass(frozen=True, slots=True, eq=False)
class MeshRow:
    """One row before it becomes Arrow: id, label and writer as in the source, the solid in metres."""

    id: int
    label: int
    mesh: Mesh
    writer: int
    volume_m3: float


@cache
def mesh_schema() -> Any:
    """Return the Arrow schema of a shard."""
    import pyarrow as pa

    return mesh_set_schema(
        CLASS_NAMES, [("writer", pa.int64()), ("volume_m3", pa.float64()), ("source", pa.string())]
    )


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


REPORT_FILE = "reports/printability.parquet"
"""What was found about each mesh, one row per digit."""


def report_table(shard: ShardName, rows: Sequence[MeshRow], reports: Sequence[PrintReport]) -> Any:
    """Pack the reports of the rows of one shard into an Arrow table."""
    import pyarrow as pa

    values = [
        {
            "id": row.id,
            "label": row.label,
            "split": shard.split,
            "shard": str(shard),
            **report.to_row(),
            "warnings": list(report.warnings),
        }
        for row, report in zip(rows, reports, strict=True)
    ]
    # The columns of the report are those of `PrintReport`: a further measure needs no edit here.
    arrow = {bool: pa.bool_(), str: pa.string(), int: pa.int64(), float: pa.float64()}
    # Rows are only of meshes that are solids: a reason why one is not has no column.
    left_out = ("problem", "detail", "warnings")
    schema = pa.schema(
        [
            ("id", pa.int64()),
            ("label", pa.int64()),
            ("split", pa.string()),
            ("shard", pa.string()),
            *((name, arrow[kind]) for name, kind in REPORT_COLUMNS.items() if name not in left_out),
            ("warnings", pa.list_(pa.string())),
        ]
    )
    return pa.Table.from_pylist(values, schema=schema)
