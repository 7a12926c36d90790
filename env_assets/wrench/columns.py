"""The columns of a wrench."""

from __future__ import annotations

from functools import cache

import pyarrow as pa

from env_assets.wrench.kind import KIND
from tactile_toolkit.mesh.columns import MeshRow, mesh_schema
from tactile_toolkit.rows import column, row


@row
class WrenchRow(MeshRow):
    """One wrench; columns in mm and degrees are fields of its specification."""

    id: int = column(pa.int64(), "", "0")
    label: int = column(pa.int64(), "", "the one class")
    volume_m3: float = column(pa.float64(), "m³", "enclosed volume")
    opening_mm: float = column(pa.float64(), "mm", "width across flats of the nut that the first jaw takes")
    second_opening_mm: float = column(
        pa.float64(), "mm", "the same of the second jaw; 0 where that end is plain"
    )
    length_mm: float = column(pa.float64(), "mm", "between the outermost points of the circles of both ends")
    thickness_mm: float = column(pa.float64(), "mm", "height")
    jaw_angle_deg: float = column(pa.float64(), "degrees", "between handle and jaws")


@cache
def wrench_schema() -> pa.Schema:
    """Return the Arrow schema of the shard."""
    return mesh_schema(WrenchRow, KIND.class_names)
