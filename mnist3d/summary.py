"""Numbers of a data set of digits at a glance, from its manifest and its printability report."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.store.manifest import Manifest

__all__ = ["SplitSummary", "summarise"]


@dataclass(frozen=True, slots=True)
class SplitSummary:
    """One split: the counts of the manifest, rows of each class, and what the printability report says.

    ``height_mm``, ``volume_mm3`` and ``thinnest_wall_mm`` are the smallest, the median and the largest value;
    ``bodies`` counts digits by their number of separate bodies, ``warnings`` by print warning.
    """

    split: str
    rows: int
    shards: int
    bytes: int
    skipped: int
    per_class: tuple[int, ...]
    height_mm: tuple[float, ...]
    volume_mm3: tuple[float, ...]
    thinnest_wall_mm: tuple[float, ...]
    bodies: dict[int, int]
    warnings: dict[str, int]

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


def summarise(manifest: Manifest, report: Any) -> list[SplitSummary]:
    """Sum up each split of a data set from its manifest and its printability report, an Arrow table."""
    splits = np.asarray(report["split"].to_pylist())
    summaries = []
    for split, entry in manifest.split_table().items():
        rows = report.filter(splits == split)
        warnings = Counter(warning for found in rows["warnings"].to_pylist() for warning in found)
        summaries.append(
            SplitSummary(
                split=split,
                **entry,
                per_class=tuple(np.bincount(_column(rows, "label").astype(np.int64), minlength=10).tolist()),
                height_mm=_spread(_column(rows, "size_z_mm")),
                volume_mm3=_spread(_column(rows, "volume_mm3")),
                thinnest_wall_mm=_spread(_column(rows, "thinnest_wall_mm")),
                bodies=dict(sorted(Counter(_column(rows, "bodies").tolist()).items())),
                warnings=dict(sorted(warnings.items())),
            )
        )
    return summaries


def _column(report: Any, name: str) -> NDArray[Any]:
    return np.asarray(report[name].to_numpy())


def _spread(values: NDArray[Any]) -> tuple[float, ...]:
    if not len(values):
        return ()
    return tuple(round(float(value), 3) for value in (values.min(), np.median(values), values.max()))
