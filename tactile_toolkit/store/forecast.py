"""What a run would make, how large and how long, before it is started."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.run.processes import Runner
from tactile_toolkit.store.build import look_for
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.job import manifest_so_far
from tactile_toolkit.store.plan import BuildPlan

__all__ = ["Forecast", "Sample", "SplitForecast", "forecast_build"]

_START_S = 1.5
"""What workers need to start and import their libraries."""


@dataclass(frozen=True, slots=True)
class Sample:
    """What a few rows took: how many were made, and bytes and seconds of one."""

    rows: int
    row_bytes: float
    row_s: float


@dataclass(frozen=True, slots=True)
class SplitForecast:
    """One split: its rows and shards, and how many rows are finished already."""

    split: str
    rows: int
    shards: int
    finished: int


@dataclass(frozen=True, slots=True)
class Forecast:
    """What a run would do.

    ``bytes`` of Parquet and ``seconds`` are estimated from ``sampled`` rows that were made. ``replaced`` are
    the rows of each split of the data set that the run would replace; None where it would replace none.
    """

    splits: tuple[SplitForecast, ...]
    rows_to_make: int
    bytes: int
    seconds: float
    sampled: int
    replaced: dict[str, int] | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


def forecast_build(
    out: str | os.PathLike[str],
    plan: BuildPlan,
    workers: int | Runner,
    measure: Callable[[], Sample],
    *,
    overwrite: bool = False,
) -> Forecast:
    """Estimate a run from what a folder holds of its plan and from a few rows, which ``measure`` makes.

    Of a :class:`~tactile_toolkit.run.parts.Part`, the shards of that part count. Writes nothing. Raises
    InputError when the run would be refused in that folder, and MissingPartsError where a
    :class:`~tactile_toolkit.run.parts.Finish` would.
    """
    folder = DataFolder(os.fspath(out))
    chosen, state = look_for(folder, plan, workers, overwrite=overwrite)
    replaced = _rows_there(folder) if overwrite else None
    todo = {task.shard for task in state.todo}
    entries = []
    for split in dict.fromkeys(task.shard.split for task in chosen):
        tasks = [task for task in chosen if task.shard.split == split]
        finished = sum(task.size for task in tasks if task.shard not in todo)
        entries.append(SplitForecast(split, sum(task.size for task in tasks), len(tasks), finished))
    left = sum(entry.rows - entry.finished for entry in entries)
    sample = measure()
    seconds = left * sample.row_s / _processes(workers) + (_START_S if left else 0)
    size = round(left * sample.row_bytes)
    return Forecast(tuple(entries), left, size, round(seconds, 1), sample.rows, replaced)


def _processes(runner: int | Runner) -> int:
    """Return how many processes make the rows; all cores where a runner leaves that open."""
    while not isinstance(runner, int):
        runner = getattr(runner, "workers", 1)
    return runner or os.cpu_count() or 1


def _rows_there(folder: DataFolder) -> dict[str, int] | None:
    """Return the rows of each split of a data set; empty where its manifest cannot be read, None without."""
    try:
        manifest = manifest_so_far(folder)
    except IntegrityError:
        return {}
    return None if manifest is None else {name: row["rows"] for name, row in manifest.split_table().items()}
