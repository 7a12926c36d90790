"""Touches as a LeRobotDataset v3.0 with images: an episode is a clip, or a round of single images.

Facts of the format: frames are in ``data/chunk-000/file-000.parquet``, 1,000 files in a chunk, and are
numbered over all episodes; ``meta`` has the start of each episode, the features, and their statistics. Depth
maps are lossless TIFF of float32 in metres, as LeRobot 0.6 stores depth. A feature of maps has one channel,
and ``info`` with ``is_depth_map`` and ``depth_unit``, which is ``m`` or ``mm``. Statistics are in that unit,
while those of colours are scaled to 1.

LeRobot normalises the inputs of a policy with the statistics. It combines those of episodes when data sets
are split or merged. Sums are exact, so the results do not depend on the processor. ``info.json`` has a mark,
by which an import restores the names of columns.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
import pyarrow as pa
from PIL import Image

from realtouch import contact
from realtouch.convert import conversion
from realtouch.formats.exports import ACTION, DEPTH, STATE, EpisodeNumbers, Episodes
from realtouch.formats.lerobot_import import Mark
from realtouch.touches import datasets, loading, media, schema, stored_round
from realtouch.touches.media import decoded
from tactile_toolkit import read, store, touch
from tactile_toolkit.touch import MEDIA_TYPE
from tactile_toolkit.value_types import Float32, Float64, Int64, JsonDict

_DEPTH_INFO = {"is_depth_map": True, "depth_unit": "m"}
_FOLDER = "lerobot"
_FILES_PER_CHUNK = 1000
_FILE_BYTES = 100 << 20
_VERSION = "v3.0"
_META_STYLE = store.ParquetStyle(rows_per_group=1 << 12, compression_level=3)
_POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
_AXES = ("height", "width", "channels")
_COMPONENTS = {STATE: list(_POSE), ACTION: list(_POSE[:2])}
_GROUP_BYTES = 16 << 20
_INDEX_COLUMNS = ("round_id", "touch", "label", "object_id")
_META_COLUMNS = ("round_id", "touch")
_NUMBER_BYTES = 4  # of float32
# Number of images of an episode that are decoded for its statistics.
_IMAGE_SAMPLES = 8
_LEVELS = 256
_IN_MEMORY_BYTES = 64 << 20
_QUANTILES = {f"q{round(100 * share):02d}": share for share in (0.01, 0.10, 0.50, 0.90, 0.99)}
_NAMES = ("min", "max", "mean", "std", "count", *_QUANTILES)


def plan_lerobot(
    source: loading.Source,
    choices: conversion.Choices,
    method: contact.ContactMethod,
    options: Mapping[str, object],
) -> conversion.Conversion:
    """Plan a LeRobotDataset; reads footers, lengths and the header of one image.

    Raises InputError for several splits.
    """
    rows_per_shard = max(1, _FILE_BYTES // source.row_bytes())
    step = Episodes.of(source, choices, "LeRobotDataset", pa.float32())
    step = replace(step, depth_of=_depth_of)
    numbers = EpisodeNumbers.of(source, step, choices[step.split], rows_per_shard)
    tasks = tuple(f"touch an object of class {name}" for name in step.names)
    if (datasets.dataset_of(source.shards[step.split]).labels < 0).any():
        tasks += ("touch an object",)  # the last, as -1 counts from the end
    frame_bytes = source.image_bytes()
    if DEPTH in step.schema(source.schema).names:
        frame_bytes += _NUMBER_BYTES * math.prod(step.size)
    return conversion.Conversion(
        source,
        "export",
        {**options, "fps": step.fps, "image_size": [step.size[1], step.size[0]]},
        step,
        choices,
        rows_per_shard=rows_per_shard,
        rows_per_group=1 << 12,
        extra_dirs=(_FOLDER,),
        write_files=_WriteMeta(step, tasks),
        pack=_PackEpisodes(numbers, tasks, max(1, _GROUP_BYTES // frame_bytes)),
    )


@dataclass(frozen=True)
class _PackEpisodes:
    """Packs the frames of a shard and the table of its episodes; keeps an index of episodes."""

    numbers: EpisodeNumbers
    tasks: tuple[str, ...]
    rows_per_group: int

    def __call__(
        self, shard: store.ShardName, rows: pa.Table, skipped: Sequence[store.Skipped]
    ) -> conversion.Made:
        """Return the frames and episodes of a shard, numbered over the whole data set.

        Raises IntegrityError if a round was left out, or if lengths differ from those that were stated.
        """
        rows = rows.combine_chunks()
        firsts = np.flatnonzero(rows["frame_index"].to_numpy() == 0)
        episode, frame = self.numbers.of_shard(shard, [len(firsts), len(rows)], skipped)
        episodes = episode + np.arange(len(firsts))
        lengths = np.diff([*firsts, len(rows)])
        frames = self._frames(rows, np.repeat(episodes, lengths), frame)
        chunk, number = divmod(shard.index, _FILES_PER_CHUNK)
        file = f"chunk-{chunk:03d}/file-{number:03d}.parquet"
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
            **{name: rows[name].take(firsts) for name in _META_COLUMNS if name in rows.schema.names},
            **columns_of_episodes(frames, firsts.tolist(), lengths.tolist()),
        }
        pictures = [field.name for field in rows.schema if field.type == touch.MEDIA_TYPE]
        encodings = tuple((f"{name}.bytes", "PLAIN") for name in pictures)
        style = store.ParquetStyle(self.rows_per_group, compression_level=3, encodings=encodings)
        index = {"id": episodes, "first_frame": frame + firsts, "frames": lengths}
        index |= {name: rows[name].take(firsts) for name in _INDEX_COLUMNS if name in rows.schema.names}
        return conversion.with_files(
            pa.table(index),
            {
                f"{_FOLDER}/data/{file}": style.encode(frames),
                f"{_FOLDER}/meta/episodes/{file}": _META_STYLE.encode(pa.table(meta)),
            },
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
        # Types of the columns for `datasets`; a class is a number here.
        return frames.cast(touch.with_features(frames.schema, None))


def _depth_of(row: stored_round.StoredRound, size: tuple[int, int]) -> pa.Array:
    """Return the encoded depth maps of a round; IntegrityError for a map of another size."""
    files = []
    for number, depth_m in enumerate(media.DepthMaps(row, media.DEPTH)):
        if depth_m.shape != size:
            raise row.damaged(media.DEPTH, f"a map {depth_m.shape}; expected {size} as the images", number)
        files.append({"bytes": _tiff(depth_m), "path": f"{row.name()}_{number:03d}.tiff"})
    return pa.array(files, MEDIA_TYPE)


def _tiff(depth_m: Float32) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(depth_m).save(stream, "TIFF")
    return stream.getvalue()


def columns_of_episodes(frames: pa.Table, starts: list[int], lengths: list[int]) -> dict[str, pa.Array]:
    """Return the statistics of each feature in each episode, as columns ``stats/FEATURE/STATISTIC``."""
    columns = {}
    for name in _counted(frames.schema):
        whole = frames.column(name).combine_chunks()
        data_type = pa.list_(pa.float64())
        of_episodes = [_episode(name, whole.slice(*part)) for part in zip(starts, lengths, strict=True)]
        if whole.type == touch.MEDIA_TYPE:
            data_type = pa.list_(pa.list_(data_type))
        types = {**dict.fromkeys(_NAMES, data_type), "count": pa.list_(pa.int64())}
        for statistic, stored in types.items():
            columns[f"stats/{name}/{statistic}"] = pa.array(
                [statistics[statistic] for statistics in of_episodes], stored
            )
    return columns


def _episode(name: str, values: pa.Array) -> dict[str, object]:
    """Return the statistics of a feature in an episode; for images, those of a sample of them."""
    if values.type != touch.MEDIA_TYPE:
        numbers = _flat_rows(values)
        statistics = [_statistics(*np.unique(column, return_counts=True)) for column in numbers.T]
        return {**_transposed(statistics), "count": [len(values)]}
    images = [values[number].as_py() for number in media.evenly_spaced(len(values), _IMAGE_SAMPLES)]
    if name == DEPTH:
        channels = [_counted_depths(image["bytes"] for image in images)]
    else:
        counts = np.zeros((3, _LEVELS), np.int64)
        for image in images:
            pixels = Image.fromarray(decoded(image["bytes"], image["path"]))
            counts += np.reshape(pixels.histogram(), (3, _LEVELS))
        # Colours are scaled to 1.
        channels = [(np.flatnonzero(counted) / (_LEVELS - 1), counted[counted > 0]) for counted in counts]
    statistics = [_statistics(*channel) for channel in channels]
    return {
        **{key: [[[number]] for number in column] for key, column in _transposed(statistics).items()},
        "count": [len(images)],
    }


def _transposed(rows: Sequence[dict[str, float]]) -> dict[str, list[float]]:
    return {name: [row[name] for row in rows] for name in rows[0]}


def _statistics(values: Float64, counts: Int64) -> dict[str, float]:
    """Return the statistics of sorted values, given how often each occurs; zeros if there are no values.

    NaN is a missing value and does not count.
    """
    if not (math.isfinite(values[0]) and math.isfinite(values[-1])):
        is_known = np.isfinite(values)
        values, counts = values[is_known], counts[is_known]
    if not len(values):
        return dict.fromkeys((name for name in _NAMES if name != "count"), 0.0)
    total = int(counts.sum())
    below = np.cumsum(counts)
    mean = math.fsum(values * counts) / total
    spread = math.sqrt(math.fsum(counts * (values - mean) ** 2) / total)
    statistics = {"min": values[0], "max": values[-1], "mean": mean, "std": spread}
    for name, share in _QUANTILES.items():
        rank = share * (total - 1)
        ends = np.searchsorted(below, [math.floor(rank), math.ceil(rank)], side="right")
        statistics[name] = values[ends[0]] + (values[ends[1]] - values[ends[0]]) * (rank % 1)
    return {name: float(value) for name, value in statistics.items()}


def statistics_of_all(episodes: Sequence[read.Shard], frames: Sequence[read.Shard]) -> dict[str, object]:
    """Return the statistics of all frames; those of images are combined from episodes, as LeRobot does.

    Only a few numbers of each frame are in memory at a time; one if there are many frames.
    """
    statistics: JsonDict = {}
    total = sum(map(len, frames))
    for name in _counted(frames[0].schema):
        data_type = frames[0].schema.field(name).type
        if data_type == touch.MEDIA_TYPE:
            statistics[name] = _combined(episodes, name)
            continue
        width = getattr(data_type, "list_size", 1)
        columns = []
        step = max(1, _IN_MEMORY_BYTES // (8 * total))
        for start in range(0, width, step):
            parts = [_flat_rows(shard.column(name))[:, start : start + step] for shard in frames]
            for column in np.concatenate(parts).T:
                columns.append(_statistics(*np.unique(column, return_counts=True)))
        statistics[name] = {**_transposed(columns), "count": [total]}
    return statistics


def _counted(frames: pa.Schema) -> list[str]:
    """Return the features that have statistics: numbers and images, but not texts."""
    return [field.name for field in frames if not pa.types.is_string(read.list_depth(field.type)[1])]


def _combined(episodes: Sequence[read.Shard], name: str) -> dict[str, object]:
    """Return the statistics of the images of all episodes, weighted by their counts."""
    columns = [f"stats/{name}/{statistic}" for statistic in _NAMES]
    table = pa.concat_tables([shard.read(columns=columns) for shard in episodes])
    parts = {statistic: _flat_rows(table[f"stats/{name}/{statistic}"]) for statistic in _NAMES}
    weights = parts.pop("count")[:, 0]
    total = int(weights.sum())

    def weighted_mean(values: Float64) -> Float64:
        return np.array([math.fsum(column * weights) / total for column in values.T])

    combined = {statistic: weighted_mean(values) for statistic, values in parts.items()}
    variance = weighted_mean(parts["std"] ** 2 + (parts["mean"] - combined["mean"]) ** 2)
    combined |= {"min": parts["min"].min(axis=0), "max": parts["max"].max(axis=0), "std": np.sqrt(variance)}
    return {
        **{statistic: values.reshape(-1, 1, 1).tolist() for statistic, values in combined.items()},
        "count": [total],
    }


def _flat_rows(values: pa.Array | pa.ChunkedArray) -> Float64:
    """Return lists of equal length and any depth as an array with a row for each."""
    if isinstance(values, pa.ChunkedArray):
        values = values.combine_chunks()
    rows = schema.array_with_gaps(values)
    return rows.reshape(len(rows), -1).astype(np.float64, copy=False)


def _counted_depths(files: Iterable[bytes]) -> tuple[Float64, Int64]:
    """Return the sorted values of some maps, and how often each occurs."""
    maps = [np.asarray(Image.open(io.BytesIO(content), formats=["TIFF"]), np.float64) for content in files]
    values, counts = np.unique(np.concatenate(maps), return_counts=True)
    return values, counts


@dataclass(frozen=True)
class _WriteMeta:
    """Writes the metadata of a LeRobotDataset after all its episodes."""

    step: Episodes
    tasks: tuple[str, ...]

    def __call__(self, folder: store.DataFolder, manifest: store.Manifest) -> dict[str, str]:
        """Return the checksum of each file of the LeRobotDataset by its path."""
        files = conversion.checksums(folder, manifest)
        placed = [list(conversion.files_of(folder, record.file)) for record in manifest.shards if record.rows]
        frames, episodes = (
            [read.Shard(folder.address(path)) for path in paths] for paths in zip(*placed, strict=True)
        )
        info = self._info(frames[0].schema, sum(map(len, episodes)), sum(map(len, frames)))
        meta = {
            "info.json": _json_bytes(info),
            "stats.json": _json_bytes(statistics_of_all(episodes, frames)),
            "tasks.parquet": _META_STYLE.encode(_task_table(self.tasks)),
        }
        return files | conversion.write_changed(
            folder, {f"{_FOLDER}/meta/{name}": meta[name] for name in meta}
        )

    def _info(self, frames: pa.Schema, episodes: int, total_frames: int) -> dict[str, object]:
        step = self.step
        mark = Mark(step.names, step.are_clips, step.own_names, tuple(step.names_of_clips))
        return {
            "codebase_version": _VERSION,
            "robot_type": None,
            "total_episodes": episodes,
            "total_frames": total_frames,
            "total_tasks": len(self.tasks),
            "chunks_size": _FILES_PER_CHUNK,
            "data_files_size_in_mb": _FILE_BYTES >> 20,
            "video_files_size_in_mb": 200,
            "fps": step.fps,
            "splits": {step.split: f"0:{episodes}"},
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": None,
            "features": {field.name: self._feature(field) for field in frames},
            "realtouch": msgspec.to_builtins(mark),
        }

    def _feature(self, field: pa.Field) -> dict[str, object]:
        if field.type == touch.MEDIA_TYPE:
            picture: dict[str, object] = {"dtype": "image", "shape": [*self.step.size, 3], "names": [*_AXES]}
            if field.name == DEPTH:
                picture |= {"shape": [*self.step.size, 1], "info": _DEPTH_INFO}
            return picture
        width = 1
        leaf = field.type
        if pa.types.is_fixed_size_list(leaf):
            width, leaf = leaf.list_size, leaf.value_type
        names = _COMPONENTS.get(field.name)
        if names is not None and len(names) != width:  # actions of a policy
            names = None
        return {"dtype": read.dtype_name(leaf), "shape": [width], "names": names}


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
