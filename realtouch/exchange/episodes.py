"""Episodes: every frame of each clip, or of single images the touches of each round, numbered without gaps.

Readers of such formats find episodes by their position, so that none may be missing, and frames are counted
before they are read.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from realtouch.clip_columns import pose_sequences, poses, stamps_s
from realtouch.clips import TouchClip
from realtouch.columns import (
    entries_of,
    int_value,
    intended_positions,
    label_value,
    plain_value,
    stored_rows,
    touch_total,
)
from realtouch.convert.plan import Choices, Made, RowChoice, Source
from realtouch.damage import naming
from realtouch.dataset import dataset_of
from realtouch.exchange.images import image_column, require_intact
from realtouch.images import SensorImages
from realtouch.poses import Poses
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.read.columns import class_names
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.store.shards import ShardName, Skipped
from tactile_toolkit.touch.jpeg import encode_image
from tactile_toolkit.touch.schema import CLASS_NAMES, MEDIA_COLUMN, MEDIA_TYPE, POSE_COLUMN, column_type

IMAGE, STATE, ACTION, TIME = "observation.images.tactile", "observation.state", "action", "time_s"
_POSES = {kind: f"{name}.position" for kind, name in POSE_COLUMN.items()}


def only_split(source: Source, choices: Choices, what: str) -> str:
    """Return the one split that is exported; InputError for several."""
    if len(choices) > 1:
        raise InputError(
            f"{source.name!r} has the splits {', '.join(choices)}; a {what} holds one",
            next=f"add --split {next(iter(choices))}",
        )
    return next(iter(choices))


def numbered_starts(
    source: Source, split: str, chosen: Sequence[RowChoice], rows_per_shard: int
) -> list[list[int]]:
    """Return the numbers of the first episode and frame of each shard, and of one more.

    InputError where there is none.
    """
    counts = _episode_lengths(source, split)[[each.row for each in chosen]]
    if not counts.sum():
        raise InputError(f"{source.name!r} has no touches in split {split!r}", next="choose another split")
    ends = np.concatenate([np.zeros((1, 2), np.int64), np.cumsum(counts, axis=0)])
    starts: list[list[int]] = ends[[*range(0, len(chosen), rows_per_shard), len(chosen)]].tolist()
    return starts


def numbers_of_shard(
    starts: Sequence[Sequence[int]], shard: ShardName, rows: pa.Table, skipped: Sequence[Skipped]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return the number of each episode of a shard, of its first frame, and how many frames it has.

    Raises IntegrityError where a round was left out, or lengths were not as stated.
    """
    if skipped:
        raise IntegrityError(
            f"{skipped[0].message}; episodes are numbered without gaps, so that none can be left out; "
            "nothing of this file was written",
            next="leave the round out first (`realtouch select`)",
        )
    episode, frame = starts[shard.index]
    firsts = np.flatnonzero(rows["frame_index"].to_numpy() == 0)
    if starts[shard.index + 1] != [episode + len(firsts), frame + len(rows)]:
        raise IntegrityError(
            f"{shard}: {len(firsts):,} episodes of {len(rows):,} frames in all, other than "
            "'video_length_frames' stated when the export was planned; nothing of this file was written",
            next="run `realtouch verify` on the source",
        )
    return episode + np.arange(len(firsts)), frame + firsts, np.diff([*firsts, len(rows)])


@dataclass(frozen=True)
class Episodes:
    """Step of the export: the frames of the episodes of a row, numbered within each."""

    fps: int
    size: tuple[int, int]
    names: tuple[str, ...]

    @classmethod
    def of(cls, source: Source, split: str) -> Episodes:
        """Look at the first image of a split: all are to be of its size."""
        size, fps = _first_image(source.shards[split])
        return cls(fps, size, class_names(source.schema, CLASS_NAMES))

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the columns that the source can fill, and what the index says of episodes."""
        wanted = {
            "id": (pa.string(), ("id",)),
            "round_id": (pa.string(), ("id",)),
            "touch": (pa.int64(), ("sensor_video",)),
            IMAGE: (MEDIA_TYPE, ("sensor_video", "sensor_image")),
            STATE: (pa.list_(pa.float32(), 7), tuple(_POSES.values())),
            ACTION: (pa.list_(pa.float32(), 2), ("pos_in_cell",)),
            TIME: (pa.float32(), ("time_stamp_rel_seq",)),
            "label": (pa.int64(), ("label",)),
            "object_id": (pa.int64(), ("object_id",)),
            "timestamp": (pa.float32(), ("id",)),
            "frame_index": (pa.int64(), ("id",)),
        }
        return pa.schema(
            (name, data_type)
            for name, (data_type, columns) in wanted.items()
            if any(column_type(source, each) is not None for each in columns)
        )

    def apply(self, row: Row, choice: RowChoice, split: str) -> Made:
        """Return all frames of a row."""
        name, label = str(plain_value(row, "id")), label_value(row, self.names)
        object_id = int_value(row, "object_id") if row.has("object_id") else 0
        places = intended_positions(row) if row.has("pos_in_cell") else None
        schema = self.schema(row.group.table.schema)
        tables = [schema.empty_table()]
        for touch, images, columns in self._episodes(row):
            for number, image in enumerate(images):
                self._require_size(row, number if touch is None else touch, image)
            count, start = len(images), f"{name}_{touch or 0:03d}"
            if places is not None:
                columns[ACTION] = _vectors(places if touch is None else np.tile(places[touch], (count, 1)))
            image_names = [f"{start}_{frame:04d}" for frame in range(count)]
            columns |= {
                "id": image_names,
                "round_id": [name] * count,
                "touch": [touch] * count,
                IMAGE: image_column(images, image_names),
                "label": np.full(count, label),
                "object_id": np.full(count, object_id),
                "timestamp": (np.arange(count) / self.fps).astype(np.float32),
                "frame_index": np.arange(count),
            }
            arrays = [pa.array(columns[each.name], each.type) for each in schema]
            tables.append(pa.table(arrays, schema=schema))
        return pa.concat_tables(tables), {}

    def _episodes(self, row: Row) -> Iterator[tuple[int | None, list[Any], dict[str, Any]]]:
        """Yield each episode: its touch (None: all of the round), its images, and poses and times."""
        if row.has("sensor_image"):
            entries_of(row, "sensor_image")
            stored = SensorImages(row)
            if len(stored):
                images = [stored.encoded(touch) for touch in range(len(stored))]
                yield None, images, {STATE: _states(poses(row))} if row.has(_POSES["single"]) else {}
            return
        for touch in range(touch_total(row)):
            clip, columns = TouchClip(row, touch), dict[str, Any]()
            if row.has(_POSES["seq"]):
                columns[STATE] = _states(pose_sequences(row, touch)[0])
            times_s = stamps_s(row, touch)
            if times_s is not None:
                columns[TIME] = times_s[0].astype(np.float32)
            if clip.has_index:
                yield touch, [clip.encoded(frame) for frame in range(len(clip))], columns
            else:
                yield touch, [encode_image(pixels) for pixels in clip.frames()], columns

    def _require_size(self, row: Row, touch: int, image: bytes | memoryview) -> None:
        with naming(row, MEDIA_COLUMN["single" if row.has("sensor_image") else "seq"], touch):
            height, width = require_intact(image)
        if (height, width) != self.size:
            raise InputError(
                f"{row.path!r}, row {row.number}, touch {touch}: an image of {width} x {height} pixels; "
                f"expected {self.size[1]} x {self.size[0]} as in the first touch: episodes have images of "
                "one size",
                next="make them alike with `realtouch resize`",
            )


def _states(pose: Poses) -> pa.Array:
    return _vectors(np.hstack([pose.position_m, pose.quaternion]))


def _vectors(values: NDArray[Any]) -> pa.Array:
    flat = np.ascontiguousarray(values, np.float32).reshape(-1)
    return pa.FixedSizeListArray.from_arrays(pa.array(flat), values.shape[1])


def _episode_lengths(source: Source, split: str) -> NDArray[np.int64]:
    """Return the number of episodes and of frames of each row, shape (n, 2)."""
    if source.kind == "single":
        counts = dataset_of(source.shards[split]).touch_counts
        return np.column_stack([counts > 0, counts]).astype(np.int64)
    found = []
    for shard in source.shards[split]:
        if "video_length_frames" not in shard.types:
            raise InputError(f"{shard.path!r} has no column 'video_length_frames'")
        lengths = shard.read(columns=["video_length_frames"]).column(0).to_pylist()
        found += [(len(each), sum(each)) for each in lengths]
    return np.array(found, np.int64).reshape(-1, 2)


def _first_image(shards: Sequence[Shard]) -> tuple[tuple[int, int], int]:
    """Return height and width of the first image, and the frames per second; 1 of single images."""
    rows = stored_rows(shards)
    row = next(row for row in rows if touch_total(row))  # there is one: touches were counted
    if row.has("sensor_image"):
        return SensorImages(row).size(0), 1
    clip = TouchClip(row, 0)
    return clip.size, max(1, round(clip.fps))
