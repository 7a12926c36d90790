"""LeRobotDataset v3.0 with images: one clip an episode, or one round of single images.

Facts of the format: frames lie in ``data/chunk-000/file-000.parquet``, 1,000 files a chunk, numbered over all
episodes; ``meta`` says where each episode begins, what the features are, and their statistics. Readers find
episodes by their position, so that none may be missing.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from realtouch.columns.per_frame import clip_times
from realtouch.columns.per_touch import entries_of, int_value, intended_positions, plain_value, touch_total
from realtouch.columns.poses import clip_poses, poses
from realtouch.contact import ContactMethod
from realtouch.convert.plan import Conversion, Made, RowChoice, Source
from realtouch.damage import damaged
from realtouch.dataset import dataset_of
from realtouch.exchange.lerobot_statistics import columns_of_episodes, statistics_of_all
from realtouch.exchange.rows import image_column, known_label, require_intact
from realtouch.integrity.files import (
    checksums,
    file_fields,
    files_are_current,
    files_of,
    with_files,
    write_changed,
)
from realtouch.media.clips import TouchClip
from realtouch.media.images import SensorImages
from realtouch.poses import Poses
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import ParquetStyle, encode_parquet
from tactile_toolkit.store.shards import ShardName, Skipped
from tactile_toolkit.touch.jpeg import encode_image
from tactile_toolkit.touch.schema import MEDIA_TYPE, POSE_COLUMN, class_names, column_type, with_features

__all__ = ["lerobot_conversion"]

_FOLDER = "lerobot"
_VERSION = "v3.0"
_IMAGE, _STATE, _ACTION, _TIME = "observation.images.tactile", "observation.state", "action", "time_s"
_POSES = {kind: f"{name}.position" for kind, name in POSE_COLUMN.items()}
_FILES_PER_CHUNK = 1000
_FILE_BYTES = 100 << 20
_GROUP_BYTES = 16 << 20
_OF_EPISODE = ("round_id", "touch", "label", "object_id")
_META_STYLE = ParquetStyle(rows_per_group=1 << 12, compression_level=3)


def lerobot_conversion(
    source: Source,
    choices: Mapping[str, Sequence[RowChoice]],
    method: ContactMethod,
    options: Mapping[str, Any],
) -> Conversion:
    """Plan a LeRobotDataset; reads footers, lengths and one header. InputError for several splits."""
    if len(choices) > 1:
        message = (
            f"{source.name!r} has the splits {', '.join(choices)}; a LeRobotDataset holds one; next: add "
            f"--split {next(iter(choices))}"
        )
        raise InputError(message)
    ((split, chosen),) = choices.items()
    counts = _episode_lengths(source, split)[[row for row, _ in chosen]]
    if not counts.sum():
        message = f"{source.name!r} has no touches in split {split!r}; next: choose another split"
        raise InputError(message)
    rows_per_shard = max(1, _FILE_BYTES // source.row_bytes())
    size, fps = _first_image(source.shards[split])
    names = class_names(source.schema)
    tasks = tuple(f"touch an object of class {name}" for name in names)
    ends = np.concatenate([np.zeros((1, 2), np.int64), np.cumsum(counts, axis=0)])
    starts = ends[[*range(0, len(chosen), rows_per_shard), len(chosen)]].tolist()
    image_bytes = source.media_bytes() if source.kind == "single" else source.media_bytes() // 64 or 1
    return Conversion(
        source,
        "export",
        {**options, "fps": fps, "image_size": [size[1], size[0]]},
        _Episodes(fps, size, names),
        choices,
        rows_per_shard=rows_per_shard,
        rows_per_group=1 << 12,
        extra_dirs=(_FOLDER,),
        is_current=files_are_current,
        write_files=_WriteMeta(split, fps, size, tasks),
        pack=_PackEpisodes(starts, tasks, max(1, _GROUP_BYTES // image_bytes)),
    )


def _episode_lengths(source: Source, split: str) -> NDArray[np.int64]:
    """Return the number of episodes and of frames of each row, shape (n, 2)."""
    if source.kind == "single":
        counts = dataset_of(source.shards[split], "single").touch_counts
        return np.column_stack([counts > 0, counts]).astype(np.int64)
    found = []
    for shard in source.shards[split]:
        if "video_length_frames" not in shard.types:
            message = (
                f"{shard.path!r} has no column 'video_length_frames', by which frames are numbered ahead; "
                "next: make single images of it first (`realtouch to-single`)"
            )
            raise InputError(message)
        for index in range(shard.metadata.num_row_groups):
            lengths = shard.read(columns=["video_length_frames"], groups=[index]).column(0)
            rows = [np.asarray(each, np.int64) for each in lengths.to_pylist()]
            found += [(len(each), int(each.sum())) for each in rows]
    return np.array(found, np.int64).reshape(-1, 2)


def _first_image(shards: Sequence[Shard]) -> tuple[tuple[int, int], int]:
    """Return height and width of the first image, and the frames per second; 1 of single images."""
    groups = (
        group
        for shard in shards
        for index in range(shard.metadata.num_row_groups)
        for group in shard.blocks(index)
    )
    rows = (Row(group, number) for group in groups for number in range(len(group.table)))
    row = next(row for row in rows if touch_total(row))  # there is one: touches were counted
    if row.has("sensor_image"):
        return SensorImages(row).size(0), 1
    clip = TouchClip(row, 0)
    return clip.size, max(1, round(clip.fps))


@dataclass(frozen=True)
class _Episodes:
    """Step of the export: the frames of the episodes of a row, numbered within each."""

    fps: int
    size: tuple[int, int]
    names: tuple[str, ...]

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the columns that the source can fill, and what the index says of episodes."""
        wanted = {
            "round_id": (pa.string(), ("id",)),
            "touch": (pa.int64(), ("sensor_video",)),
            _IMAGE: (MEDIA_TYPE, ("sensor_video", "sensor_image")),
            _STATE: (pa.list_(pa.float32(), 7), tuple(_POSES.values())),
            _ACTION: (pa.list_(pa.float32(), 2), ("pos_in_cell",)),
            _TIME: (pa.float32(), ("time_stamp_rel_seq",)),
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
        name, label = str(plain_value(row, "id")), known_label(row, self.names)
        object_id = int_value(row, "object_id") if row.has("object_id") else 0
        places = intended_positions(row) if row.has("pos_in_cell") else None
        schema = self.schema(row.group.table.schema)
        tables = [schema.empty_table()]
        for touch, images, columns in self._episodes(row):
            for number, image in enumerate(images):
                self._require_size(row, number if touch is None else touch, image)
            count, start = len(images), f"{name}_{touch or 0:03d}"
            if places is not None:
                columns[_ACTION] = _vectors(places if touch is None else np.tile(places[touch], (count, 1)))
            image_names = [f"{start}_{frame:04d}" for frame in range(count)]
            columns |= {
                "round_id": [name] * count,
                "touch": [touch] * count,
                _IMAGE: image_column(images, image_names),
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
                yield None, images, {_STATE: _states(poses(row))} if row.has(_POSES["single"]) else {}
            return
        for touch in range(touch_total(row)):
            clip, columns = TouchClip(row, touch), dict[str, Any]()
            if row.has(_POSES["seq"]):
                columns[_STATE] = _states(clip_poses(row, touch))
            times_s = clip_times(row, touch)
            if times_s is not None:
                columns[_TIME] = times_s.astype(np.float32)
            if clip.has_index:
                yield touch, [clip.encoded(frame) for frame in range(len(clip))], columns
            else:
                yield touch, [encode_image(pixels) for pixels in clip.frames()], columns

    def _require_size(self, row: Row, touch: int, image: bytes | memoryview) -> None:
        try:
            size = require_intact(image)
        except ValueError as error:
            name = "sensor_image" if row.has("sensor_image") else "sensor_video"
            raise damaged(row, name, str(error), touch) from error
        if size != self.size:
            (height, width), (first_height, first_width) = size, self.size
            message = (
                f"{row.path!r}, row {row.number}, touch {touch}: an image of {width} x {height} pixels; "
                f"expected {first_width} x {first_height} as in the first touch: a LeRobotDataset has images "
                "of one size; next: make them alike with `realtouch resize`"
            )
            raise InputError(message)


def _states(pose: Poses) -> pa.Array:
    return _vectors(np.hstack([pose.position_m, pose.quaternion]))


def _vectors(values: NDArray[Any]) -> pa.Array:
    flat = np.ascontiguousarray(values, np.float32).reshape(-1)
    return pa.FixedSizeListArray.from_arrays(pa.array(flat), values.shape[1])


@dataclass(frozen=True)
class _PackEpisodes:
    """Packs the frames of a shard and what is to be known of its episodes; keeps an index of those.

    ``starts`` is the number of the first episode and of the first frame of each shard, and of one more.
    """

    starts: list[list[int]] = field(repr=False)
    tasks: tuple[str, ...] = ()
    rows_per_group: int = 1

    def schema(self, rows: pa.Schema) -> pa.Schema:
        """Return the columns of the index."""
        numbers = [(name, pa.int64()) for name in ("id", "first_frame", "frames")]
        kept = [rows.field(name) for name in _OF_EPISODE if name in rows.names]
        return pa.schema([*numbers, *kept, *file_fields(2)])

    def apply(self, shard: ShardName, rows: pa.Table, skipped: Sequence[Skipped]) -> Made:
        """Return the frames and episodes of a shard, numbered over the whole data set."""
        if skipped:
            message = (
                f"{skipped[0].message}; LeRobot numbers episodes without gaps, so that none can be left out; "
                "nothing of this file was written; next: leave the round out first (`realtouch select`)"
            )
            raise IntegrityError(message)
        rows = rows.combine_chunks()
        episode, frame = self.starts[shard.index]
        starts = np.flatnonzero(rows["frame_index"].to_numpy() == 0)
        lengths = np.diff([*starts, len(rows)])
        if self.starts[shard.index + 1] != [episode + len(starts), frame + len(rows)]:
            message = (
                f"{shard}: {len(starts):,} episodes of {len(rows):,} frames in all, other than "
                "'video_length_frames' said when the export was planned; nothing of this file was written; "
                "next: run `realtouch verify` on the source"
            )
            raise IntegrityError(message)
        episodes = episode + np.arange(len(starts))
        index = {"id": episodes, "first_frame": frame + starts, "frames": lengths}
        frames = rows.drop_columns([name for name in ("round_id", "touch") if name in rows.schema.names])
        for name, values in (
            ("episode_index", np.repeat(episodes, lengths)),
            ("index", frame + np.arange(len(rows))),
            ("task_index", rows["label"].to_numpy()),
        ):
            frames = frames.append_column(name, pa.array(values, pa.int64()))
        # What `datasets` makes of the columns; a class is a number here.
        frames = frames.cast(with_features(frames.schema, ()))
        labels = rows["label"].to_numpy()[starts]
        chunk, number = divmod(shard.index, _FILES_PER_CHUNK)
        place = f"chunk-{chunk:03d}/file-{number:03d}.parquet"
        chunks, files = np.full(len(starts), chunk), np.full(len(starts), number)
        meta = {
            "episode_index": episodes,
            "tasks": pa.array([[self.tasks[label]] for label in labels], pa.list_(pa.string())),
            "length": lengths,
            "data/chunk_index": chunks,
            "data/file_index": files,
            "dataset_from_index": frame + starts,
            "dataset_to_index": frame + starts + lengths,
            "meta/episodes/chunk_index": chunks,
            "meta/episodes/file_index": files,
            **columns_of_episodes(frames, starts.tolist(), lengths.tolist()),
        }
        encodings = ((f"{_IMAGE}.bytes", "PLAIN"),)
        style = ParquetStyle(self.rows_per_group, compression_level=3, encodings=encodings)
        index |= {name: rows[name].take(starts) for name in _OF_EPISODE if name in rows.schema.names}
        return with_files(
            pa.table(index),
            {
                f"{_FOLDER}/data/{place}": encode_parquet(frames, style),
                f"{_FOLDER}/meta/episodes/{place}": encode_parquet(pa.table(meta), _META_STYLE),
            },
        )


@dataclass(frozen=True)
class _WriteMeta:
    """Writes what a LeRobotDataset says of all its episodes, once they are there."""

    split: str
    fps: int
    size: tuple[int, int]
    tasks: tuple[str, ...]

    def __call__(self, folder: DataFolder, manifest: Manifest) -> dict[str, str]:
        """Return the checksum of each file of the LeRobotDataset by its path."""
        files = checksums(folder, manifest)
        placed = [list(files_of(folder, record)) for record in manifest.shards if record.rows]
        frames, episodes = (
            [Shard(folder.address(path)) for path in paths] for paths in zip(*placed, strict=True)
        )
        info = self._info(frames[0].schema, sum(map(len, episodes)), sum(map(len, frames)))
        meta = {
            "info.json": _json_bytes(info),
            "stats.json": _json_bytes(statistics_of_all(episodes, frames)),
            "tasks.parquet": encode_parquet(_task_table(self.tasks), _META_STYLE),
        }
        for name, content in meta.items():
            path = f"{_FOLDER}/meta/{name}"
            files[path] = write_changed(folder, path, content)
        return files

    def _info(self, frames: pa.Schema, episodes: int, total_frames: int) -> dict[str, Any]:
        return {
            "codebase_version": _VERSION,
            "robot_type": None,
            "total_episodes": episodes,
            "total_frames": total_frames,
            "total_tasks": len(self.tasks),
            "chunks_size": _FILES_PER_CHUNK,
            "data_files_size_in_mb": _FILE_BYTES >> 20,
            "video_files_size_in_mb": 200,
            "fps": self.fps,
            "splits": {self.split: f"0:{episodes}"},
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": None,
            "features": {each.name: self._feature(each) for each in frames},
        }

    def _feature(self, each: pa.Field) -> dict[str, Any]:
        if each.type == MEDIA_TYPE:
            return {"dtype": "image", "shape": [*self.size, 3], "names": ["height", "width", "channels"]}
        if pa.types.is_fixed_size_list(each.type):
            names = ["x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"][: each.type.list_size]
            return {"dtype": "float32", "shape": [len(names)], "names": names}
        dtype = "float32" if pa.types.is_float32(each.type) else "int64"
        return {"dtype": dtype, "shape": [1], "names": None}


def _json_bytes(values: Mapping[str, Any]) -> bytes:
    return (json.dumps(values, indent=4) + "\n").encode()


def _task_table(tasks: Sequence[str]) -> pa.Table:
    """Return the tasks as pandas stores a table whose rows go by name."""
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), "task": pa.array(tasks)})
    columns = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": stored, "metadata": None}
        for name, kind, stored in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    ]
    of_pandas = {"index_columns": ["task"], "column_indexes": [], "columns": columns}
    return table.replace_schema_metadata({"pandas": json.dumps({**of_pandas, "pandas_version": "2.0.0"})})
