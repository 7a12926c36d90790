"""What the command lines say about a folder whose run was interrupted, or is still under way."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cli.output import Sink, bytes_text

if TYPE_CHECKING:
    from dataset_store.manifest import Manifest

__all__ = ["print_unfinished", "shards_of_plan"]


def shards_of_plan(manifest: Manifest) -> dict[str, int]:
    """Return how many shards each split is to have, as far as a finished one tells."""
    return {split: manifest.receipts_of(split)[0].shard.count for split in manifest.splits}


def print_unfinished(sink: Sink, manifest: Manifest, out: Path, unit: str, command: str) -> None:
    """Say that a folder is unfinished, what it holds so far, and how to go on."""
    again = f"the same `{command}` goes on where it stopped"
    table = manifest.split_table()
    if not table:
        sink.line(f"{out}: unfinished, no shard is finished yet; {again}")
        return
    sink.line(f"{out}: unfinished, the run is under way or was interrupted; {again}")
    rows = [
        (
            split,
            f"{table[split]['shards']:,} of {count:,}",
            table[split]["rows"],
            bytes_text(table[split]["bytes"]),
        )
        for split, count in shards_of_plan(manifest).items()
    ]
    sink.table(("split", "shards finished", unit, "Parquet"), rows)
