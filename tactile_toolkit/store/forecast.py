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
    entries = []
    for split in dict.fromkeys(task.shard.split for task in chosen):
        sizes = [task.size for task in chosen if task.shard.split == split]
        todo = sum(task.size for task in state.todo if task.shard.split == split)
        entries.append(SplitForecast(split, sum(sizes), len(sizes), sum(sizes) - todo))
    left, sample = sum(task.size for task in state.todo), measure()
    while not isinstance(workers, int):
        workers = getattr(workers, "workers", 1)
    processes = workers or os.cpu_count() or 1  # all cores where a runner leaves that open
    seconds = left * sample.row_s / processes + (_START_S if left else 0)
    size = round(left * sample.row_bytes)
    return Forecast(tuple(entries), left, size, round(seconds, 1), sample.rows, replaced)


def _rows_there(folder: DataFolder) -> dict[str, int] | None:
    """Return the rows of each split of a data set; empty where its manifest cannot be read, None without."""
    try:
        manifest = manifest_so_far(folder)
    except IntegrityError:
        return {}
    return None if manifest is None else {name: row["rows"] for name, row in manifest.split_table().items()}
