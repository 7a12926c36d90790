"""Touches as plain image files with an index, for tools that know no Parquet."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, replace
from typing import Any, Literal

from dataset_store.manifest import Manifest, write_manifest
from dataset_store.records import Row
from dataset_store.rowgroups import Shard
from dataset_store.shards import sha256_hex
from dataset_store.storage import DataFolder
from realtouch.clips import SensorClips
from realtouch.contact import ContactMethod
from realtouch.conversion import RowChoice
from realtouch.fields import clip_poses, poses, touch_total, vectors
from realtouch.images import SensorImages
from realtouch.jpeg import decode_image, encode_image
from realtouch.rounds import TouchSeqRound, TouchSingleRound
from realtouch.snapshots import snapshot_frame, snapshot_jpeg

__all__ = ["IMAGE_FOLDER", "INDEX_FILE", "WritePictures", "write_index"]

IMAGE_FOLDER = "images"
INDEX_FILE = "index.csv"


@dataclass(frozen=True)
class WritePictures:
    """Step of ``frames``: writes the pictures of a row, and gives their lines of the index.

    Attributes
    ----------
    folder : DataFolder
        Where the pictures go.
    kind : "png" or "jpeg"
        Their format. Stored JPEGs pass through as they are.
    method : str
        Which frame of a clip.
    """

    folder: DataFolder
    kind: Literal["png", "jpeg"]
    method: ContactMethod

    def schema(self, source: Any) -> Any:
        """Return the columns of the index."""
        import pyarrow as pa

        numbers = [(name, pa.float64()) for name in _NUMBER_COLUMNS]
        return pa.schema(
            [
                ("id", pa.string()),
                ("file", pa.string()),
                ("sha256", pa.string()),
                ("round_id", pa.string()),
                ("touch", pa.int64()),
                ("frame", pa.int64()),
                ("label", pa.int64()),
                ("object_id", pa.int64()),
                *numbers,
            ]
        )

    def apply(self, row: Row, choice: RowChoice, split: str) -> Any:
        """Write the pictures of a row and return its lines of the index.

        A row with a damaged touch is left out as a whole: none of its pictures is written.
        """
        import pyarrow as pa

        made = [self._picture(row, touch, split) for touch in range(touch_total(row))]
        for line, encoded in made:
            self.folder.write_bytes(line["file"], encoded)
        return pa.Table.from_pylist([line for line, _ in made], schema=self.schema(None))

    def _picture(self, row: Row, touch: int, split: str) -> tuple[dict[str, Any], bytes]:
        record = TouchSingleRound(row) if row.has("sensor_image") else TouchSeqRound(row)
        encoded, frame, pose = self._single(row, touch) if row.has("sensor_image") else self._seq(row, touch)
        suffix = "png" if self.kind == "png" else "jpg"
        file = f"{IMAGE_FOLDER}/{split}/{record.id}/{touch:03d}.{suffix}"
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
            "object_id": record.object_id,
            **numbers,
        }
        return line, encoded

    def _single(self, row: Row, touch: int) -> tuple[bytes, int, list[Any]]:
        encoded = self._encoded(SensorImages(row).encoded(touch))
        if not row.has("gel_pose_cell_frame.position"):
            return encoded, 0, [None] * 7
        pose = poses(row)
        return encoded, 0, [*pose.position_m[touch], *pose.quaternion[touch]]

    def _seq(self, row: Row, touch: int) -> tuple[bytes, int, list[Any]]:
        clip = SensorClips(row)[touch]
        frame = snapshot_frame(clip, self.method)
        pose = clip_poses(row, touch)
        return (
            self._encoded(snapshot_jpeg(clip, frame)),
            frame,
            [*pose.position_m[frame], *pose.quaternion[frame]],
        )

    def _encoded(self, stored: bytes | memoryview) -> bytes:
        if self.kind == "png":
            return encode_image(decode_image(stored), "png")
        return bytes(stored) if bytes(stored[:2]) == b"\xff\xd8" else encode_image(decode_image(stored))


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


def write_index(folder: DataFolder, manifest: Manifest) -> Manifest:
    """Write the index of all pictures as ``index.csv`` and vouch for it in the manifest."""
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    header: list[str] = []
    for receipt in manifest.receipts:
        table = Shard(folder.address(receipt.shard.data_path)).read()
        if not header:
            header = ["split", *table.column_names]
            writer.writerow(header)
        writer.writerows([receipt.shard.split, *line.values()] for line in table.to_pylist())
    content = stream.getvalue().encode()
    if not folder.exists(INDEX_FILE) or folder.read_bytes(INDEX_FILE) != content:
        folder.write_bytes(INDEX_FILE, content)
    complete = replace(manifest, files={**(manifest.files or {}), INDEX_FILE: sha256_hex(content)})
    if complete != manifest:
        write_manifest(folder, complete)
    return complete
