"""A tiny kind of data set, so that the store is tested without any package of data sets."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from tactile_toolkit.store import (
    BuildPlan,
    Manifest,
    ParquetStyle,
    ShardContent,
    ShardName,
    Skipped,
    build,
    open_folder,
)
from tests.mesh_columns import list_array

SPLITS = ("train", "test")
STYLE = ParquetStyle(rows_per_group=3)
SCHEMA = pa.schema(
    [
        pa.field("id", pa.int64()),
        pa.field("label", pa.int64()),
        pa.field("points", pa.list_(pa.list_(pa.float32(), 3))),
    ]
)


def points(number: int) -> np.ndarray:
    """Return points of different numbers, zero among them."""
    rng = np.random.default_rng(number)
    return rng.normal(size=(number % 5, 3)).astype(np.float32)


@dataclass(frozen=True)
class ToyTask:
    """Makes ``ids``; every tenth id is skipped. ``die_once`` names a file: while absent, the worker dies.
    ``pause_until`` names a file to wait for.
    """

    shard: ShardName
    ids: tuple[int, ...]
    die_once: str | None = None
    die_always: bool = False
    pause_s: float = 0.0
    pause_until: str | None = None
    error: Exception | None = field(default=None)

    @property
    def size(self) -> int:
        return len(self.ids)

    def source_digest(self) -> None:
        return None

    def make(self) -> ShardContent:
        if self.error is not None:
            raise self.error
        if self.die_always or (self.die_once and not Path(self.die_once).exists()):
            if self.die_once:
                Path(self.die_once).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(self.pause_s)
        while self.pause_until and not Path(self.pause_until).exists():
            time.sleep(0.01)
        kept = [number for number in self.ids if number % 10 != 9]
        table = pa.Table.from_arrays(
            [
                pa.array(kept, pa.int64()),
                pa.array([number % 3 for number in kept], pa.int64()),
                list_array([points(number) for number in kept], pa.float32()),
            ],
            schema=SCHEMA,
        )
        report = pa.table({"id": kept, "shard": [str(self.shard)] * len(kept)})
        skipped = tuple(
            Skipped(number, "nine", f"{number} ends with 9") for number in self.ids if number % 10 == 9
        )
        return ShardContent(table, skipped, report)


def toy_plan(splits: tuple[str, ...] = SPLITS, spec: dict | None = None, **task_options: object) -> BuildPlan:
    """Four shards of five ids for train (0..19), two for test (100..109)."""
    layout = {"train": (0, 4), "test": (100, 2)}
    tasks = []
    for split in splits:
        first, count = layout[split]
        for index in range(count):
            ids = tuple(range(first + index * 5, first + index * 5 + 5))
            tasks.append(ToyTask(ShardName(split, index, count), ids, **task_options))
    return BuildPlan(
        "toy", spec or {"seed": 1, "size": (1, 2)}, SPLITS, tuple(tasks), STYLE, "reports/toy.parquet"
    )


def folder_bytes(folder: Path) -> dict[str, bytes]:
    """Return the content of all files in a folder, by relative path."""
    return {str(f.relative_to(folder)): f.read_bytes() for f in sorted(folder.rglob("*")) if f.is_file()}


def make(path: Path | str, plan: BuildPlan | None = None, **options: Any) -> Manifest:
    """Make a plan, by default the usual one, in a folder."""
    return build(open_folder(str(path)), plan or toy_plan(), **options)
