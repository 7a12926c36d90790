"""Columns of synthetic touches: published ones, those of the toolkit, and those of some sets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from tactile_toolkit import read, rows, touch
from tactile_toolkit.array_types import Float32, Float64

EXTRA = "extra."
"""Prefix of columns that only some sets have: ``touch.extra["force_n"]`` reads them."""

_CELL = "m, cell frame"
_XY = read.vectors_type(pa.float64(), 2)
_XYZ = read.vectors_type(pa.float64(), 3)
_XYZW = read.vectors_type(pa.float64(), 4)


def _extra(name: str, unit: str, meaning: str) -> Any:
    """Declare a further column of an elastic gel, in the frame of the sensor, whose type a set chooses."""
    return rows.column(pa.null(), unit, meaning, name=f"{EXTRA}{name}", default=None)


@rows.row
class SyntheticRound:
    """One round."""

    id: str = rows.column(pa.string(), "", "`object_id` and number of the round")
    label: int = rows.column(pa.int64(), "", "class of the touched object")
    object_id: int = rows.column(pa.int64(), "", "`id` of its mesh in the data set of the objects")
    moved_position_m: Float64 = rows.column(
        _XYZ,
        f"T x 3, {_CELL}",
        "position of the object after the touch and a shift that follows it, as the published sets have it",
        name="info.object_pose.position",
    )
    moved_quaternion: Float64 = rows.column(
        _XYZW, "T x 4: x, y, z, w", "its orientation then", name="info.object_pose.quaternion"
    )
    positions_m: Float64 = rows.column(_XY, f"T x 2, {_CELL}", "where the gel goes", name="pos_in_cell")
    gel_position_m: Float64 = rows.column(
        _XYZ,
        f"T x 3, {_CELL}",
        "position of the sensor where it stops",
        name="gel_pose_cell_frame.position",
    )
    gel_quaternion: Float64 = rows.column(
        _XYZW,
        "T x 4: x, y, z, w",
        "its orientation: z away from the plate",
        name="gel_pose_cell_frame.quaternion",
    )
    images: Sequence[tuple[bytes, str]] = rows.column(
        pa.list_(touch.MEDIA_TYPE), "T images", "what the sensor sees", name="sensor_image"
    )
    object_position_m: Float64 = rows.column(
        _XYZ,
        f"T x 3, {_CELL}",
        "position of the object while it is touched",
        name="info.touched_object_pose.position",
    )
    object_quaternion: Float64 = rows.column(
        _XYZW, "T x 4: x, y, z, w", "its orientation then", name="info.touched_object_pose.quaternion"
    )
    plate_z_m: float | None = rows.column(
        pa.float64(), "m, cell frame", "height of the sensor where it stops on the bare plate", default=None
    )
    force_n: Float32 | None = _extra(
        "force_n", "T x 3, N", "force of the object on the gel; z as it is pressed in"
    )
    torque_nm: Float32 | None = _extra(
        "torque_nm", "T x 3, N m", "its torque about the middle of the surface of the gel"
    )
    press_depth_m: Float32 | None = _extra(
        "press_depth_m", "T, m", "how far the highest point under the gel is pressed in"
    )
    contact_point_m: Float32 | None = _extra(
        "contact_point_m", "T x 2, m", "where the normal force acts, from the middle of the gel"
    )
    slide_m: Float32 | None = _extra(
        "slide_m", "T x 2, m", "how far the object slid under the gel after the press"
    )
    twist_rad: Float32 | None = _extra(
        "twist_rad", "T, rad", "how far it turned, counter-clockwise in the image"
    )
    marker_positions_px: Float32 | None = _extra(
        "marker_positions_px",
        "T x 2 M, px",
        "column and row of each marker, one row of markers after the other",
    )
    marker_flow_px: Float32 | None = _extra(
        "marker_flow_px", "T x 2 M, px", "how far each marker moved: column, row"
    )
    pressure_kpa: NDArray[np.float16] | None = _extra(
        "pressure_kpa", "T x H W, kPa", "pressure on the gel under each pixel, row after row"
    )
    displacement_mm: NDArray[np.float16] | None = _extra(
        "displacement_mm",
        "T x 3 H W, mm",
        "displacement of its surface under each pixel: along x, along y, into the gel",
    )


DRAWN = (
    "info.object_pose.position",
    "info.object_pose.quaternion",
    "pos_in_cell",
    "gel_pose_cell_frame.position",
    "info.touched_object_pose.position",
    "info.touched_object_pose.quaternion",
)
"""Columns of random numbers: a dictionary would repeat all of them."""


def synthetic_schema(
    class_names: tuple[str, ...], optional: Mapping[str, pa.DataType] | None = None
) -> pa.Schema:
    """Return the Arrow schema of a shard; ``optional`` are the types of the further columns that it has."""
    stored = rows.plain_schema(SyntheticRound)
    known = {each.name for each in rows.columns(SyntheticRound).values()}
    further = {
        rows.columns(SyntheticRound)[each.name].name
        for each in fields(SyntheticRound)
        if each.default is None
    }
    types = dict(optional or {})
    chosen = [
        pa.field(each.name, types.get(each.name, each.type))
        for each in stored
        if each.name not in further or each.name in types
    ]
    assert set(types) <= known, "optional columns are declared"
    return touch.with_features(pa.schema(chosen), class_names)
