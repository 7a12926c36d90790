"""Making a data set folder as all command lines do it: progress while it lasts, then what was made."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cli.output import Sink, bytes_text, duration_text

if TYPE_CHECKING:
    from pathlib import Path

    from tactile_toolkit.store.build import Progress
    from tactile_toolkit.store.forecast import Forecast
    from tactile_toolkit.store.manifest import Manifest

__all__ = ["Made", "make_with_progress", "print_forecast"]


@dataclass(frozen=True, slots=True)
class Made:
    """A finished run: its manifest, how many items it made, and how long it took."""

    manifest: Manifest
    items: int
    elapsed_s: float

    def sentence(self, unit: str, out: Path) -> str:
        """Say what was made and where."""
        done = f"made {self.items:,} {unit} in {duration_text(self.elapsed_s)}"
        return f"{done if self.items else 'nothing was left to make'}; the data set is in {out}"


def make_with_progress(
    sink: Sink, what: str, unit: str, make: Callable[[Callable[[Progress], None]], Manifest]
) -> Made:
    """Run ``make`` with a progress bar; it takes the function that is told of each shard."""
    start_s = time.monotonic()
    items = 0
    with sink.progress(what, unit) as update:

        def on_progress(progress: Progress) -> None:
            nonlocal items
            items = progress.done
            update(progress.done, progress.total)

        manifest = make(on_progress)
    return Made(manifest, items, time.monotonic() - start_s)


def print_forecast(sink: Sink, view: Forecast, unit: str, out: Path, workers: int) -> None:
    """Print what a run would make."""
    sink.document(view.to_dict())
    header = ("split", unit, "shards", "finished already")
    sink.table(header, [(entry.split, entry.rows, entry.shards, entry.finished) for entry in view.splits])
    if view.replaced is not None:
        parts = ", ".join(f"{split} {rows:,}" for split, rows in view.replaced.items())
        held = f"{sum(view.replaced.values()):,} rows ({parts})" if parts else "no rows"
        sink.line(f"would replace the data set in {out}: {held}")
    sink.line(
        f"would make {view.rows_to_make:,} {unit} in {out}: about {bytes_text(view.bytes)} of Parquet, about "
        f"{duration_text(view.seconds)} with {workers} workers (measured on {view.sampled} {unit}); nothing "
        "was written"
    )
