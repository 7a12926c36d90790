"""What ``clips-to-images``, ``resize``, ``select`` and ``frames`` do to one row."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from realtouch.clip_columns import contact_z_m, plate_z_m, pose_sequences, poses
from realtouch.clips import SensorClips, TouchClip
from realtouch.columns import entries_of, int_value, intended_positions, plain_value, touch_total, vectors
from realtouch.contact import ContactMethod, difference
from realtouch.convert.plan import Made, RowChoice, write_changed
from realtouch.damage import damaged
from realtouch.images import SensorImages
from realtouch.preprocess import background
from realtouch.rounds import TouchSingleRound
from realtouch.spec import POSE_COLUMNS, POSITION_COLUMNS
from tactile_toolkit.errors import InputError
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.names import problem_of_name
from tactile_toolkit.store.parquet import sha256_hex
from tactile_toolkit.touch.contact import PLATE_COLUMN
from tactile_toolkit.touch.jpeg import IMAGE_SUFFIX, ImageFormat, Pixels, encode_image, resized
from tactile_toolkit.touch.schema import (
    CLASS_NAMES,
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


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """The picture that stands for a touch, and the pose of the gel then.

    ``stored`` is its file, None where a clip does not hold images; ``pose`` are position and quaternion,
    seven numbers, None where there are no poses; ``clip`` is what a frame was taken from.
    """

    touch: int
    frame: int
    stored: memoryview | None
    decode: Callable[[], Pixels]
    pose: NDArray[np.floating] | None
    clip: TouchClip | None = None


def shown_touches(row: Row, method: ContactMethod) -> Iterator[Shown]:
    """Yield the picture of each touch of a round: its image, or the frame of its clip by some method."""
    count = touch_total(row)
    if row.has("sensor_image"):
        entries_of(row, "sensor_image")  # refuses a round with more or less than T images
        images, found = SensorImages(row), None
        if row.has(f"{POSE_COLUMN['single']}.position"):
            stored = poses(row)
            found = np.hstack([stored.position_m, stored.quaternion])
        for touch in range(count):
            pose = None if found is None else found[touch]
            yield Shown(touch, 0, images.encoded(touch), partial(images.__getitem__, touch), pose)
        return
    has_pose = row.has(f"{POSE_COLUMN['seq']}.position")
    for touch in range(count):
        clip = TouchClip(row, touch)
        frame = clip.contact_index(method)
        pose = None
        if has_pose:
            (at,) = pose_sequences(row, touch)
            pose = np.hstack([at.position_m[frame], at.quaternion[frame]])
        data = clip.encoded(frame) if clip.has_index else None
        yield Shown(touch, frame, data, partial(clip.__getitem__, frame), pose, clip)


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
    """Step of ``clips-to-images``: one frame of each clip, with the pose of the gel at that moment."""

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


IMAGE_FOLDER = "images"
INDEX_FILE = "index.csv"

_JPEG_START = b"\xff\xd8"
_INDEX_SCHEMA = pa.schema(
    [
        ("id", pa.string()),
        ("file", pa.string()),
        ("sha256", pa.string()),
        ("round_id", pa.string()),
        ("touch", pa.int64()),
        ("frame", pa.int64()),
        ("label", pa.int64()),
        ("object_id", pa.int64()),
        *((name, pa.float64()) for name in (*POSITION_COLUMNS, *POSE_COLUMNS)),
    ]
)


def columns_of_touches(row: Row, shown: Sequence[Shown], names: Sequence[str]) -> dict[str, Any]:
    """Return what a table says of the touches of a round, by column; only of what the source stores."""
    label, count = int_value(row, "label"), len(shown)
    columns: dict[str, Any] = {
        "label": np.full(count, label),
        "label_name": [names[label] if label < len(names) else None] * count,
        "round_id": [str(plain_value(row, "id"))] * count,
        "touch": np.arange(count),
        "frame": [each.frame for each in shown],
    }
    if row.has("object_id"):
        columns["object_id"] = np.full(count, int_value(row, "object_id"))
    if row.has("pos_in_cell"):
        columns |= dict(zip(POSITION_COLUMNS, intended_positions(row).T, strict=True))
    found = [each.pose for each in shown if each.pose is not None]
    if len(found) == count:
        columns |= dict(zip(POSE_COLUMNS, np.reshape(found, (count, 7)).T, strict=True))
    return columns


@dataclass(frozen=True)
class WritePictures:
    """Step of ``frames``: gives the pictures of a row, and their lines of the index.

    Stored JPEGs pass through as they are. With ``difference``, pictures are what differs from the background:
    the median of the clip, or of the images of the round. ``names`` are those of the classes.
    """

    kind: ImageFormat
    method: ContactMethod
    difference: Literal["grey", "absolute"] | None = None
    names: tuple[str, ...] = CLASS_NAMES

    def schema(self, source: Any) -> pa.Schema:
        """Return the columns of the index; classes have names in it where those are not the digits."""
        named = pa.field("label_name", pa.string())
        return _INDEX_SCHEMA if self.names == CLASS_NAMES else _INDEX_SCHEMA.append(named)

    def apply(self, row: Row, choice: RowChoice, split: str) -> Made:
        """Return the lines of the index of a row, and its pictures.

        A row with a damaged touch, or whose id cannot name a folder of its own, is left out with all of its
        pictures.
        """
        name = _folder_name(row)
        shown = list(shown_touches(row, self.method))
        base = None
        if self.difference is not None and row.has("sensor_image") and shown:
            # Of a round of images, once; a clip has a background of its own.
            base = background(TouchSingleRound(row))
        folder, suffix = f"{IMAGE_FOLDER}/{split}/{name}", IMAGE_SUFFIX[self.kind]
        files = {f"{folder}/{each.touch:03d}.{suffix}": self._encoded(each, base) for each in shown}
        columns = {
            **columns_of_touches(row, shown, self.names),
            "id": [f"{name}/{each.touch:03d}" for each in shown],
            "file": list(files),
            "sha256": list(map(sha256_hex, files.values())),
        }
        nulls = [None] * len(shown)
        schema = self.schema(None)
        rows = [pa.array(columns.get(each.name, nulls), each.type) for each in schema]
        return pa.table(rows, schema=schema), files

    def _encoded(self, shown: Shown, base: Pixels | None) -> bytes:
        """Return the file of a picture, which is decoded in any case: what is passed on must be intact."""
        pixels = shown.decode()
        if self.difference is not None:
            base = background(shown.clip) if base is None else base
            return encode_image(difference(pixels, base, self.difference), self.kind)
        if self.kind == "jpeg" and shown.stored is not None and shown.stored[:2] == _JPEG_START:
            return bytes(shown.stored)
        return encode_image(pixels, self.kind)


def _folder_name(row: Row) -> str:
    """Return the id of a round as the name of its folder: one that leads nowhere else on any system."""
    name = str(plain_value(row, "id"))
    problem = "has slashes" if "/" in name else problem_of_name(name)
    if problem:
        shown = name if len(name) <= 80 else f"{name[:80]}..."
        raise damaged(row, "id", f"{shown!r} cannot name a folder: it {problem}")
    return name


def write_index(folder: DataFolder, manifest: Manifest) -> dict[str, str]:
    """Write the index of all pictures as ``index.csv`` and return its checksum by its path."""
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    for number, record in enumerate(manifest.shards):
        table = Shard(folder.address(record.shard.data_path)).read()
        if number == 0:
            writer.writerow(["split", *table.column_names])
        writer.writerows([record.shard.split, *line.values()] for line in table.to_pylist())
    content = stream.getvalue().encode()
    return {INDEX_FILE: write_changed(folder, INDEX_FILE, content)}
