"""What a run would make, how large and how long, before it is started."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence

from starstruck_gen.generation import GenerateSpec, plan_build
from starstruck_gen.proof import require_sound
from starstruck_gen.rows import PARQUET_STYLE, make_rows, scene_table
from starstruck_gen.sampling import LayoutFailed, require_feasible
from tactile_toolkit.store.estimate import Forecast, Sample, forecast_build
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.shards import encode_parquet

__all__ = ["forecast"]

_SAMPLED = 200


def forecast(
    spec: GenerateSpec,
    out: str | os.PathLike[str],
    splits: Sequence[str],
    workers: int,
    *,
    overwrite: bool = False,
    on_failure: LayoutFailed = lambda _failed, _allowed: None,
) -> Forecast:
    """Estimate a run by making some of its scenes; writes nothing. Parameters are those of the run.

    Raises
    ------
    InputError
        As :func:`starstruck_gen.generation.generate`.
    """
    plan = plan_build(spec, splits)
    require_feasible(spec.scene, spec.seed, on_failure)
    first = plan.tasks[0].shard.split
    folder = DataFolder(os.fspath(out))
    return forecast_build(folder, plan, workers, lambda: _measure(spec, first), overwrite=overwrite)


def _measure(spec: GenerateSpec, split: str) -> Sample:
    _encoded_size(spec, split, 1)  # the first scene pays for imports and for the solids of the shapes
    sampled = min(_SAMPLED, spec.rows(split))
    start_s = time.perf_counter()
    size = _encoded_size(spec, split, sampled)
    return Sample(sampled, size / sampled, (time.perf_counter() - start_s) / sampled)


def _encoded_size(spec: GenerateSpec, split: str, count: int) -> int:
    rows = make_rows(spec.scene, split, spec.seed, 0, count)
    require_sound(spec.scene, rows)
    return len(encode_parquet(scene_table(rows), PARQUET_STYLE))
