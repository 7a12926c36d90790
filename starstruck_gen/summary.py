"""Numbers of a data set of scenes at a glance, from its manifest alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from starstruck_gen.acceptance import Acceptance
from tactile_toolkit.store.manifest import Manifest

__all__ = ["SplitSummary", "summarise"]


@dataclass(frozen=True, slots=True)
class SplitSummary:
    """One split in numbers.

    Attributes
    ----------
    split : str
        Its name.
    rows, shards, bytes : int
        As in the manifest.
    acceptance : Acceptance
        Scenes per class and per number of distractors, and what it took to place objects.
    """

    split: str
    rows: int
    shards: int
    bytes: int
    acceptance: Acceptance

    @property
    def bytes_per_scene(self) -> float:
        """Parquet bytes per scene."""
        return self.bytes / max(1, self.rows)

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        per_object = [round(mean, 4) for mean in self.acceptance.attempts_per_object]
        return {
            "split": self.split,
            "rows": self.rows,
            "shards": self.shards,
            "bytes": self.bytes,
            "bytes_per_scene": round(self.bytes_per_scene, 1),
            "acceptance": {**self.acceptance.to_dict(), "attempts_per_object": per_object},
        }


def summarise(manifest: Manifest) -> list[SplitSummary]:
    """Sum up each split of a data set; splits of an unfinished run as far as they got."""
    statistics = manifest.statistics()
    return [
        SplitSummary(
            split, entry["rows"], entry["shards"], entry["bytes"], Acceptance.from_dict(statistics[split])
        )
        for split, entry in manifest.split_table().items()
    ]
