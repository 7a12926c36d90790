"""The picture that stands for each touch of a round, as plain image files with an index: for ``frames``."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import pyarrow as pa

from realtouch.changes import difference
from realtouch.columns.per_touch import int_value, intended_positions, plain_value
from realtouch.contact import ContactMethod
from realtouch.convert.plan import Made, RowChoice, Source
from realtouch.convert.shown import Shown, shown_touches
from realtouch.damage import damaged
from realtouch.dataset import dataset_of
from realtouch.integrity.files import write_changed
from realtouch.preprocess import background
from realtouch.rounds import TouchSingleRound
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.names import problem_of_name
from tactile_toolkit.store.parquet import sha256_hex
from tactile_toolkit.touch.jpeg import IMAGE_SUFFIX, ImageFormat, Pixels, encode_image
from tactile_toolkit.touch.schema import CLASS_NAMES

IMAGE_FOLDER = "images"
INDEX_FILE = "index.csv"
POSITION_COLUMNS = ("pos_in_cell_x_m", "pos_in_cell_y_m")
POSE_COLUMNS = ("gel_x_m", "gel_y_m", "gel_z_m", "gel_qx", "gel_qy", "gel_qz", "gel_qw")

Repeated = Mapping[str, frozenset[int]]
"""The rows of each split whose id stands in a row before them."""

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


def require_first(row: Row, choice: RowChoice, split: str, repeated: Repeated) -> None:
    """Refuse a round whose id stands in an earlier one of its split: their files would have one name."""
    if choice.row in repeated.get(split, ()):
        problem = f"{row.value('id')!r} stands in an earlier round of split {split!r} too"
        raise damaged(row, "id", f"{problem}; expected ids that differ")


def repeated_ids(source: Source, choices: Mapping[str, Sequence[RowChoice]]) -> dict[str, frozenset[int]]:
    """Find the rows of each split whose id stands in a row before them; reads the column of ids only."""
    repeated = {}
    for split, chosen in choices.items():
        ids = dataset_of(source.shards[split], source.kind).ids
        first: dict[Any, int] = {}
        repeated[split] = frozenset(row for row, _ in chosen if first.setdefault(ids[row], row) != row)
    return repeated


@dataclass(frozen=True)
class WritePictures:
    """Step of ``frames``: gives the pictures of a row, and their lines of the index.

    Stored JPEGs pass through as they are. With ``difference``, pictures are what differs from the background:
    the median of the clip, or of the images of the round. ``names`` are those of the classes.
    """

    kind: ImageFormat
    method: ContactMethod
    difference: Literal["grey", "absolute"] | None = None
    repeated: Repeated = field(default_factory=dict, repr=False)
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
        require_first(row, choice, split, self.repeated)
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
