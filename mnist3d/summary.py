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
    """One split in numbers.

    Attributes
    ----------
    split : str
        Its name.
    rows, shards, bytes, skipped : int
        As in the manifest.
    per_class : tuple of int
        Rows of each class.
    height_mm, volume_mm3, thinnest_wall_mm : tuple of float
        Smallest, median and largest value over the split.
    bodies : dict of int to int
        How many digits have so many separate bodies.
    warnings : dict of str to int
        How many digits carry each print warning.
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
    return [
        _split_summary(split, report.filter(splits == split), entry)
        for split, entry in manifest.split_table().items()
    ]


def _split_summary(split: str, report: Any, entry: dict[str, int]) -> SplitSummary:
    def column(name: str) -> NDArray[Any]:
        return np.asarray(report[name].to_numpy())

    return SplitSummary(
        split=split,
        **entry,
        per_class=tuple(np.bincount(column("label").astype(np.int64), minlength=10).tolist()),
        height_mm=_spread(column("size_z_mm")),
        volume_mm3=_spread(column("volume_mm3")),
        thinnest_wall_mm=_spread(column("thinnest_wall_mm")),
        bodies=dict(sorted(Counter(column("bodies").tolist()).items())),
        warnings=dict(sorted(Counter(w for ws in report["warnings"].to_pylist() for w in ws).items())),
    )


def _spread(values: NDArray[Any]) -> tuple[float, ...]:
    if not len(values):
        return ()
    return tuple(round(float(value), 3) for value in (values.min(), np.median(values), values.max()))
