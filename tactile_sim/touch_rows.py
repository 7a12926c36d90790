"""The columns of synthetic touches: those of the published synthetic sets, then ours."""

from __future__ import annotations

from collections.abc import Sequence

import pyarrow as pa

from tactile_toolkit import read
from tactile_toolkit.array_types import Float64
from tactile_toolkit.rows import column, plain_schema, row
from tactile_toolkit.touch import MEDIA_TYPE, with_features

_CELL = "m, cell frame"
_XY = read.vectors_type(pa.float64(), 2)
_XYZ = read.vectors_type(pa.float64(), 3)
_XYZW = read.vectors_type(pa.float64(), 4)


@row
class SyntheticRound:
    """One round."""

    id: str = column(pa.string(), "", "`object_id` and number of the round")
    label: int = column(pa.int64(), "", "class of the touched object")
    object_id: int = column(pa.int64(), "", "`id` of its mesh in the data set of the objects")
    moved_position_m: Float64 = column(
        _XYZ,
        f"T x 3, {_CELL}",
        "position of the object after the touch and a shift that follows it, as the published sets have it",
        name="info.object_pose.position",
    )
    moved_quaternion: Float64 = column(
        _XYZW, "T x 4: x, y, z, w", "its orientation then", name="info.object_pose.quaternion"
    )
    positions_m: Float64 = column(_XY, f"T x 2, {_CELL}", "where the gel goes", name="pos_in_cell")
    gel_position_m: Float64 = column(
        _XYZ,
        f"T x 3, {_CELL}",
        "position of the sensor where it stops",
        name="gel_pose_cell_frame.position",
    )
    gel_quaternion: Float64 = column(
        _XYZW,
        "T x 4: x, y, z, w",
        "its orientation: z away from the plate",
        name="gel_pose_cell_frame.quaternion",
    )
    images: Sequence[tuple[bytes, str]] = column(
        pa.list_(MEDIA_TYPE), "T images", "what the sensor sees", name="sensor_image"
    )
    object_position_m: Float64 = column(
        _XYZ,
        f"T x 3, {_CELL}",
        "position of the object while it is touched",
        name="info.touched_object_pose.position",
    )
    object_quaternion: Float64 = column(
        _XYZW, "T x 4: x, y, z, w", "its orientation then", name="info.touched_object_pose.quaternion"
    )


@row
class OtherGelRound(SyntheticRound):
    """One round of a sensor whose press depth is not that of the GelSight Mini, which readers take."""

    plate_z_m: float = column(
        pa.float64(), "m, cell frame", "height of the sensor where it stops on the bare plate"
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
    class_names: tuple[str, ...], row_type: type[SyntheticRound] = SyntheticRound
) -> pa.Schema:
    """Return the Arrow schema of a shard."""
    return with_features(plain_schema(row_type), class_names)
