"""What a run would make, how large and how long, before it is started."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.store.build import BuildPlan, BuildState, inspect_folder
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest, manifest_so_far
from tactile_toolkit.store.replace import require_replaceable
from tactile_toolkit.versions import toolkit_version

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
    replaced : dict of str to int, or None
        Rows of each split of the data set that the run would replace; None where it would replace none.
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
    folder: DataFolder,
    plan: BuildPlan,
    workers: int,
    measure: Callable[[], Sample],
    *,
    overwrite: bool = False,
) -> Forecast:
    """Estimate a run from what a folder holds of its plan and from a few rows; writes nothing.

    Parameters
    ----------
    folder : DataFolder
        Where the run would write.
    plan : BuildPlan
        What is to be made.
    workers : int
        Processes that will work.
    measure : callable
        Makes a few rows.
    overwrite : bool
        The run would start again where the folder holds another data set.

    Raises
    ------
    InputError
        The run would be refused there.
    """
    state = _started_again(folder, plan) if overwrite else inspect_folder(folder, plan)
    todo = {task.shard for task in state.todo}
    entries = []
    for split in dict.fromkeys(task.shard.split for task in plan.tasks):
        tasks = [task for task in plan.tasks if task.shard.split == split]
        finished = sum(task.size for task in tasks if task.shard not in todo)
        entries.append(SplitForecast(split, sum(task.size for task in tasks), len(tasks), finished))
    left = sum(entry.rows - entry.finished for entry in entries)
    sample = measure()
    seconds = left * sample.row_s / workers + (_START_S if left else 0)
    replaced = _rows_there(folder) if overwrite else None
    size = round(left * sample.row_bytes)
    return Forecast(tuple(entries), left, size, round(seconds, 1), sample.rows, replaced)


def _started_again(folder: DataFolder, plan: BuildPlan) -> BuildState:
    require_replaceable(folder, plan.trees)
    manifest = Manifest(plan.kind, toolkit_version(), plan.spec, plan.split_order)
    return BuildState(manifest, (), tuple(plan.tasks), ())


def _rows_there(folder: DataFolder) -> dict[str, int] | None:
    """Return the rows of each split of a data set; empty where its manifest cannot be read, None without."""
    try:
        manifest = manifest_so_far(folder)
    except IntegrityError:
        return {}
    return None if manifest is None else {name: row["rows"] for name, row in manifest.split_table().items()}
