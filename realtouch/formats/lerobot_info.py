"""Metadata of a LeRobotDataset v3.0: ``info.json``, ``stats.json``, ``tasks.parquet`` in ``meta``."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgspec
import pyarrow as pa

from realtouch import convert
from realtouch.formats import lerobot_depth, lerobot_mark, lerobot_statistics
from realtouch.formats.episodes import ACTION, DEPTH, STATE, Episodes
from tactile_toolkit import read, store, touch

FOLDER = "lerobot"
FILES_PER_CHUNK = 1000
FILE_BYTES = 100 << 20
_VERSION = "v3.0"
META_STYLE = store.ParquetStyle(rows_per_group=1 << 12, compression_level=3)
_POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
_AXES = ("height", "width", "channels")
_COMPONENTS = {STATE: list(_POSE), ACTION: list(_POSE[:2])}


@dataclass(frozen=True)
class WriteMeta:
    """Writes the metadata of a LeRobotDataset after all its episodes."""

    step: Episodes
    tasks: tuple[str, ...]

    def __call__(self, folder: store.DataFolder, manifest: store.Manifest) -> dict[str, str]:
        """Return the checksum of each file of the LeRobotDataset by its path."""
        files = convert.checksums(folder, manifest)
        placed = [list(convert.files_of(folder, record)) for record in manifest.shards if record.rows]
        frames, episodes = (
            [read.Shard(folder.address(path)) for path in paths] for paths in zip(*placed, strict=True)
        )
        info = self._info(frames[0].schema, sum(map(len, episodes)), sum(map(len, frames)))
        meta = {
            "info.json": _json_bytes(info),
            "stats.json": _json_bytes(lerobot_statistics.statistics_of_all(episodes, frames)),
            "tasks.parquet": store.encode_parquet(_task_table(self.tasks), META_STYLE),
        }
        return files | convert.write_changed(folder, {f"{FOLDER}/meta/{name}": meta[name] for name in meta})

    def _info(self, frames: pa.Schema, episodes: int, total_frames: int) -> dict[str, object]:
        step = self.step
        mark = lerobot_mark.Mark(step.names, step.are_clips, {each.name: each.stored for each in step.extras})
        return {
            "codebase_version": _VERSION,
            "robot_type": None,
            "total_episodes": episodes,
            "total_frames": total_frames,
            "total_tasks": len(self.tasks),
            "chunks_size": FILES_PER_CHUNK,
            "data_files_size_in_mb": FILE_BYTES >> 20,
            "video_files_size_in_mb": 200,
            "fps": step.fps,
            "splits": {step.split: f"0:{episodes}"},
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": None,
            "features": {each.name: self._feature(each) for each in frames},
            "realtouch": msgspec.to_builtins(mark),
        }

    def _feature(self, each: pa.Field) -> dict[str, object]:
        if each.type == touch.MEDIA_TYPE:
            picture: dict[str, object] = {"dtype": "image", "shape": [*self.step.size, 3], "names": [*_AXES]}
            if each.name == DEPTH:
                picture |= {"shape": [*self.step.size, 1], "info": lerobot_depth.INFO}
            return picture
        width, leaf = 1, each.type
        if pa.types.is_fixed_size_list(leaf):
            width, leaf = leaf.list_size, leaf.value_type
        return {"dtype": read.dtype_name(leaf), "shape": [width], "names": _COMPONENTS.get(each.name)}


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
