"""LeRobotDataset v3.0 with images: one clip an episode, or one round of single images.

Facts of the format: frames lie in ``data/chunk-000/file-000.parquet``, 1,000 files a chunk, numbered over all
episodes; ``meta`` says where each episode begins, what the features are, and their statistics.

Sums of statistics are exact, so that every processor rounds alike.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
from PIL import Image

from realtouch.contact import ContactMethod
from realtouch.convert.conversion import (
    Choices,
    Conversion,
    Made,
    Source,
    checksums,
    files_of,
    with_files,
    write_changed,
)
from realtouch.exchange.episodes import ACTION, IMAGE, STATE, Episodes, only_split
from realtouch.exchange.flat import FRAMES_PER_MEDIA
from realtouch.exchange.lerobot_mark import Mark
from realtouch.stored_images import decoded
from realtouch.touch_dataset import dataset_of
from tactile_toolkit import read, store
from tactile_toolkit.array_types import Float64, Int64
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.touch import MEDIA_TYPE, with_features

FOLDER = "lerobot"
FILES_PER_CHUNK = 1000
FILE_BYTES = 100 << 20
META_STYLE = store.ParquetStyle(rows_per_group=1 << 12, compression_level=3)
_VERSION = "v3.0"
_GROUP_BYTES = 16 << 20
_OF_EPISODE = ("round_id", "touch", "label", "object_id")
_OF_READERS = ("round_id", "touch")
# Images of an episode that are decoded for its statistics.
_IMAGES_SEEN = 8
_LEVELS = 256
_IN_MEMORY_BYTES = 64 << 20
_POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
_COMPONENTS = {STATE: _POSE, ACTION: _POSE[:2]}
_QUANTILES = {f"q{round(100 * share):02d}": share for share in (0.01, 0.10, 0.50, 0.90, 0.99)}
_NAMES = ("min", "max", "mean", "std", "count", *_QUANTILES)


def plan_lerobot(
    source: Source, choices: Choices, method: ContactMethod, options: Mapping[str, object]
) -> Conversion:
    """Plan a LeRobotDataset; reads footers, lengths and one header. InputError for several splits."""
    rows_per_shard = max(1, FILE_BYTES // source.row_bytes())
    split = only_split(source, choices, "LeRobotDataset")
    step, chosen = Episodes.of(source, split), choices[split]
    counts = _episode_lengths(source, split)[[each.row for each in chosen]]
    ends = np.concatenate([np.zeros((1, 2), np.int64), np.cumsum(counts, axis=0)])
    # Numbers of the first episode and frame of each shard, and of one more.
    starts = ends[[*range(0, len(chosen), rows_per_shard), len(chosen)]].tolist()
    tasks = tuple(f"touch an object of class {name}" for name in step.names)
    if (dataset_of(source.shards[split]).labels < 0).any():
        tasks += ("touch an object",)  # the last, as -1 counts from the end
    image_bytes = source.media_bytes() // FRAMES_PER_MEDIA[source.kind] or 1
    return Conversion(
        source,
        "export",
        {**options, "fps": step.fps, "image_size": [step.size[1], step.size[0]]},
        step,
        choices,
        rows_per_shard=rows_per_shard,
        rows_per_group=1 << 12,
        extra_dirs=(FOLDER,),
        write_files=_WriteMeta(split, step, tasks, source.kind == "seq"),
        pack=_PackEpisodes(starts, tasks, max(1, _GROUP_BYTES // image_bytes)),
    )


def _episode_lengths(source: Source, split: str) -> Int64:
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


@dataclass(frozen=True)
class _PackEpisodes:
    """Packs the frames of a shard and the table of its episodes; keeps an index of episodes."""

    starts: Sequence[Sequence[int]] = field(repr=False)
    tasks: tuple[str, ...]
    rows_per_group: int

    def __call__(self, shard: store.ShardName, rows: pa.Table, skipped: Sequence[store.Skipped]) -> Made:
        """Return the frames and episodes of a shard, numbered over the whole data set.

        Raises IntegrityError if a round was left out, or lengths were not as stated.
        """
        rows = rows.combine_chunks()
        firsts = np.flatnonzero(rows["frame_index"].to_numpy() == 0)
        self._require_all(shard, [len(firsts), len(rows)], skipped)
        episode, frame = self.starts[shard.index]
        episodes, lengths = episode + np.arange(len(firsts)), np.diff([*firsts, len(rows)])
        frames = self._frames(rows, np.repeat(episodes, lengths), frame)
        chunk, number = divmod(shard.index, FILES_PER_CHUNK)
        place = f"chunk-{chunk:03d}/file-{number:03d}.parquet"
        chunks, files = np.full(len(firsts), chunk), np.full(len(firsts), number)
        labels = rows["label"].to_numpy()[firsts]
        meta = {
            "episode_index": episodes,
            "tasks": pa.array([[self.tasks[label]] for label in labels], pa.list_(pa.string())),
            "length": lengths,
            "data/chunk_index": chunks,
            "data/file_index": files,
            "dataset_from_index": frame + firsts,
            "dataset_to_index": frame + firsts + lengths,
            "meta/episodes/chunk_index": chunks,
            "meta/episodes/file_index": files,
            **{name: rows[name].take(firsts) for name in _OF_READERS if name in rows.schema.names},
            **columns_of_episodes(frames, firsts.tolist(), lengths.tolist()),
        }
        encodings = ((f"{IMAGE}.bytes", "PLAIN"),)
        style = store.ParquetStyle(self.rows_per_group, compression_level=3, encodings=encodings)
        index = {"id": episodes, "first_frame": frame + firsts, "frames": lengths}
        index |= {name: rows[name].take(firsts) for name in _OF_EPISODE if name in rows.schema.names}
        return with_files(
            pa.table(index),
            {
                f"{FOLDER}/data/{place}": store.encode_parquet(frames, style),
                f"{FOLDER}/meta/episodes/{place}": store.encode_parquet(pa.table(meta), META_STYLE),
            },
        )

    def _require_all(
        self, shard: store.ShardName, counts: Sequence[int], skipped: Sequence[store.Skipped]
    ) -> None:
        """Refuse a shard that lacks rounds, or has other counts than were planned (IntegrityError)."""
        if skipped:
            raise IntegrityError(
                f"{skipped[0].message}; episodes are numbered without gaps, so that none can be left out; "
                "nothing of this file was written",
                next="leave the round out first (`realtouch select`)",
            )
        planned = np.subtract(self.starts[shard.index + 1], self.starts[shard.index]).tolist()
        if planned != counts:
            episodes, frames = counts
            raise IntegrityError(
                f"{shard}: {episodes:,} episodes of {frames:,} frames in all, other than "
                "'video_length_frames' stated when the export was planned; nothing of this file was written",
                next="run `realtouch verify` on the source",
            )

    def _frames(self, rows: pa.Table, episodes: Int64, first: int) -> pa.Table:
        """Return the frames of a shard with their numbers, the first of which is ``first``."""
        known = {"id", "round_id", "touch"}.intersection(rows.schema.names)
        frames = rows.drop_columns(sorted(known))
        for name, values in (
            ("episode_index", episodes),
            ("index", first + np.arange(len(rows))),
            ("task_index", rows["label"].to_numpy() % len(self.tasks)),
        ):
            frames = frames.append_column(name, pa.array(values, pa.int64()))
        # What `datasets` makes of the columns; a class is a number here.
        return frames.cast(with_features(frames.schema, None))


@dataclass(frozen=True)
class _WriteMeta:
    """Writes the metadata of a LeRobotDataset after all its episodes."""

    split: str
    step: Episodes
    tasks: tuple[str, ...]
    are_clips: bool

    def __call__(self, folder: store.DataFolder, manifest: store.Manifest) -> dict[str, str]:
        """Return the checksum of each file of the LeRobotDataset by its path."""
        files = checksums(folder, manifest)
        placed = [list(files_of(folder, record)) for record in manifest.shards if record.rows]
        frames, episodes = (
            [read.Shard(folder.address(path)) for path in paths] for paths in zip(*placed, strict=True)
        )
        info = self._info(frames[0].schema, sum(map(len, episodes)), sum(map(len, frames)))
        meta = {
            "info.json": _json_bytes(info),
            "stats.json": _json_bytes(statistics_of_all(episodes, frames)),
            "tasks.parquet": store.encode_parquet(_task_table(self.tasks), META_STYLE),
        }
        return files | write_changed(folder, {f"{FOLDER}/meta/{name}": meta[name] for name in meta})

    def _info(self, frames: pa.Schema, episodes: int, total_frames: int) -> dict[str, object]:
        mark = Mark(self.step.names, self.are_clips, {each.name: each.stored for each in self.step.extras})
        return {
            "codebase_version": _VERSION,
            "robot_type": None,
            "total_episodes": episodes,
            "total_frames": total_frames,
            "total_tasks": len(self.tasks),
            "chunks_size": FILES_PER_CHUNK,
            "data_files_size_in_mb": FILE_BYTES >> 20,
            "video_files_size_in_mb": 200,
            "fps": self.step.fps,
            "splits": {self.split: f"0:{episodes}"},
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": None,
            "features": {each.name: self._feature(each) for each in frames},
            "realtouch": msgspec.to_builtins(mark),
        }

    def _feature(self, each: pa.Field) -> dict[str, object]:
        if each.type == MEDIA_TYPE:
            return {"dtype": "image", "shape": [*self.step.size, 3], "names": ["height", "width", "channels"]}
        names, width, leaf = _COMPONENTS.get(each.name), 1, each.type
        if pa.types.is_fixed_size_list(leaf):
            width, leaf = leaf.list_size, leaf.value_type
        return {"dtype": _dtype(leaf), "shape": [width], "names": names and list(names)}


def _dtype(data_type: pa.DataType) -> str:
    """Return LeRobot's name of a type, numpy's but for text."""
    return "string" if pa.types.is_string(data_type) else np.dtype(data_type.to_pandas_dtype()).name


def _json_bytes(values: Mapping[str, object]) -> bytes:
    return (json.dumps(values, indent=4) + "\n").encode()


def _task_table(tasks: Sequence[str]) -> pa.Table:
    """Return the tasks as pandas stores a table with a named index."""
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), "task": pa.array(tasks)})
    columns = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": stored, "metadata": None}
        for name, kind, stored in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    ]
    of_pandas = {"index_columns": ["task"], "column_indexes": [], "columns": columns}
    return table.replace_schema_metadata({"pandas": json.dumps({**of_pandas, "pandas_version": "2.0.0"})})


def columns_of_episodes(frames: pa.Table, starts: list[int], lengths: list[int]) -> dict[str, pa.Array]:
    """Return the statistics of each feature in each episode, as columns ``stats/FEATURE/STATISTIC``."""
    columns = {}
    for name in _counted(frames.schema):
        whole = frames.column(name).combine_chunks()
        found = [_episode(whole.slice(*part)) for part in zip(starts, lengths, strict=True)]
        data_type = pa.list_(pa.float64())
        if whole.type == MEDIA_TYPE:
            data_type = pa.list_(pa.list_(data_type))
        types = {**dict.fromkeys(_NAMES, data_type), "count": pa.list_(pa.int64())}
        for statistic, stored in types.items():
            values = [each[statistic] for each in found]
            columns[f"stats/{name}/{statistic}"] = pa.array(values, stored)
    return columns


def _episode(values: pa.Array) -> dict[str, object]:
    """Return the statistics of a feature in an episode; those of images are of a sample, from 0 to 1."""
    if values.type != MEDIA_TYPE:
        numbers = _flat_rows(values)
        found = [_statistics(*np.unique(column, return_counts=True)) for column in numbers.T]
        return {**{name: [each[name] for each in found] for name in found[0]}, "count": [len(values)]}
    seen = np.unique(np.linspace(0, len(values) - 1, _IMAGES_SEEN).round().astype(int)).tolist()
    counts = np.zeros((3, _LEVELS), np.int64)
    for number in seen:
        image = values[number].as_py()
        pixels = Image.fromarray(decoded(image["bytes"], image["path"]))
        counts += np.reshape(pixels.histogram(), (3, _LEVELS))
    found = [_statistics(np.flatnonzero(each) / (_LEVELS - 1), each[each > 0]) for each in counts]
    return {**{name: [[[each[name]]] for each in found] for name in found[0]}, "count": [len(seen)]}


def _statistics(values: Float64, counts: Int64) -> dict[str, float]:
    """Return the statistics of rising values, given how often each occurs; zeros without any.

    What is missing, NaN, does not count.
    """
    if not (math.isfinite(values[0]) and math.isfinite(values[-1])):
        is_known = np.isfinite(values)
        values, counts = values[is_known], counts[is_known]
    if not len(values):
        return dict.fromkeys((name for name in _NAMES if name != "count"), 0.0)
    total, below = int(counts.sum()), np.cumsum(counts)
    mean = math.fsum(values * counts) / total
    spread = math.sqrt(math.fsum(counts * (values - mean) ** 2) / total)
    found = {"min": values[0], "max": values[-1], "mean": mean, "std": spread}
    for name, share in _QUANTILES.items():
        rank = share * (total - 1)
        ends = np.searchsorted(below, [math.floor(rank), math.ceil(rank)], side="right")
        found[name] = values[ends[0]] + (values[ends[1]] - values[ends[0]]) * (rank % 1)
    return {name: float(value) for name, value in found.items()}


def statistics_of_all(episodes: Sequence[read.Shard], frames: Sequence[read.Shard]) -> dict[str, object]:
    """Return the statistics of all frames; of images put together from the episodes, as LeRobot does.

    Few numbers of each frame are in memory at a time, of long vectors one.
    """
    found: dict[str, Any] = {}
    total = sum(map(len, frames))
    for name in _counted(frames[0].schema):
        data_type = frames[0].schema.field(name).type
        if data_type == MEDIA_TYPE:
            found[name] = _put_together(episodes, name)
            continue
        width, columns = getattr(data_type, "list_size", 1), []
        step = max(1, _IN_MEMORY_BYTES // (8 * total))
        for start in range(0, width, step):
            parts = [_flat_rows(shard.column(name))[:, start : start + step] for shard in frames]
            for column in np.concatenate(parts).T:
                columns.append(_statistics(*np.unique(column, return_counts=True)))
        numbers = {statistic: [column[statistic] for column in columns] for statistic in columns[0]}
        found[name] = {**numbers, "count": [total]}
    return found


def _counted(frames: pa.Schema) -> list[str]:
    """Return the features that have statistics: numbers and images, but not texts."""
    return [each.name for each in frames if not pa.types.is_string(read.list_depth(each.type)[1])]


def _put_together(episodes: Sequence[read.Shard], name: str) -> dict[str, object]:
    """Put the statistics of the images of all episodes together, weighed by their counts."""
    columns = [f"stats/{name}/{statistic}" for statistic in _NAMES]
    table = pa.concat_tables([shard.read(columns=columns) for shard in episodes])
    parts = {each: _flat_rows(table[f"stats/{name}/{each}"]) for each in _NAMES}
    weights = parts.pop("count")[:, 0]
    total = int(weights.sum())

    def weighed(values: Float64) -> Float64:
        return np.array([math.fsum(column * weights) / total for column in values.T])

    found = {each: weighed(values) for each, values in parts.items()}
    square = weighed(parts["std"] ** 2 + (parts["mean"] - found["mean"]) ** 2)
    found |= {"min": parts["min"].min(axis=0), "max": parts["max"].max(axis=0), "std": np.sqrt(square)}
    return {**{each: values.reshape(-1, 1, 1).tolist() for each, values in found.items()}, "count": [total]}


def _flat_rows(values: pa.Array | pa.ChunkedArray) -> Float64:
    """Return lists of equal length, of whatever depth, as an array of a row for each."""
    if isinstance(values, pa.ChunkedArray):
        values = values.combine_chunks()
    count = len(values)
    while pa.types.is_list(values.type) or pa.types.is_fixed_size_list(values.type):
        values = values.flatten()
    flat: Float64 = values.to_numpy(zero_copy_only=False).reshape(count, -1)
    return flat.astype(np.float64, copy=False)
