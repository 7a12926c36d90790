"""LeRobotDatasets as LeRobot 0.3 (v2.1) and 0.4 (v3.0) write them, with a known content."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tests.realtouch import factories
from tests.realtouch.factories import FPS

CAMERA = "observation.images.tactile"
LENGTHS = (5, 7, 4)
SIZE = (32, 48)
TASKS = ("press it", "slide along it")
IMAGE_TYPE = pa.struct({"bytes": pa.binary(), "path": pa.string()})
V2_DATA = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
V2_VIDEO = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
V3_DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
V3_VIDEO = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"


@dataclass(frozen=True)
class Truth:
    """Content of a data set: pictures and columns of each episode."""

    lengths: Sequence[int] = LENGTHS
    cameras: Sequence[str] = (CAMERA,)
    random: np.random.Generator = field(default_factory=lambda: np.random.default_rng(5), repr=False)

    @cached_property
    def pixels(self) -> list[np.ndarray]:
        """Pictures of each episode, (n, H, W, 3): a bright bar that moves through a colour of the episode."""
        found = []
        for number, length in enumerate(self.lengths):
            pictures = np.full((length, *SIZE, 3), 40 * number + 30, np.uint8)
            for frame in range(length):
                pictures[frame, :, 4 * frame : 4 * frame + 4] = 220
            found.append(pictures)
        return found

    @cached_property
    def columns(self) -> list[dict[str, Any]]:
        """Columns of each episode, without pictures."""
        starts = np.cumsum([0, *self.lengths])
        return [
            {
                "observation.state": self.random.normal(size=(length, 7)).astype(np.float32),
                "observation.force": self.random.normal(size=(length, 3)),
                "temperature": self.random.normal(size=length),
                "next.done": np.arange(length) == length - 1,
                "note": np.array([f"frame {frame}" for frame in range(length)]),
                "timestamp": (np.arange(length) / FPS).astype(np.float32),
                "frame_index": np.arange(length),
                "episode_index": np.full(length, number),
                "index": starts[number] + np.arange(length),
                "task_index": np.full(length, number % len(TASKS)),
            }
            for number, length in enumerate(self.lengths)
        ]

    @cached_property
    def jpegs(self) -> list[list[bytes]]:
        """The pictures, encoded."""
        return [list(map(factories.encode_jpeg, pixels)) for pixels in self.pixels]

    def table(self, number: int, has_images: bool) -> pa.Table:
        """Return the rows of an episode."""
        columns = {name: _arrow(values) for name, values in self.columns[number].items()}
        for camera in self.cameras if has_images else ():
            images = [
                {"bytes": jpeg, "path": f"frame-{frame:06d}.png"}
                for frame, jpeg in enumerate(self.jpegs[number])
            ]
            columns[camera] = pa.array(images, IMAGE_TYPE)
        return pa.table(columns)


def _arrow(values: np.ndarray) -> pa.Array:
    if values.ndim == 1:
        return pa.array(values)
    return pa.FixedSizeListArray.from_arrays(pa.array(values.reshape(-1)), values.shape[1])


def info_of(truth: Truth, version: str, dtype: str) -> dict[str, Any]:
    """Return the content of ``meta/info.json``."""
    features: dict[str, Any] = {
        name: {"dtype": str(values.dtype), "shape": list(values.shape[1:]) or [1], "names": None}
        for name, values in truth.columns[0].items()
    }
    features["note"]["dtype"] = "string"
    for camera in truth.cameras:
        features[camera] = {"dtype": dtype, "shape": [*SIZE, 3], "names": ["height", "width", "channels"]}
    is_v3 = version == "v3.0"
    return {
        "codebase_version": version,
        "robot_type": "so100",
        "total_episodes": len(truth.lengths),
        "total_frames": sum(truth.lengths),
        "chunks_size": 2,
        "fps": FPS,
        "splits": {"train": "0:2", "test": f"2:{len(truth.lengths)}"},
        "data_path": V3_DATA if is_v3 else V2_DATA,
        "video_path": (V3_VIDEO if is_v3 else V2_VIDEO) if dtype == "video" else None,
        "features": features,
    }


def write_lerobot(
    home: Path, version: str = "v3.0", dtype: str = "image", truth: Truth | None = None
) -> Truth:
    """Write a data set below a folder; return its content."""
    truth = truth or Truth()
    write_json(home / "meta" / "info.json", info_of(truth, version, dtype))
    (_write_v3 if version == "v3.0" else _write_v2)(home, truth, dtype)
    return truth


def write_json(path: Path, content: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


def _write_v2(home: Path, truth: Truth, dtype: str) -> None:
    episodes = [
        {
            "episode_index": number,
            "tasks": [TASKS[number % len(TASKS)]],
            "length": length,
            "operator": f"o{number}",
        }
        for number, length in enumerate(truth.lengths)
    ]
    tasks = [{"task_index": number, "task": task} for number, task in enumerate(TASKS)]
    for name, lines in (("episodes", episodes), ("tasks", tasks)):
        (home / "meta" / f"{name}.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    for number in range(len(truth.lengths)):
        numbers = {"episode_chunk": number // 2, "episode_index": number}
        _write_table(home / V2_DATA.format(**numbers), truth.table(number, dtype == "image"))
        for camera in truth.cameras if dtype == "video" else ():
            _write_video(home / V2_VIDEO.format(video_key=camera, **numbers), truth.pixels[number])


def _write_v3(home: Path, truth: Truth, dtype: str) -> None:
    """Write the first two episodes into one file, the others into the next."""
    every = list(range(len(truth.lengths)))
    files = [numbers for numbers in (every[:2], every[2:]) if numbers]
    pandas = {
        "index_columns": ["__index_level_0__"],
        "column_indexes": [],
        "columns": [],
        "pandas_version": "2.0.0",
    }
    tasks = pa.table({"task_index": range(len(TASKS)), "__index_level_0__": list(TASKS)})
    _write_table(
        home / "meta" / "tasks.parquet", tasks.replace_schema_metadata({"pandas": json.dumps(pandas)})
    )
    for file, numbers in enumerate(files):
        place = {"chunk_index": 0, "file_index": file}
        lines, start_s = [], 0.0
        for number in numbers:
            length = truth.lengths[number]
            first = sum(truth.lengths[:number])
            line = {
                "episode_index": number,
                "tasks": [TASKS[number % 2]],
                "length": length,
                "operator": f"o{number}",
            }
            line |= {"dataset_from_index": first, "dataset_to_index": first + length}
            line |= {
                f"{folder}/{name}": value
                for folder in ("data", "meta/episodes")
                for name, value in place.items()
            }
            for camera in truth.cameras if dtype == "video" else ():
                at = f"videos/{camera}/"
                line |= {f"{at}{name}": value for name, value in place.items()}
                line |= {f"{at}from_timestamp": start_s, f"{at}to_timestamp": start_s + length / FPS}
            start_s += length / FPS
            lines.append({**line, "stats/temperature/mean": [0.0]})
        _write_table(
            home / "meta" / "episodes" / "chunk-000" / f"file-{file:03d}.parquet", pa.Table.from_pylist(lines)
        )
        rows = pa.concat_tables([truth.table(number, dtype == "image") for number in numbers])
        _write_table(home / V3_DATA.format(**place), rows, row_group_size=3)
        for camera in truth.cameras if dtype == "video" else ():
            pixels = np.concatenate([truth.pixels[number] for number in numbers])
            _write_video(home / V3_VIDEO.format(video_key=camera, **place), pixels)


def _write_table(path: Path, table: pa.Table, row_group_size: int | None = None) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, path, row_group_size=row_group_size)


def _write_video(path: Path, pixels: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(factories.encode_avi(pixels, "libx264", "mp4"))
