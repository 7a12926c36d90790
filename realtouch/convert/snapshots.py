"""From clips to single images: one frame of each touch, with the pose of the gel at that moment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from realtouch.columns.poses import touch_total, vectors
from realtouch.contact import ContactMethod
from realtouch.convert.plan import RowChoice
from realtouch.media.clips import TouchClip
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.touch.jpeg import encode_image
from tactile_toolkit.touch.rows import bytes_lists, flat_table, media_type, number_lists
from tactile_toolkit.touch.schema import column_type

__all__ = ["TakeSnapshots", "snapshot_frame", "snapshot_jpeg"]

_SEQ_ONLY = (
    "video_length_frames",
    "time_stamp_rel_seq",
    "touch_start_time_rel",
    "touch_end_time_rel",
    "sensor_video",
)
_POSE, _POSE_SEQUENCE = "gel_pose_cell_frame", "gel_pose_cell_frame_seq"


@dataclass(frozen=True)
class TakeSnapshots:
    """Step of ``to-single``.

    Attributes
    ----------
    method : str
        Which frame to take; see :meth:`realtouch.media.clips.TouchClip.contact_index`.
    """

    method: ContactMethod

    def schema(self, source: Any) -> Any:
        """Return the published ``single`` schema with the columns that the source has.

        Raises
        ------
        InputError
            The source has no poses.
        """
        import pyarrow as pa

        leaf = column_type(source, f"{_POSE_SEQUENCE}.position")
        if leaf is None:
            message = f"the source has no column '{_POSE_SEQUENCE}.position'; expected poses of each frame"
            raise InputError(message)
        number = pa.float64() if "double" in str(leaf) else pa.float32()
        video = column_type(source, "sensor_video")
        count = video.list_size if pa.types.is_fixed_size_list(video) else -1
        kept = [field for field in source if not _is_seq_only(field.name)]
        return pa.schema(
            [
                *kept,
                pa.field(f"{_POSE}.position", pa.list_(pa.list_(number, 3), count)),
                pa.field(f"{_POSE}.quaternion", pa.list_(pa.list_(number, 4), count)),
                pa.field("sensor_image", pa.list_(media_type(), count)),
            ]
        )

    def apply(self, row: Row, choice: RowChoice, split: str) -> Any:
        """Take a frame of each clip of a row; its JPEG passes through as it is stored.

        Raises
        ------
        IntegrityError
            A clip, a pose or the frame is damaged; names file, row and touch.
        """
        import pyarrow as pa

        flat = flat_table(row.group.table.slice(row.index, 1))
        schema = self.schema(flat.schema)
        clips = [TouchClip(row, touch) for touch in range(touch_total(row))]
        frames = [snapshot_frame(clip, self.method) for clip in clips]
        poses = [clip.poses[frame : frame + 1] for clip, frame in zip(clips, frames, strict=True)]
        made = {
            f"{_POSE}.position": _stacked(
                schema, f"{_POSE}.position", [pose.position_m for pose in poses], 3
            ),
            f"{_POSE}.quaternion": _stacked(
                schema, f"{_POSE}.quaternion", [pose.quaternion for pose in poses], 4
            ),
            "sensor_image": bytes_lists(
                [[snapshot_jpeg(clip, frame) for clip, frame in zip(clips, frames, strict=True)]],
                "jpg",
                schema.field("sensor_image").type,
            ),
        }
        if row.has("pos_in_cell"):
            vectors(row, "pos_in_cell", 2)  # checked here, passed through below
        columns = [made[name] if name in made else flat.column(name) for name in schema.names]
        return pa.table(columns, schema=schema)


def snapshot_frame(clip: TouchClip, method: ContactMethod) -> int:
    """Choose the frame of a clip; the last one of registered contact where ``"median"`` sees none."""
    try:
        return clip.contact_index(method)
    except ItemError:
        return clip.contact_index("contact_end")


def snapshot_jpeg(clip: TouchClip, frame: int) -> bytes | memoryview:
    """Return the stored JPEG of a frame; encodes it only where the clip is no string of JPEGs.

    Raises
    ------
    IntegrityError
        The frame is damaged; names file, row and touch.
    """
    pixels = clip[frame]  # decoded in any case: what passes through must be whole
    return clip.encoded(frame) if clip.has_index else encode_image(pixels)


def _stacked(schema: Any, name: str, rows: list[Any], width: int) -> Any:
    stacked = np.concatenate(rows) if rows else np.empty((0, width))
    return number_lists([stacked], schema.field(name).type)


def _is_seq_only(name: str) -> bool:
    return name in _SEQ_ONLY or name.startswith(f"{_POSE_SEQUENCE}.")
