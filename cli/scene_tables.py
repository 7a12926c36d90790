"""What ``starstruck`` prints about a data set: tables on a terminal, one document with ``--json``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cli.output import Sink, bytes_text
from cli.unfinished import print_unfinished, shards_of_plan

if TYPE_CHECKING:
    from starstruck_gen.summary import SplitSummary
    from tactile_toolkit.store.manifest import Manifest

__all__ = ["print_acceptance", "print_made"]


def print_made(sink: Sink, manifest: Manifest, out: Path, elapsed_s: float | None = None) -> None:
    """Print the table of what a folder holds."""
    from starstruck_gen.summary import summarise

    summaries = summarise(manifest)
    sink.document(
        {
            "folder": str(out),
            "complete": manifest.complete,
            "toolkit_version": manifest.toolkit_version,
            "elapsed_s": None if elapsed_s is None else round(elapsed_s, 3),
            "shards_planned": shards_of_plan(manifest),
            "splits": [summary.to_dict() for summary in summaries],
            "spec": manifest.spec,
        }
    )
    if not manifest.complete:
        print_unfinished(sink, manifest, out, "scenes", "starstruck generate")
        return
    header = ("split", "scenes", "per class", "Parquet", "bytes per scene", "accepted", "started over")
    sink.table(header, [_made_row(summary) for summary in summaries])


def _made_row(summary: SplitSummary) -> tuple[object, ...]:
    classes = summary.acceptance.classes
    return (
        summary.split,
        summary.rows,
        str(classes[0]) if min(classes) == max(classes) else f"{min(classes)}-{max(classes)}",
        bytes_text(summary.bytes),
        round(summary.bytes_per_scene),
        f"{100 * summary.acceptance.accepted:.1f} %",
        summary.acceptance.restarts,
    )


def print_acceptance(sink: Sink, manifest: Manifest) -> None:
    """Print how many positions were drawn, by the number of the object in its scene."""
    from starstruck_gen.summary import summarise

    for summary in summarise(manifest):
        counts = summary.acceptance
        rows = [
            (number, placed, tried, f"{tried / placed:.3f}")
            for number, (placed, tried) in enumerate(
                zip(counts.objects, counts.attempts, strict=True), start=1
            )
            if placed
        ]
        header = ("object", "placed", "positions drawn", "per object")
        sink.table(header, rows, f"{summary.split}: positions drawn by object of a scene")
