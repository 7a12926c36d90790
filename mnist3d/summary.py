"""A data set of digits in numbers: rows of each class, and what its printability report says."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mnist3d.rows import CLASS_NAMES, REPORT_FILE
from mnist3d.spread import Spread
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.reports import report_pieces

__all__ = ["SplitSummary", "summarise"]

_MEASURES = {"height_mm": "size_z_mm", "volume_mm3": "volume_mm3", "thinnest_wall_mm": "thinnest_wall_mm"}


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

    The report is read a row group at a time, again where it is large. Raises IntegrityError when it is
    missing or damaged.
    """
    import pyarrow.compute as pc

    table = manifest.split_table()
    counts = {split: _Counts() for split in table}
    spreads = {(split, name): Spread() for split in table for name in _MEASURES}
    for piece in report_pieces(folder, REPORT_FILE, ["split", "label", "bodies", "warnings"]):
        for split, counted in counts.items():
            counted.add(piece.filter(pc.equal(piece["split"], split)))
    while not all(spread.is_found for spread in spreads.values()):
        for piece in report_pieces(folder, REPORT_FILE, ["split", *_MEASURES.values()]):
            for split in table:
                rows = piece.filter(pc.equal(piece["split"], split))
                for name, column in _MEASURES.items():
                    spreads[split, name].add(np.asarray(rows[column].to_numpy()))
        for spread in spreads.values():
            spread.end_pass()
    return [
        SplitSummary(
            split=split,
            **entry,
            per_class=tuple(counts[split].labels.tolist()),
            height_mm=spreads[split, "height_mm"].rounded(),
            volume_mm3=spreads[split, "volume_mm3"].rounded(),
            thinnest_wall_mm=spreads[split, "thinnest_wall_mm"].rounded(),
            bodies=dict(sorted(counts[split].bodies.items())),
            warnings=dict(sorted(counts[split].warnings.items())),
        )
        for split, entry in table.items()
    ]


@dataclass
class _Counts:
    """Rows of a split by class, by number of bodies, and by print warning."""

    labels: NDArray[np.int64] = field(default_factory=lambda: np.zeros(len(CLASS_NAMES), np.int64))
    bodies: Counter[int] = field(default_factory=Counter)
    warnings: Counter[str] = field(default_factory=Counter)

    def add(self, rows: Any) -> None:
        import pyarrow.compute as pc

        labels = rows["label"].to_numpy().astype(np.int64)
        self.labels += np.bincount(labels, minlength=len(self.labels))
        for counter, values in (
            (self.bodies, rows["bodies"]),
            (self.warnings, pc.list_flatten(rows["warnings"])),
        ):
            counter.update({each["values"]: each["counts"] for each in values.value_counts().to_pylist()})
