"""What a run would make, how large and how long, before it is started."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence

from mnist3d.generation import GenerateSpec, make_row, plan_build
from mnist3d.rows import PARQUET_STYLE, mesh_table
from mnist3d.splits import plan_splits
from tactile_toolkit.errors import ItemError
from tactile_toolkit.store.estimate import Forecast, Sample, forecast_build
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.shards import encode_parquet

__all__ = ["forecast"]

_SAMPLED = 8


def forecast(
    spec: GenerateSpec,
    out: str | os.PathLike[str],
    splits: Sequence[str],
    workers: int,
    *,
    overwrite: bool = False,
) -> Forecast:
    """Estimate a run by making a few of its digits; writes nothing. Parameters are those of the run.

    Raises
    ------
    InputError
        As :func:`mnist3d.generation.generate`.
    """
    plan = plan_build(spec, splits)
    folder = DataFolder(os.fspath(out))
    return forecast_build(folder, plan, workers, lambda: _measure(spec, splits), overwrite=overwrite)


def _measure(spec: GenerateSpec, splits: Sequence[str]) -> Sample:
    """Make some digits, spread over the splits asked for."""
    plan = plan_splits(spec.source.catalog(), spec.split)
    ids = [i for split in splits for i in plan.rows(split, spec.per_class, spec.limit).tolist()]
    sample = ids[:: max(1, len(ids) // _SAMPLED)][:_SAMPLED]
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
    return Sample(len(sample), size / max(1, len(rows)), elapsed_s / max(1, len(sample) - 1))
