"""LeRobotDataset v3.0 with images: one clip an episode, or one round of single images.

Facts of the format: frames lie in ``data/chunk-000/file-000.parquet``, 1,000 files a chunk, numbered over all
episodes; ``meta`` says where each episode begins, what the features are, and their statistics.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa

from realtouch.contact import ContactMethod
from realtouch.convert.plan import (
    Conversion,
    Made,
    RowChoice,
    Source,
    checksums,
    files_of,
    with_files,
    write_changed,
)
from realtouch.exchange.episodes import IMAGE, Episodes, numbered_starts, numbers_of_shard, only_split
from realtouch.exchange.lerobot_statistics import columns_of_episodes, statistics_of_all
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import ParquetStyle, encode_parquet
from tactile_toolkit.store.shards import ShardName, Skipped
from tactile_toolkit.touch.schema import MEDIA_TYPE, with_features

_FOLDER = "lerobot"
_VERSION = "v3.0"
_FILES_PER_CHUNK = 1000
_FILE_BYTES = 100 << 20
_GROUP_BYTES = 16 << 20
_OF_EPISODE = ("round_id", "touch", "label", "object_id")
_META_STYLE = ParquetStyle(rows_per_group=1 << 12, compression_level=3)


def plan(
    source: Source,
    choices: Mapping[str, Sequence[RowChoice]],
    method: ContactMethod,
    options: Mapping[str, Any],
) -> Conversion:
    """Plan a LeRobotDataset; reads footers, lengths and one header. InputError for several splits."""
    rows_per_shard = max(1, _FILE_BYTES // source.row_bytes())
    split = only_split(source, choices, "LeRobotDataset")
    starts = numbered_starts(source, split, choices[split], rows_per_shard)
    step = Episodes.of(source, split)
    tasks = tuple(f"touch an object of class {name}" for name in step.names)
    image_bytes = source.media_bytes() if source.kind == "single" else source.media_bytes() // 64 or 1
    return Conversion(
        source,
        "export",
        {**options, "fps": step.fps, "image_size": [step.size[1], step.size[0]]},
        step,
        choices,
        rows_per_shard=rows_per_shard,
        rows_per_group=1 << 12,
        extra_dirs=(_FOLDER,),
        write_files=_WriteMeta(split, step.fps, step.size, tasks),
        pack=_PackEpisodes(starts, tasks, max(1, _GROUP_BYTES // image_bytes)),
    )


@dataclass(frozen=True)
class _PackEpisodes:
    """Packs the frames of a shard and what is to be known of its episodes; keeps an index of those."""

    starts: Sequence[Sequence[int]] = field(repr=False)
    tasks: tuple[str, ...]
    rows_per_group: int

    def __call__(self, shard: ShardName, rows: pa.Table, skipped: Sequence[Skipped]) -> Made:
        """Return the frames and episodes of a shard, numbered over the whole data set."""
        rows = rows.combine_chunks()
        episodes, firsts, lengths = numbers_of_shard(self.starts, shard, rows, skipped)
        starts = firsts - firsts[:1]
        index = {"id": episodes, "first_frame": firsts, "frames": lengths}
        frames = rows.drop_columns(
            [name for name in ("id", "round_id", "touch") if name in rows.schema.names]
        )
        for name, values in (
            ("episode_index", np.repeat(episodes, lengths)),
            ("index", firsts[:1] + np.arange(len(rows))),
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
            "dataset_from_index": firsts,
            "dataset_to_index": firsts + lengths,
            "meta/episodes/chunk_index": chunks,
            "meta/episodes/file_index": files,
            **columns_of_episodes(frames, starts.tolist(), lengths.tolist()),
        }
        encodings = ((f"{IMAGE}.bytes", "PLAIN"),)
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
