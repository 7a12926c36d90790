"""What ``mnist3d`` prints about data sets of digits."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cli.output import Sink, bytes_text, counted
from cli.unfinished import print_unfinished, shards_of_plan

if TYPE_CHECKING:
    from mnist3d.summary import SplitSummary
    from tactile_toolkit.store.manifest import Manifest

__all__ = ["print_made"]


def print_made(sink: Sink, manifest: Manifest, out: Path, elapsed_s: float | None = None) -> None:
    """Print the table of what a folder holds."""
    from mnist3d.rows import REPORT_FILE
    from mnist3d.summary import summarise
    from tactile_toolkit.store.folder import DataFolder
    from tactile_toolkit.store.parquet import read_report

    complete = manifest.complete
    summaries = summarise(manifest, read_report(DataFolder(str(out)), REPORT_FILE)) if complete else []
    sink.document(
        {
            "folder": str(out),
            "complete": complete,
            "toolkit_version": manifest.toolkit_version,
            "elapsed_s": None if elapsed_s is None else round(elapsed_s, 3),
            "shards_planned": shards_of_plan(manifest),
            "splits": [summary.to_dict() for summary in summaries] or manifest.split_table(),
            "skipped": manifest.skipped_reasons(),
            "spec": manifest.spec,
        }
    )
    if not complete:
        print_unfinished(sink, manifest, out, "digits", "mnist3d generate")
        return
    header = (
        "split",
        "digits",
        "per class",
        "Parquet",
        "height mm",
        "thinnest wall mm",
        "skipped",
        "warnings",
    )
    sink.table(header, [_made_row(summary) for summary in summaries])
    for reason, count in manifest.skipped_reasons().items():
        sink.line(f"skipped {counted(count, 'digits')}: {reason} (each is named in {out}/manifest.json)")


def _made_row(summary: SplitSummary) -> tuple[object, ...]:
    least, most = min(summary.per_class), max(summary.per_class)
    return (
        summary.split,
        summary.rows,
        str(most) if least == most else f"{least}-{most}",
        bytes_text(summary.bytes),
        _range(summary.height_mm),
        _range(summary.thinnest_wall_mm),
        summary.skipped,
        ", ".join(f"{word} {count:,}" for word, count in summary.warnings.items()) or "none",
    )


def _range(spread: tuple[float, ...]) -> str:
    return f"{spread[0]:.1f}-{spread[-1]:.1f}" if spread else "-"
