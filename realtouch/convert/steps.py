"""What ``to-single``, ``resize`` and ``select`` do to one row."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from realtouch.columns.per_touch import touch_total, vectors
from realtouch.columns.poses import contact_z_m, plate_z_m
from realtouch.contact import ContactMethod
from realtouch.convert.plan import Made, RowChoice
from realtouch.convert.shown import shown_touches
from realtouch.media.clips import TouchClip
from realtouch.media.images import SensorImages
from realtouch.media.round_clips import SensorClips
from tactile_toolkit.errors import InputError
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.touch.contact import PLATE_COLUMN
from tactile_toolkit.touch.jpeg import Pixels, encode_image, resized
from tactile_toolkit.touch.schema import (
    MEDIA_COLUMN,
    MEDIA_TYPE,
    POSE_COLUMN,
    Kind,
    bytes_lists,
    column_type,
    flat_row,
    is_per_touch,
    number_lists,
    take_touches,
)
from tactile_toolkit.touch.video import write_avi

_POSE, _POSE_SEQUENCE = POSE_COLUMN["single"], POSE_COLUMN["seq"]
_WIDTHS = {"position": 3, "quaternion": 4}
_SEQ_ONLY = (
    "video_length_frames",
    "time_stamp_rel_seq",
    "touch_start_time_rel",
    "touch_end_time_rel",
    "sensor_video",
)


@dataclass(frozen=True)
class TakeContactFrames:
    """Step of ``to-single``: one frame of each clip, with the pose of the gel at that moment."""

    method: ContactMethod

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the published ``single`` schema with the columns of the source; InputError without poses."""
        leaf = column_type(source, f"{_POSE_SEQUENCE}.position")
        if leaf is None:
            raise InputError(
                f"the source has no column '{_POSE_SEQUENCE}.position'; expected poses of each frame"
            )
        # In the precision of the source: poses are copied, not computed.
        number = pa.float64() if "double" in str(leaf) else pa.float32()
        video = column_type(source, "sensor_video")
        count = video.list_size if pa.types.is_fixed_size_list(video) else -1
        return pa.schema(
            [
                *(field for field in source if not _is_seq_only(field.name)),
                *(
                    pa.field(f"{_POSE}.{part}", pa.list_(pa.list_(number, width), count))
                    for part, width in _WIDTHS.items()
                ),
                pa.field("sensor_image", pa.list_(MEDIA_TYPE, count)),
            ]
        )

    def apply(self, row: Row, choice: RowChoice, split: str) -> Made:
        """Take a frame of each clip of a row; its JPEG passes through as it is stored."""
        flat = flat_row(row)
        schema = self.schema(flat.schema)
        pictures: list[bytes | memoryview] = []
        found: list[NDArray[Any]] = [np.empty((0, 7))]
        for each in shown_touches(row, self.method):
            pixels = each.decode()  # in any case: what passes through must be intact
            pictures.append(encode_image(pixels) if each.stored is None else each.stored)
            found += [] if each.pose is None else [each.pose[None]]
        poses = dict(zip(_WIDTHS, np.hsplit(np.concatenate(found), [3]), strict=True))
        made = {"sensor_image": bytes_lists([pictures], "jpg", schema.field("sensor_image").type)}
        for part, values in poses.items():
            name = f"{_POSE}.{part}"
            made[name] = number_lists([values], schema.field(name).type)
        if row.has("pos_in_cell"):
            vectors(row, "pos_in_cell", 2)  # checked here, passed through below
        columns = [made[name] if name in made else flat.column(name) for name in schema.names]
        return pa.table(columns, schema=schema), {}


def _is_seq_only(name: str) -> bool:
    return name in _SEQ_ONLY or name.startswith(f"{_POSE_SEQUENCE}.")


@dataclass(frozen=True)
class ResizeMedia:
    """Step of ``resize``: pixels are averaged, and only what changes is encoded again."""

    width: int
    height: int
    quality: int

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the schema of the source: only the pixels change."""
        return source

    def apply(self, row: Row, choice: RowChoice, split: str) -> Made:
        """Resize the images or clips of a row; one of the wanted size already passes through untouched."""
        size = (self.height, self.width)
        if row.has("sensor_image"):
            name, suffix, images = "sensor_image", "jpg", SensorImages(row)
            blobs = [
                images.encoded(touch) if images.size(touch) == size else self._encode(images[touch])
                for touch in range(len(images))
            ]
        else:
            name, suffix = "sensor_video", "avi"
            blobs = [clip.data if clip.size == size else self._clip(clip) for clip in SensorClips(row)]
        flat = flat_row(row)
        index = flat.schema.get_field_index(name)
        field = flat.schema.field(index)
        return flat.set_column(index, field, bytes_lists([blobs], suffix, field.type)), {}

    def _clip(self, clip: TouchClip) -> bytes:
        return write_avi([self._encode(frame) for frame in clip.frames()], self.width, self.height, clip.fps)

    def _encode(self, pixels: Pixels) -> bytes:
        return encode_image(resized(pixels, self.width, self.height), "jpeg", self.quality)


@dataclass(frozen=True)
class KeepTouches:
    """Step of ``select``; where rounds lose touches, they differ in length."""

    some_touches: bool

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the schema of the source; where rounds differ, lists over touches have no fixed length.

        Rounds that lose touches keep the height of their plate: the touches that showed it may be gone.
        """
        if not self.some_touches:
            return source
        fields = [
            pa.field(field.name, pa.list_(field.type.value_type))
            if is_per_touch(field.name, field.type)
            else field
            for field in source
        ]
        if column_type(source, PLATE_COLUMN) is None:
            fields.append(pa.field(PLATE_COLUMN, pa.float64()))
        return pa.schema(fields)

    def apply(self, row: Row, choice: RowChoice, split: str) -> Made:
        """Pass a row on, with the touches chosen; no image or clip is decoded."""
        flat = flat_row(row)
        if choice.touches is None:
            return flat, {}
        kept = take_touches(flat, choice.touches, touch_total(row))
        if row.has(PLATE_COLUMN):
            return kept, {}
        kind: Kind = "single" if row.has(MEDIA_COLUMN["single"]) else "seq"
        plate_m = plate_z_m(row)
        if math.isnan(plate_m):
            plate_m = contact_z_m(row, kind).min(initial=np.inf)
        return kept.append_column(PLATE_COLUMN, pa.array([plate_m], pa.float64())), {}
