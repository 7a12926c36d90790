"""What a run would make, how large and how long, before it is started."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from dataset_store.build import BuildPlan, BuildState

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

    Attributes
    ----------
    splits : tuple of SplitForecast
        One per split asked for.
    rows_to_make : int
        Rows that are not finished yet.
    bytes : int
        Parquet to be written, from a sample.
    seconds : float
        Time, from the same sample.
    sampled : int
        How many rows were made for the estimate.
    """

    splits: tuple[SplitForecast, ...]
    rows_to_make: int
    bytes: int
    seconds: float
    sampled: int

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


def forecast_build(
    plan: BuildPlan, state: BuildState, workers: int, measure: Callable[[], Sample]
) -> Forecast:
    """Estimate a run from what a folder holds of its plan and from a few rows; writes nothing.

    Parameters
    ----------
    plan : BuildPlan
        What is to be made.
    state : BuildState
        What the folder holds of it.
    workers : int
        Processes that will work.
    measure : callable
        Makes a few rows.
    """
    todo = {task.shard for task in state.todo}
    entries = []
    for split in dict.fromkeys(task.shard.split for task in plan.tasks):
        tasks = [task for task in plan.tasks if task.shard.split == split]
        finished = sum(task.size for task in tasks if task.shard not in todo)
        entries.append(SplitForecast(split, sum(task.size for task in tasks), len(tasks), finished))
    left = sum(entry.rows - entry.finished for entry in entries)
    sample = measure()
    seconds = left * sample.row_s / workers + (_START_S if left else 0)
    return Forecast(tuple(entries), left, round(left * sample.row_bytes), round(seconds, 1), sample.rows)
