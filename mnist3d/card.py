"""The data card of a data set of digits."""

from __future__ import annotations

import json

from dataset_store.cards import front_matter, markdown_table, render_card, write_card_text
from dataset_store.manifest import Manifest
from dataset_store.storage import DataFolder
from mnist3d.summary import SplitSummary, summarise

__all__ = ["write_card"]

_LICENCES = {"synthetic": "mit", "hwdplus": "other", "mnist": "cc-by-sa-3.0", "folder": "other"}


def write_card(folder: DataFolder, manifest: Manifest) -> None:
    """Write ``README.md`` of a data set folder from its manifest and report.

    Raises
    ------
    StorageError
        When the folder cannot be written.
    """
    source = str(manifest.spec["source"]["name"])
    summaries = summarise(folder, manifest)
    head = front_matter(
        manifest,
        license=_LICENCES.get(source, "other"),
        pretty_name="MNIST 3D",
        task_categories=["robotics", "reinforcement-learning"],
        tags=["tactile", "3d", "mesh", "mnist"],
    )
    values = {
        "rows": f"{sum(summary.rows for summary in summaries):,}",
        "source": source,
        "version": manifest.toolkit_version,
        "split_table": _split_table(summaries),
        "print_table": _print_table(summaries),
        "skipped": _skipped(manifest),
        "spec": json.dumps(manifest.spec, indent=2),
        "first_split": manifest.splits[0] if manifest.splits else "train",
    }
    write_card_text(folder, head + "\n" + render_card("mnist3d.md", values))


def _split_table(summaries: list[SplitSummary]) -> str:
    rows = [(s.split, s.rows, s.shards, f"{s.bytes / 1e6:.1f} MB", s.skipped) for s in summaries]
    return markdown_table(("split", "rows", "shards", "Parquet", "skipped"), rows)


def _print_table(summaries: list[SplitSummary]) -> str:
    rows = [
        (
            s.split,
            _range(s.height_mm),
            _range(s.volume_mm3),
            _range(s.thinnest_wall_mm),
            ", ".join(f"{count} with {word}" for word, count in s.warnings.items()) or "none",
        )
        for s in summaries
    ]
    return markdown_table(("split", "height, mm", "volume, mm³", "thinnest wall, mm", "print warnings"), rows)


def _range(spread: tuple[float, ...]) -> str:
    return f"{spread[0]:.1f} to {spread[2]:.1f} (median {spread[1]:.1f})" if spread else "-"


def _skipped(manifest: Manifest) -> str:
    reasons = manifest.skipped_reasons()
    if not reasons:
        return "No digit of the splits was skipped."
    listed = ", ".join(f"{count} for {reason!r}" for reason, count in reasons.items())
    return f"Digits that gave no valid solid were left out: {listed}. `manifest.json` names each."
