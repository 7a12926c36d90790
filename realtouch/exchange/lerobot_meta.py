"""What a LeRobotDataset v3.0 states of itself below ``meta``: its features, tasks and statistics."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from realtouch.convert.plan import checksums, files_of, write_changed
from realtouch.exchange.lerobot_statistics import statistics_of_all
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import ParquetStyle, encode_parquet
from tactile_toolkit.touch.schema import MEDIA_TYPE

FOLDER = "lerobot"
FILES_PER_CHUNK = 1000
FILE_BYTES = 100 << 20
META_STYLE = ParquetStyle(rows_per_group=1 << 12, compression_level=3)

_VERSION = "v3.0"


@dataclass(frozen=True)
class WriteMeta:
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
            "tasks.parquet": encode_parquet(_task_table(self.tasks), META_STYLE),
        }
        for name, content in meta.items():
            path = f"{FOLDER}/meta/{name}"
            files[path] = write_changed(folder, path, content)
        return files

    def _info(self, frames: pa.Schema, episodes: int, total_frames: int) -> dict[str, Any]:
        return {
            "codebase_version": _VERSION,
            "robot_type": None,
            "total_episodes": episodes,
            "total_frames": total_frames,
            "total_tasks": len(self.tasks),
            "chunks_size": FILES_PER_CHUNK,
            "data_files_size_in_mb": FILE_BYTES >> 20,
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
