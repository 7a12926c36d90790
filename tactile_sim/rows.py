"""Rows of synthetic touches in the published schema, and two columns of our own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_sim.plan import RoundPlan
from tactile_toolkit.store.parquet import ParquetStyle
from tactile_toolkit.touch.rows import bytes_lists, number_lists
from tactile_toolkit.touch.schema import MEDIA_TYPE, with_features

__all__ = ["TouchRow", "parquet_style", "touch_schema", "touch_table"]


@dataclass(frozen=True, slots=True, eq=False)
class TouchRow:
    """One round before it becomes Arrow."""

    id: str
    label: int
    object_id: int
    plan: RoundPlan
    sensor_z_m: NDArray[np.float64]
    images: Sequence[bytes]


@cache
def touch_schema(class_names: tuple[str, ...]) -> Any:
    """Return the Arrow schema of a shard: the published columns of synthetic sets, then ours."""
    import pyarrow as pa

    def vectors(width: int) -> Any:
        return pa.list_(pa.list_(pa.float64(), width))

    fields = [
        ("id", pa.string()),
        ("label", pa.int64()),
        ("object_id", pa.int64()),
        ("info.object_pose.position", vectors(3)),
        ("info.object_pose.quaternion", vectors(4)),
        ("pos_in_cell", vectors(2)),
        ("gel_pose_cell_frame.position", vectors(3)),
        ("gel_pose_cell_frame.quaternion", vectors(4)),
        ("sensor_image", pa.list_(MEDIA_TYPE)),
        ("info.touched_object_pose.position", vectors(3)),
        ("info.touched_object_pose.quaternion", vectors(4)),
    ]
    return with_features(pa.schema(fields), class_names)


def touch_table(rows: Sequence[TouchRow], class_names: tuple[str, ...], suffix: str) -> Any:
    """Pack rows into an Arrow table of :func:`touch_schema`; ``suffix`` names the format of the pictures."""
    import pyarrow as pa

    schema = touch_schema(class_names)
    # Where no object of a shard bounds a solid.
    if not rows:
        return schema.empty_table()
    # No turn, as x, y, z, w: sensors of the published sets keep their orientation.
    upright = np.array([0.0, 0.0, 0.0, 1.0])
    columns = {
        # As published: the pose after the shift, so that touch i was rendered at the pose of touch i - 1.
        "info.object_pose.position": [row.plan.object_position_m[1:] for row in rows],
        "info.object_pose.quaternion": [row.plan.object_quaternion[1:] for row in rows],
        "pos_in_cell": [row.plan.positions_m for row in rows],
        "gel_pose_cell_frame.position": [
            np.column_stack([row.plan.positions_m, row.sensor_z_m]) for row in rows
        ],
        "gel_pose_cell_frame.quaternion": [np.tile(upright, (len(row.images), 1)) for row in rows],
        "info.touched_object_pose.position": [row.plan.object_position_m[:-1] for row in rows],
        "info.touched_object_pose.quaternion": [row.plan.object_quaternion[:-1] for row in rows],
    }
    plain = {
        "id": pa.array([row.id for row in rows], pa.string()),
        "label": pa.array([row.label for row in rows], pa.int64()),
        "object_id": pa.array([row.object_id for row in rows], pa.int64()),
        "sensor_image": bytes_lists([row.images for row in rows], suffix, schema.field("sensor_image").type),
    }
    packed = {name: number_lists(values, schema.field(name).type) for name, values in columns.items()}
    arrays = {**plain, **packed}
    return pa.Table.from_arrays([arrays[field.name] for field in schema], schema=schema)


def parquet_style(rows_per_group: int) -> ParquetStyle:
    """Return the layout of shards: pictures do not compress again."""
    return ParquetStyle(
        rows_per_group, compression_level=3, encodings=(("sensor_image.list.element.bytes", "PLAIN"),)
    )
