"""Touches as plain image files with an index, for tools that know no Parquet."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import pyarrow as pa

from realtouch.columns.per_touch import vectors
from realtouch.contact import ContactMethod
from realtouch.convert.plan import RowChoice, RowChoices, Source, WithFiles
from realtouch.convert.steps import contact_frame_of
from realtouch.damage import damaged
from realtouch.dataset import dataset_of
from realtouch.preprocess import background, difference
from realtouch.rounds import TouchSeqRound, TouchSingleRound
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.names import problem_of_name
from tactile_toolkit.store.parquet import is_unchanged, sha256_hex
from tactile_toolkit.store.shards import ShardRecord
from tactile_toolkit.touch.jpeg import IMAGE_SUFFIX, ImageFormat, Pixels, encode_image
from tactile_toolkit.touch.schema import CLASS_NAMES, POSE_COLUMN

__all__ = [
    "IMAGE_FOLDER",
    "INDEX_FILE",
    "WritePictures",
    "pictures_are_whole",
    "repeated_ids",
    "write_index",
]

IMAGE_FOLDER = "images"
INDEX_FILE = "index.csv"

_NUMBER_COLUMNS = (
    "pos_in_cell_x_m",
    "pos_in_cell_y_m",
    "gel_x_m",
    "gel_y_m",
    "gel_z_m",
    "gel_qx",
    "gel_qy",
    "gel_qz",
    "gel_qw",
)
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
        *((name, pa.float64()) for name in _NUMBER_COLUMNS),
    ]
)

_JPEG_START = b"\xff\xd8"


@dataclass(frozen=True)
class WritePictures:
    """Step of ``frames``: gives the pictures of a row, and their lines of the index.

    Stored JPEGs pass through as they are. With ``difference``, pictures are what differs from the background:
    the median of the clip, or of the images of the round. ``repeated``: see :func:`repeated_ids`. ``names``
    are those of the classes.
    """

    kind: ImageFormat
    method: ContactMethod
    difference: Literal["grey", "absolute"] | None = None
    repeated: Mapping[str, frozenset[int]] = field(default_factory=dict, repr=False)
    names: tuple[str, ...] = CLASS_NAMES

    def schema(self, source: Any) -> pa.Schema:
        """Return the columns of the index; classes have names in it where those are not the digits."""
        named = pa.field("label_name", pa.string())
        return _INDEX_SCHEMA if self.names == CLASS_NAMES else _INDEX_SCHEMA.append(named)

    def apply(self, row: Row, choice: RowChoice, split: str) -> WithFiles:
        """Return the lines of the index of a row, and its pictures.

        A row with a damaged touch, or whose id cannot name a folder of its own, is left out with all of its
        pictures.
        """
        if choice.row in self.repeated.get(split, ()):
            problem = f"{row.value('id')!r} stands in an earlier round of split {split!r} too"
            raise damaged(row, "id", f"{problem}; expected ids that differ")
        record = TouchSingleRound(row) if row.has("sensor_image") else TouchSeqRound(row)
        folder = f"{IMAGE_FOLDER}/{split}/{_folder_name(row, record.id)}"
        base = None
        if self.difference is not None and isinstance(record, TouchSingleRound) and record.touch_count:
            # Of the whole round, once; a clip has a background of its own.
            base = background(record)
        made = [self._picture(record, touch, folder, base) for touch in range(record.touch_count)]
        rows = pa.Table.from_pylist([line for line, _ in made], schema=self.schema(None))
        return WithFiles(rows, {line["file"]: encoded for line, encoded in made})

    def _picture(
        self, record: TouchSingleRound | TouchSeqRound, touch: int, folder: str, base: Pixels | None
    ) -> tuple[dict[str, Any], bytes]:
        row = record._row
        if isinstance(record, TouchSingleRound):
            encoded, frame, pose = self._single(record, touch, base)
        else:
            encoded, frame, pose = self._seq(record, touch)
        file = f"{folder}/{touch:03d}.{IMAGE_SUFFIX[self.kind]}"
        position = vectors(row, "pos_in_cell", 2)[touch] if row.has("pos_in_cell") else [None, None]
        numbers = dict(zip(_NUMBER_COLUMNS, [*position, *pose], strict=True))
        line = {
            "id": f"{record.id}/{touch:03d}",
            "file": file,
            "sha256": sha256_hex(encoded),
            "round_id": record.id,
            "touch": touch,
            "frame": frame,
            "label": record.label,
            "label_name": dict(enumerate(self.names)).get(record.label),
            "object_id": record.object_id if row.has("object_id") else None,
            **numbers,
        }
        return line, encoded

    def _single(
        self, record: TouchSingleRound, touch: int, base: Pixels | None
    ) -> tuple[bytes, int, list[Any]]:
        images = record.sensor_image
        encoded = self._encoded(images[touch], images.encoded(touch), base)
        if not record._row.has(f"{POSE_COLUMN['single']}.position"):
            return encoded, 0, [None] * 7
        pose = record.gel_pose_cell_frame
        return encoded, 0, [*pose.position_m[touch], *pose.quaternion[touch]]

    def _seq(self, record: TouchSeqRound, touch: int) -> tuple[bytes, int, list[Any]]:
        clip = record.sensor_video[touch]
        frame = contact_frame_of(clip, self.method)
        pose = clip.poses
        base = None if self.difference is None else background(clip)
        encoded = self._encoded(clip[frame], clip.encoded(frame) if clip.has_index else b"", base)
        return encoded, frame, [*pose.position_m[frame], *pose.quaternion[frame]]

    def _encoded(self, pixels: Pixels, stored: bytes | memoryview, base: Pixels | None) -> bytes:
        """Return the file of a picture that was decoded whole; a JPEG stays as it is stored."""
        if base is not None and self.difference is not None:
            return encode_image(difference(pixels, base, self.difference), self.kind)
        if self.kind == "jpeg" and bytes(stored[:2]) == _JPEG_START:
            return bytes(stored)
        return encode_image(pixels, self.kind)


def repeated_ids(source: Source, choices: Mapping[str, RowChoices]) -> dict[str, frozenset[int]]:
    """Find the rows of each split whose id stands in a row before them; reads the column of ids only."""
    repeated = {}
    for split, chosen in choices.items():
        ids = dataset_of(source.shards[split], source.kind).ids
        first: dict[Any, int] = {}
        rows = np.asarray(chosen.rows).tolist()
        repeated[split] = frozenset(row for row in rows if first.setdefault(ids[row], row) != row)
    return repeated


def pictures_are_whole(folder: DataFolder, record: ShardRecord, reads: bool) -> bool:
    """Tell whether every picture that a finished shard lists is there, unchanged."""
    # By checksum, not by size: pictures are files that people open and save.
    table = Shard(folder.address(record.shard.data_path)).read(columns=["file", "sha256"])
    return all(is_unchanged(folder, line["file"], line["sha256"], reads) for line in table.to_pylist())


def _folder_name(row: Row, name: str) -> str:
    """Return the id of a round as the name of its folder: one that leads nowhere else on any system."""
    problem = "has slashes" if "/" in name else problem_of_name(name)
    if problem:
        shown = name if len(name) <= 80 else f"{name[:80]}..."
        raise damaged(row, "id", f"{shown!r} cannot name a folder: it {problem}")
    return name


def write_index(folder: DataFolder, manifest: Manifest) -> dict[str, str]:
    """Write the index of all pictures as ``index.csv`` and return its checksum by its path."""
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    header: list[str] = []
    for record in manifest.shards:
        table = Shard(folder.address(record.shard.data_path)).read()
        if not header:
            header = ["split", *table.column_names]
            writer.writerow(header)
        writer.writerows([record.shard.split, *line.values()] for line in table.to_pylist())
    content = stream.getvalue().encode()
    # Only where it differs: a run over a finished set changes nothing.
    if not folder.exists(INDEX_FILE) or folder.read_bytes(INDEX_FILE) != content:
        folder.write_bytes(INDEX_FILE, content)
    return {INDEX_FILE: sha256_hex(content)}
