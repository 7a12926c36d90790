"""LeRobotDataset v3.0 with images: one clip an episode, or one round of single images.

Facts of the format: frames lie in ``data/chunk-000/file-000.parquet``, 1,000 files a chunk, numbered over all
episodes; ``meta`` says where each episode begins, what the features are, and their statistics. Readers find
episodes by their position, so that none may be missing.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from realtouch.columns.per_frame import clip_times
from realtouch.columns.per_touch import entries_of, int_value, intended_positions, plain_value, touch_total
from realtouch.columns.poses import clip_poses, poses
from realtouch.convert.plan import Conversion, RowChoice, RowChoices, Source, WithFiles
from realtouch.damage import damaged
from realtouch.dataset import dataset_of
from realtouch.exchange.flat import image_suffix, known_label, require_whole
from realtouch.exchange.vouched import file_fields, files_are_current, files_of, vouched_files, with_files
from realtouch.media.clips import TouchClip
from realtouch.media.images import SensorImages
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import ParquetStyle, encode_parquet, sha256_hex
from tactile_toolkit.store.shards import ShardName, Skipped
from tactile_toolkit.touch.jpeg import decode_image, encode_image
from tactile_toolkit.touch.schema import MEDIA_TYPE, class_names, column_type

__all__ = ["LEROBOT_FOLDER", "lerobot_conversion"]

LEROBOT_FOLDER = "lerobot"
VERSION = "v3.0"

_IMAGE, _STATE, _ACTION, _TIME = "observation.images.tactile", "observation.state", "action", "time_s"
_POSE = "gel_pose_cell_frame"
_FILES_PER_CHUNK = 1000
_FILE_BYTES = 100 << 20
_GROUP_BYTES = 16 << 20
_IMAGES_SEEN = 8
"""Images of an episode that are decoded for its statistics."""

_LEVELS = 256
_QUANTILES = (0.01, 0.10, 0.50, 0.90, 0.99)
_STATISTICS = ("min", "max", "mean", "std", "count", *(f"q{round(100 * each):02d}" for each in _QUANTILES))
_OF_EPISODE = ("round_id", "touch", "label", "object_id")
_META_STYLE = ParquetStyle(rows_per_group=1 << 12, compression_level=3)


@dataclass(frozen=True)
class _Episodes:
    """Step of the export: the frames of the episodes of a row, numbered within each."""

    fps: int
    size: tuple[int, int]
    names: tuple[str, ...]

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the columns that the source can fill, and what the index says of episodes."""
        has = {name: column_type(source, name) is not None for name in ("pos_in_cell", "object_id")}
        has_pose = any(
            column_type(source, f"{name}.position") is not None for name in (_POSE, f"{_POSE}_seq")
        )
        return pa.schema(
            [
                ("round_id", pa.string()),
                *([("touch", pa.int64())] if column_type(source, "sensor_video") is not None else []),
                (_IMAGE, MEDIA_TYPE),
                *([(_STATE, pa.list_(pa.float32(), 7))] if has_pose else []),
                *([(_ACTION, pa.list_(pa.float32(), 2))] if has["pos_in_cell"] else []),
                *([(_TIME, pa.float32())] if column_type(source, "time_stamp_rel_seq") is not None else []),
                ("label", pa.int64()),
                *([("object_id", pa.int64())] if has["object_id"] else []),
                ("timestamp", pa.float32()),
                ("frame_index", pa.int64()),
            ]
        )

    def apply(self, row: Row, choice: RowChoice, split: str) -> pa.Table:
        """Return all frames of a row."""
        name, label = str(plain_value(row, "id")), known_label(row, self.names)
        object_id = int_value(row, "object_id") if row.has("object_id") else 0
        count = touch_total(row)
        places = intended_positions(row) if row.has("pos_in_cell") else None
        schema = self.schema(row.group.table.schema)
        tables = []
        for touch, images, columns in self._episodes(row, count):
            frames = len(images)
            if places is not None:
                columns[_ACTION] = _vectors(places if touch is None else np.tile(places[touch], (frames, 1)))
            start = f"{name}_{touch or 0:03d}"
            paths = [f"{start}_{frame:04d}.{image_suffix(image)}" for frame, image in enumerate(images)]
            columns |= {
                "round_id": pa.array([name] * frames),
                "touch": pa.array([touch] * frames, pa.int64()),
                _IMAGE: pa.StructArray.from_arrays(
                    [pa.array(images, pa.binary()), pa.array(paths)], fields=list(MEDIA_TYPE)
                ),
                "label": pa.array(np.full(frames, label)),
                "object_id": pa.array(np.full(frames, object_id)),
                "timestamp": pa.array((np.arange(frames) / self.fps).astype(np.float32)),
                "frame_index": pa.array(np.arange(frames)),
            }
            tables.append(pa.table([columns[each.name] for each in schema], schema=schema))
        return pa.concat_tables([schema.empty_table(), *tables])

    def _episodes(
        self, row: Row, count: int
    ) -> Iterator[tuple[int | None, list[bytes | memoryview], dict[str, Any]]]:
        """Yield each episode: its touch (None: all of the round), its images, and poses and times."""
        if row.has("sensor_image"):
            entries_of(row, "sensor_image")
            stored = SensorImages(row)
            images: list[bytes | memoryview] = [stored.encoded(touch) for touch in range(count)]
            for touch, image in enumerate(images):
                self._require_size(row, "sensor_image", touch, image)
            if not images:
                return
            pose = poses(row) if row.has(f"{_POSE}.position") else None
            yield None, images, {} if pose is None else {_STATE: _states(pose)}
            return
        for touch in range(count):
            clip = TouchClip(row, touch)
            if clip.has_index:
                images = [clip.encoded(frame) for frame in range(len(clip))]
            else:
                images = [encode_image(pixels) for pixels in clip.frames()]
            for image in images:
                self._require_size(row, "sensor_video", touch, image)
            columns: dict[str, Any] = {}
            if row.has(f"{_POSE}_seq.position"):
                columns[_STATE] = _states(clip_poses(row, touch))
            times_s = clip_times(row, touch)
            if times_s is not None:
                columns[_TIME] = pa.array(times_s.astype(np.float32))
            yield touch, images, columns

    def _require_size(self, row: Row, name: str, touch: int, image: bytes | memoryview) -> None:
        try:
            size = require_whole(image)
        except ValueError as error:
            raise damaged(row, name, str(error), touch) from error
        if size != self.size:
            (height, width), (first_height, first_width) = size, self.size
            message = (
                f"{row.path!r}, row {row.number}, touch {touch}: an image of {width} x {height} pixels; "
                f"expected {first_width} x {first_height} as in the first touch: a LeRobotDataset has images "
                "of one size; next: make them alike with `realtouch resize`"
            )
            raise InputError(message)


def _states(pose: Any) -> pa.Array:
    return _vectors(np.hstack([pose.position_m, pose.quaternion]))


def _vectors(values: NDArray[Any]) -> pa.Array:
    flat = np.ascontiguousarray(values, np.float32).reshape(-1)
    return pa.FixedSizeListArray.from_arrays(pa.array(flat), values.shape[1])


@dataclass(frozen=True)
class _PackEpisodes:
    """Packs the frames of a shard and what is to be known of its episodes; keeps an index of those.

    ``starts`` is the number of the first episode and of the first frame of each shard, and of one more.
    """

    starts: Sequence[tuple[int, int]] = field(repr=False)
    tasks: tuple[str, ...] = ()
    rows_per_group: int = 1

    def schema(self, rows: pa.Schema) -> pa.Schema:
        """Return the columns of the index."""
        numbers = [(name, pa.int64()) for name in ("id", "first_frame", "frames")]
        kept = [rows.field(name) for name in _OF_EPISODE if rows.get_field_index(name) >= 0]
        return pa.schema([*numbers, *kept, *file_fields(2)])

    def apply(self, shard: ShardName, rows: pa.Table, skipped: Sequence[Skipped]) -> WithFiles:
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
        episodes = episode + np.arange(len(starts))
        index = frame + np.arange(len(rows))
        if self.starts[shard.index + 1] != (episode + len(starts), frame + len(rows)):
            message = (
                f"{shard}: {len(starts):,} episodes of {len(rows):,} frames in all, other than "
                "'video_length_frames' said when the export was planned; nothing of this file was written; "
                "next: run `realtouch verify` on the source"
            )
            raise IntegrityError(message)
        frames = rows.drop_columns([name for name in ("round_id", "touch") if name in rows.schema.names])
        for name, values in (
            ("episode_index", np.repeat(episodes, lengths)),
            ("index", index),
            ("task_index", rows["label"].to_numpy()),
        ):
            frames = frames.append_column(name, pa.array(values, pa.int64()))
        chunk, number = divmod(shard.index, _FILES_PER_CHUNK)
        place = f"chunk-{chunk:03d}/file-{number:03d}.parquet"
        meta = _meta_of_episodes(frames, starts, lengths, episodes, index, self.tasks, (chunk, number))
        style = ParquetStyle(
            self.rows_per_group, compression_level=3, encodings=((f"{_IMAGE}.bytes", "PLAIN"),)
        )
        files = {
            f"{LEROBOT_FOLDER}/data/{place}": encode_parquet(_with_hf_features(frames), style),
            f"{LEROBOT_FOLDER}/meta/episodes/{place}": encode_parquet(meta, _META_STYLE),
        }
        firsts = rows.select([name for name in _OF_EPISODE if name in rows.schema.names]).take(starts)
        for position, (name, values) in enumerate(
            (("id", episodes), ("first_frame", index[starts]), ("frames", lengths))
        ):
            firsts = firsts.add_column(position, name, pa.array(values, pa.int64()))
        return with_files(firsts, files)


def _meta_of_episodes(
    frames: pa.Table,
    starts: NDArray[Any],
    lengths: NDArray[Any],
    episodes: NDArray[Any],
    index: NDArray[Any],
    tasks: tuple[str, ...],
    file: tuple[int, int],
) -> pa.Table:
    """Return one row an episode: where it lies, its task, and the statistics of its features."""
    labels = frames["task_index"].to_numpy()[starts]
    first = index[starts]
    chunk, number = (np.full(len(starts), each) for each in file)
    columns: dict[str, Any] = {
        "episode_index": episodes,
        "tasks": pa.array([[tasks[label]] for label in labels], pa.list_(pa.string())),
        "length": lengths,
        "data/chunk_index": chunk,
        "data/file_index": number,
        "dataset_from_index": first,
        "dataset_to_index": first + lengths,
        "meta/episodes/chunk_index": chunk,
        "meta/episodes/file_index": number,
    }
    found = [
        {name: _statistics_of(frames.column(name), start, length) for name in frames.column_names}
        for start, length in zip(starts.tolist(), lengths.tolist(), strict=True)
    ]
    for name in frames.column_names:
        for statistic in _STATISTICS:
            values = [each[name][statistic] for each in found]
            columns[f"stats/{name}/{statistic}"] = pa.array(values, _type_of_statistic(name, statistic))
    return pa.table(columns)


def _type_of_statistic(name: str, statistic: str) -> pa.DataType:
    if statistic == "count":
        return pa.list_(pa.int64())
    flat = pa.list_(pa.float64())
    return pa.list_(pa.list_(flat)) if name == _IMAGE else flat


def _statistics_of(column: pa.ChunkedArray, start: int, length: int) -> dict[str, Any]:
    """Return the statistics of a feature in an episode, in the shapes of the format."""
    part = column.slice(start, length).combine_chunks()
    if part.type == MEDIA_TYPE:
        return _image_statistics(part.field("bytes"))
    values = part.flatten().to_numpy() if pa.types.is_fixed_size_list(part.type) else part.to_numpy()
    return _number_statistics(values.reshape(length, -1).astype(np.float64))


def _number_statistics(values: NDArray[np.float64]) -> dict[str, Any]:
    """Return statistics of numbers, shape (n, k); sums are exact, so that every processor rounds alike."""
    means = [math.fsum(column) / len(column) for column in values.T]
    spread = [
        math.sqrt(math.fsum((column - mean) ** 2) / len(column))
        for column, mean in zip(values.T, means, strict=True)
    ]
    ordered = np.sort(values, axis=0)
    return {
        "min": ordered[0].tolist(),
        "max": ordered[-1].tolist(),
        "mean": means,
        "std": spread,
        "count": [len(values)],
        **{
            name: ordered[_rank(each, len(values))].tolist()
            for name, each in zip(_STATISTICS[5:], _QUANTILES, strict=True)
        },
    }


def _image_statistics(images: pa.Array) -> dict[str, Any]:
    """Return statistics of each colour, 0 to 1, shape (3, 1, 1), of some images of an episode.

    Levels are counted, and all follows from the counts.
    """
    from PIL import Image

    seen = np.unique(np.linspace(0, len(images) - 1, _IMAGES_SEEN).round().astype(int))
    counts = np.zeros((3, _LEVELS), np.int64)
    for number in seen.tolist():
        pixels = Image.fromarray(decode_image(images[number].as_py()))
        counts += np.array(pixels.histogram(), np.int64).reshape(3, _LEVELS)
    found: dict[str, Any] = {"count": [len(seen)]}
    each = [_level_statistics(levels.tolist()) for levels in counts]
    for name in each[0]:
        found[name] = [[[colour[name]]] for colour in each]
    return found


def _level_statistics(levels: list[int]) -> dict[str, float]:
    total = sum(levels)
    mean = sum(level * count for level, count in enumerate(levels)) / total
    spread = math.fsum(count * (level - mean) ** 2 for level, count in enumerate(levels)) / total
    below = list(accumulate(levels))

    def at(rank: int) -> int:
        return next(level for level, count in enumerate(below) if count > rank)

    values = {"min": at(0), "max": at(total - 1), "mean": mean, "std": math.sqrt(spread)}
    values |= {name: at(_rank(share, total)) for name, share in zip(_STATISTICS[5:], _QUANTILES, strict=True)}
    return {name: value / (_LEVELS - 1) for name, value in values.items()}


def _rank(share: float, count: int) -> int:
    """Return which of so many ordered values a quantile is: the nearest one."""
    return round(share * (count - 1))


def _with_hf_features(frames: pa.Table) -> pa.Table:
    """Say in the file what `datasets` is to make of the columns."""
    features: dict[str, Any] = {}
    for each in frames.schema:
        if each.type == MEDIA_TYPE:
            features[each.name] = {"_type": "Image"}
        elif pa.types.is_fixed_size_list(each.type):
            inner = {"dtype": "float32", "_type": "Value"}
            features[each.name] = {"feature": inner, "length": each.type.list_size, "_type": "Sequence"}
        else:
            dtype = "float32" if pa.types.is_float32(each.type) else "int64"
            features[each.name] = {"dtype": dtype, "_type": "Value"}
    return frames.replace_schema_metadata({"huggingface": json.dumps({"info": {"features": features}})})


@dataclass(frozen=True)
class _WriteMeta:
    """Writes what a LeRobotDataset says of all its episodes, once they are there."""

    split: str
    fps: int
    size: tuple[int, int]
    tasks: tuple[str, ...]

    def __call__(self, folder: DataFolder, manifest: Manifest) -> dict[str, str]:
        """Return the checksum of each file of the LeRobotDataset by its path."""
        files = vouched_files(folder, manifest)
        placed = [list(files_of(folder, record)) for record in manifest.shards if record.rows]
        frames, episodes = (
            [Shard(folder.address(path)) for path in paths] for paths in zip(*placed, strict=True)
        )
        info = self._info(frames[0].schema, sum(map(len, episodes)), sum(map(len, frames)))
        meta = {
            "info.json": _json_bytes(info),
            "stats.json": _json_bytes(_statistics_of_all(episodes, frames)),
            "tasks.parquet": encode_parquet(_task_table(self.tasks), _META_STYLE),
        }
        for name, content in meta.items():
            path = f"{LEROBOT_FOLDER}/meta/{name}"
            if not folder.exists(path) or folder.read_bytes(path) != content:
                folder.write_bytes(path, content)
            files[path] = sha256_hex(content)
        return files

    def _info(self, frames: pa.Schema, episodes: int, total_frames: int) -> dict[str, Any]:
        return {
            "codebase_version": VERSION,
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


def _statistics_of_all(episodes: Sequence[Shard], frames: Sequence[Shard]) -> dict[str, Any]:
    """Put the statistics of all episodes together, weighed by their counts, as LeRobot does.

    Quantiles of parts do not give those of all: of numbers, they are taken from all frames.
    """
    found: dict[str, Any] = {}
    for each in frames[0].schema:
        name = each.name
        columns = [f"stats/{name}/{statistic}" for statistic in _STATISTICS]
        table = pa.concat_tables([shard.read(columns=columns) for shard in episodes])
        of_episodes = {
            statistic: _flat_rows(table[column])
            for statistic, column in zip(_STATISTICS, columns, strict=True)
        }
        weights = of_episodes["count"][:, 0]
        total = int(weights.sum())
        means = _weighed(of_episodes["mean"], weights, total)
        square = of_episodes["std"] ** 2 + (of_episodes["mean"] - means) ** 2
        if each.type == MEDIA_TYPE:
            quantiles = [_weighed(of_episodes[key], weights, total) for key in _STATISTICS[5:]]
        else:
            quantiles = _quantiles(frames, name)
        values = {
            "min": of_episodes["min"].min(axis=0).tolist(),
            "max": of_episodes["max"].max(axis=0).tolist(),
            "mean": means,
            "std": [math.sqrt(value) for value in _weighed(square, weights, total)],
            **dict(zip(_STATISTICS[5:], quantiles, strict=True)),
        }
        shaped = {key: [[[v]] for v in value] if name == _IMAGE else value for key, value in values.items()}
        found[name] = {**shaped, "count": [total]}
    return found


def _quantiles(frames: Sequence[Shard], name: str) -> list[list[float]]:
    """Return the quantiles of each number of a feature over all frames, interpolated as NumPy does.

    One number of each frame is in memory at a time: 8 bytes a frame.
    """
    width = getattr(frames[0].types[name], "list_size", 1)
    found = []
    for number in range(width):
        parts = [
            np.asarray(_flat_rows(shard.read(columns=[name]).column(0))[:, number], np.float64)
            for shard in frames
        ]
        found.append(np.quantile(np.concatenate(parts), _QUANTILES, overwrite_input=True))
    quantiles: list[list[float]] = np.transpose(found).tolist()
    return quantiles


def _flat_rows(column: pa.ChunkedArray) -> NDArray[Any]:
    """Return lists of equal length, of whatever depth, as an array of a row for each."""
    values = column.combine_chunks()
    count = len(values)
    while pa.types.is_list(values.type) or pa.types.is_fixed_size_list(values.type):
        values = values.flatten()
    flat: NDArray[Any] = values.to_numpy().reshape(count, -1)
    return flat


def _weighed(values: NDArray[Any], weights: NDArray[Any], total: int) -> list[float]:
    return [math.fsum(column * weights) / total for column in values.T]


def lerobot_conversion(
    source: Source, options: Mapping[str, Any], choices: Mapping[str, RowChoices]
) -> Conversion:
    """Plan a LeRobotDataset; reads footers, lengths and one header. InputError for several splits."""
    if len(choices) > 1:
        message = (
            f"{source.name!r} has the splits {', '.join(choices)}; a LeRobotDataset holds one; next: add "
            f"--split {next(iter(choices))}"
        )
        raise InputError(message)
    ((split, chosen),) = choices.items()
    counts = _episode_lengths(source, split)[np.asarray(chosen.rows, np.int64)]
    if not counts.sum():
        message = f"{source.name!r} has no touches in split {split!r}; next: choose another split"
        raise InputError(message)
    rows_per_shard = max(1, _FILE_BYTES // source.row_bytes())
    size, fps = _first_image(source.shards[split])
    names = class_names(source.schema)
    tasks = tuple(f"touch an object of class {name}" for name in names)
    ends = np.concatenate([np.zeros((1, 2), np.int64), np.cumsum(counts, axis=0)])
    bounds = [*range(0, len(chosen), rows_per_shard), len(chosen)]
    image_bytes = source.media_bytes() if source.kind == "single" else source.media_bytes() // 64 or 1
    return Conversion(
        source,
        "export",
        {**options, "layout": "lerobot", "fps": fps, "image_size": [size[1], size[0]]},
        _Episodes(fps, size, names),
        choices,
        rows_per_shard=rows_per_shard,
        rows_per_group=1 << 12,
        extra_dirs=(LEROBOT_FOLDER,),
        is_current=files_are_current,
        write_files=_WriteMeta(split, fps, size, tasks),
        pack=_PackEpisodes(
            [(int(ends[bound, 0]), int(ends[bound, 1])) for bound in bounds],
            tasks,
            max(1, _GROUP_BYTES // image_bytes),
        ),
    )


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
