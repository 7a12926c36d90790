"""What a run would make, how large and how long, before it is started."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from dataset_store.errors import ItemError
from dataset_store.shards import encode_parquet
from mnist3d.generation import GenerateSpec, inspect_out, make_row, plan_build
from mnist3d.rows import PARQUET_STYLE, mesh_table

__all__ = ["Forecast", "SplitForecast", "forecast"]

_SAMPLED = 8
_START_S = 1.5
"""What workers need to start and import their libraries."""


@dataclass(frozen=True, slots=True)
class SplitForecast:
    """One split: its digits and shards, and how many digits are finished already."""

    split: str
    digits: int
    shards: int
    finished: int


@dataclass(frozen=True, slots=True)
class Forecast:
    """What a run would do.

    Attributes
    ----------
    splits : tuple of SplitForecast
        One per split asked for.
    digits_to_make : int
        Digits that are not finished yet.
    bytes : int
        Parquet to be written, from a sample.
    seconds : float
        Time, from the same sample.
    sampled : int
        How many digits were made for the estimate.
    """

    splits: tuple[SplitForecast, ...]
    digits_to_make: int
    bytes: int
    seconds: float
    sampled: int

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


def forecast(spec: GenerateSpec, out: str, splits: Sequence[str], workers: int) -> Forecast:
    """Estimate a run by making a few of its digits; writes nothing.

    Raises
    ------
    InputError
        As :func:`mnist3d.generation.generate`.
    """
    plan = plan_build(spec, splits)
    todo = {task.shard for task in inspect_out(spec, out, splits).todo}
    entries = []
    for split in dict.fromkeys(task.shard.split for task in plan.tasks):
        tasks = [task for task in plan.tasks if task.shard.split == split]
        finished = sum(task.size for task in tasks if task.shard not in todo)
        entries.append(SplitForecast(split, sum(task.size for task in tasks), len(tasks), finished))
    left = sum(entry.digits - entry.finished for entry in entries)
    ids = [digit_id for task in plan.tasks for digit_id in _ids(task)]
    sample = ids[:: max(1, len(ids) // _SAMPLED)][:_SAMPLED]
    row_bytes, row_s = _measure(spec, sample)
    seconds = left * row_s / workers + (_START_S if left else 0)
    return Forecast(tuple(entries), left, round(left * row_bytes), round(seconds, 1), len(sample))


def _ids(task: Any) -> tuple[int, ...]:
    ids: tuple[int, ...] = task.ids
    return ids


def _measure(spec: GenerateSpec, sample: Sequence[int]) -> tuple[float, float]:
    """Return bytes and seconds per digit."""
    rows = []
    start_s = 0.0
    for count, digit_id in enumerate(sample):
        try:
            rows.append(make_row(digit_id, spec)[0])
        except ItemError:
            continue
        finally:
            # The first digit pays for the imports.
            start_s = time.perf_counter() if count == 0 else start_s
    size = len(encode_parquet(mesh_table(rows, spec.source.name), PARQUET_STYLE))
    elapsed_s = time.perf_counter() - start_s
    return size / max(1, len(rows)), elapsed_s / max(1, len(sample) - 1)
