"""A data set of digits in numbers: rows of each class, and what its printability report says."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mnist3d.columns import REPORT_FILE
from mnist3d.kind import KIND
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.reports import read_report

_MEASURES = ("size_z_mm", "volume_mm3", "thinnest_wall_mm")


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


def summarise(folder: DataFolder, manifest: Manifest) -> list[SplitSummary]:
    """Sum up each split of a data set from its manifest and its printability report.

    Raises IntegrityError when the report is missing or damaged.
    """
    import pyarrow.compute as pc

    columns = ["split", "label", "bodies", "warnings", *_MEASURES]
    report, summaries = read_report(folder, REPORT_FILE, columns), []
    for split, entry in manifest.split_table().items():
        rows = report.filter(pc.equal(report["split"], split))
        labels = rows["label"].to_numpy().astype(np.int64)
        height_mm, volume_mm3, wall_mm = (_spread(rows[name].to_numpy()) for name in _MEASURES)
        summaries.append(
            SplitSummary(
                split,
                entry["rows"],
                entry["shards"],
                entry["bytes"],
                entry["skipped"],
                tuple(np.bincount(labels, minlength=len(KIND.class_names)).tolist()),
                height_mm,
                volume_mm3,
                wall_mm,
                _counts(rows["bodies"]),
                _counts(pc.list_flatten(rows["warnings"])),
            )
        )
    return summaries


def _spread(values: Any) -> tuple[float, ...]:
    """Return smallest, median and largest to three decimals; nothing of no numbers."""
    found = (values.min(), np.median(values), values.max()) if len(values) else ()
    return tuple(round(float(value), 3) for value in found)


def _counts(values: Any) -> dict[Any, int]:
    return dict(sorted((each["values"], each["counts"]) for each in values.value_counts().to_pylist()))
