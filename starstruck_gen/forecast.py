"""What a run would make, how large and how long, before it is started."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from dataset_store.shards import encode_parquet
from starstruck_gen.generation import GenerateSpec, inspect_out, plan_build
from starstruck_gen.proof import require_sound
from starstruck_gen.rows import PARQUET_STYLE, make_rows, scene_table
from starstruck_gen.sampling import require_room

__all__ = ["Forecast", "SplitForecast", "forecast"]

_SAMPLED = 200
_START_S = 1.5
"""What workers need to start and import their libraries."""


@dataclass(frozen=True, slots=True)
class SplitForecast:
    """One split: its scenes and shards, and how many scenes are finished already."""

    split: str
    scenes: int
    shards: int
    finished: int


@dataclass(frozen=True, slots=True)
class Forecast:
    """What a run would do.

    Attributes
    ----------
    splits : tuple of SplitForecast
        One per split asked for.
    scenes_to_make : int
        Scenes that are not finished yet.
    bytes : int
        Parquet to be written, from a sample.
    seconds : float
        Time, from the same sample.
    sampled : int
        How many scenes were made for the estimate.
    """

    splits: tuple[SplitForecast, ...]
    scenes_to_make: int
    bytes: int
    seconds: float
    sampled: int

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


def forecast(spec: GenerateSpec, out: str, splits: Sequence[str], workers: int) -> Forecast:
    """Estimate a run by making some of its scenes; writes nothing.

    Raises
    ------
    InputError
        As :func:`starstruck_gen.generation.generate`.
    """
    plan = plan_build(spec, splits)
    require_room(spec.scene, spec.seed)
    todo = {task.shard for task in inspect_out(spec, out, splits).todo}
    entries = []
    for split in dict.fromkeys(task.shard.split for task in plan.tasks):
        tasks = [task for task in plan.tasks if task.shard.split == split]
        finished = sum(task.size for task in tasks if task.shard not in todo)
        entries.append(SplitForecast(split, spec.rows(split), len(tasks), finished))
    left = sum(entry.scenes - entry.finished for entry in entries)
    sampled = min(_SAMPLED, spec.rows(entries[0].split))
    scene_bytes, scene_s = _measure(spec, entries[0].split, sampled)
    seconds = left * scene_s / workers + (_START_S if left else 0)
    return Forecast(tuple(entries), left, round(left * scene_bytes), round(seconds, 1), sampled)


def _measure(spec: GenerateSpec, split: str, sampled: int) -> tuple[float, float]:
    """Return bytes and seconds per scene."""
    _encoded_size(spec, split, 1)  # the first scene pays for imports and for the solids of the shapes
    start_s = time.perf_counter()
    size = _encoded_size(spec, split, sampled)
    return size / sampled, (time.perf_counter() - start_s) / sampled


def _encoded_size(spec: GenerateSpec, split: str, count: int) -> int:
    rows = make_rows(spec.scene, split, spec.seed, 0, count)
    require_sound(spec.scene, rows)
    return len(encode_parquet(scene_table(rows), PARQUET_STYLE))
