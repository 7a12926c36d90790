"""One row a touch: the stored image as it is, and plain columns that every reader of tables knows."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa

from realtouch.columns.per_touch import entries_of, int_value, intended_positions, plain_value, touch_total
from realtouch.columns.poses import clip_poses, poses
from realtouch.contact import ContactMethod
from realtouch.convert.plan import RowChoice
from realtouch.convert.steps import contact_frame_of
from realtouch.damage import damaged
from realtouch.media.clips import TouchClip
from realtouch.media.images import SensorImages
from realtouch.touch import touch_id
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.touch.jpeg import decode_image, encode_image, image_size
from tactile_toolkit.touch.schema import MEDIA_TYPE, column_type

__all__ = [
    "IMAGE",
    "POSE_COLUMNS",
    "POSITION_COLUMNS",
    "FlatTouches",
    "image_suffix",
    "known_label",
    "require_whole",
]

IMAGE = "image"
POSITION_COLUMNS = ("pos_in_cell_x_m", "pos_in_cell_y_m")
POSE_COLUMNS = ("gel_x_m", "gel_y_m", "gel_z_m", "gel_qx", "gel_qy", "gel_qz", "gel_qw")

_POSE = "gel_pose_cell_frame"
_JPEG = b"\xff\xd8"
_JPEG_END = b"\xff\xd9"
_NAME = re.compile(r"[A-Za-z0-9_-]{1,80}")


def require_whole(data: bytes | memoryview) -> tuple[int, int]:
    """Return height and width of an image that begins and ends as a whole one does.

    The pixels of a JPEG are not decoded: that alone would take longer than all other work. Raises ValueError.
    """
    size = image_size(data)
    if data[:2] != _JPEG:
        decode_image(data)
    # Encoders of clips fill up to even lengths.
    elif bytes(data[-2:]) != _JPEG_END and not bytes(data[-16:]).rstrip(b"\0").endswith(_JPEG_END):
        message = f"an image of {len(data):,} bytes without the mark of its end; expected a whole JPEG"
        raise ValueError(message)
    return size


def known_label(row: Row, names: tuple[str, ...]) -> int:
    """Return the label of a row; IntegrityError where it is not one of the named classes."""
    label = int_value(row, "label")
    if label >= len(names):
        raise damaged(row, "label", f"the value is {label}; expected less than {len(names)}, the classes")
    return label


def image_suffix(image: bytes | memoryview) -> str:
    """Return the ending that the file of an image has."""
    return "jpg" if image[:2] == _JPEG else "png" if image[:4] == b"\x89PNG" else "webp"


@dataclass(frozen=True)
class FlatTouches:
    """Step of ``export``: a row becomes one row for each touch; of clips, with the frame of the contact.

    JPEGs pass through as they are stored. ``names`` are those of the classes; ``repeated``: see
    :func:`realtouch.convert.image_files.repeated_ids`.
    """

    method: ContactMethod
    names: tuple[str, ...]
    repeated: Mapping[str, frozenset[int]] = field(default_factory=dict, repr=False)

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return plain columns: of what the source says, and nothing that it does not."""
        has_object = column_type(source, "object_id") is not None
        has_position = column_type(source, "pos_in_cell") is not None
        has_pose = any(
            column_type(source, f"{name}.position") is not None for name in (_POSE, f"{_POSE}_seq")
        )
        return pa.schema(
            [
                ("id", pa.string()),
                (IMAGE, MEDIA_TYPE),
                ("label", pa.int64()),
                ("label_name", pa.string()),
                *([("object_id", pa.int64())] if has_object else []),
                ("round_id", pa.string()),
                ("touch", pa.int64()),
                ("frame", pa.int64()),
                *((name, pa.float64()) for name in POSITION_COLUMNS if has_position),
                *((name, pa.float64()) for name in POSE_COLUMNS if has_pose),
            ]
        )

    def apply(self, row: Row, choice: RowChoice, split: str) -> pa.Table:
        """Return the touches of a row; one damaged touch leaves the round out, so that none is half there."""
        name = str(plain_value(row, "id"))
        if choice.row in self.repeated.get(split, ()):
            problem = f"{name!r} stands in an earlier round of split {split!r} too; expected ids that differ"
            raise damaged(row, "id", problem)
        if _NAME.fullmatch(name) is None:
            problem = f"{name[:80]!r} cannot name files; expected letters, digits, '-' and '_'"
            raise damaged(row, "id", problem)
        count = touch_total(row)
        taken = self._single(row, count) if row.has("sensor_image") else self._seq(row, count)
        images, frames, pose = taken
        label = known_label(row, self.names)
        paths = [f"{touch_id(name, touch)}.{image_suffix(image)}" for touch, image in enumerate(images)]
        columns: dict[str, Any] = {
            "id": [path.partition(".")[0] for path in paths],
            IMAGE: pa.StructArray.from_arrays(
                [pa.array(images, pa.binary()), pa.array(paths)], fields=list(MEDIA_TYPE)
            ),
            "label": np.full(count, label),
            "label_name": [self.names[label]] * count,
            "round_id": [name] * count,
            "touch": np.arange(count),
            "frame": frames,
        }
        if row.has("object_id"):
            columns["object_id"] = np.full(count, int_value(row, "object_id"))
        if row.has("pos_in_cell"):
            columns |= dict(zip(POSITION_COLUMNS, intended_positions(row).T, strict=True))
        if pose is not None:
            columns |= dict(zip(POSE_COLUMNS, pose.T, strict=True))
        schema = self.schema(row.group.table.schema)
        return pa.table([pa.array(columns[each.name], each.type) for each in schema], schema=schema)

    def _single(self, row: Row, count: int) -> tuple[list[memoryview], list[int], Any]:
        entries_of(row, "sensor_image")  # refuses a round with more or less than T images
        stored = SensorImages(row)
        images = [stored.encoded(touch) for touch in range(count)]
        for touch, image in enumerate(images):
            try:
                require_whole(image)
            except ValueError as error:
                raise damaged(row, "sensor_image", str(error), touch) from error
        if not row.has(f"{_POSE}.position"):
            return images, [0] * count, None
        pose = poses(row)
        return images, [0] * count, np.hstack([pose.position_m, pose.quaternion])

    def _seq(self, row: Row, count: int) -> tuple[list[Any], list[int], Any]:
        images, frames, found = [], [], [np.empty((0, 7))]
        has_pose = row.has(f"{_POSE}_seq.position")
        for touch in range(count):
            clip = TouchClip(row, touch)
            frame = contact_frame_of(clip, self.method)
            images.append(_whole_frame(row, clip, frame))
            frames.append(frame)
            if has_pose:
                pose = clip_poses(row, touch)
                found.append(np.hstack([pose.position_m[frame], pose.quaternion[frame]])[None])
        return images, frames, np.concatenate(found) if has_pose else None


def _whole_frame(row: Row, clip: TouchClip, frame: int) -> bytes | memoryview:
    """Return the image of a frame: as it is stored, and encoded where the clip holds no images."""
    if not clip.has_index:
        return encode_image(clip[frame])
    data = clip.encoded(frame)
    try:
        require_whole(data)
    except ValueError as error:
        raise damaged(row, "sensor_video", f"frame {frame}: {error}", clip.touch) from error
    return data
