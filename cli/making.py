"""Making a data set folder as all command lines do it: progress while it lasts, then what was made."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cli.options import Making
from cli.output import Sink, bytes_text, counted, duration_text
from tactile_toolkit.kind import DatasetKind

if TYPE_CHECKING:
    from tactile_toolkit.store.build import Progress
    from tactile_toolkit.store.forecast import Forecast
    from tactile_toolkit.store.manifest import Manifest

__all__ = ["Made", "make_with_progress", "print_conclusion", "print_forecast", "print_part"]


@dataclass(frozen=True, slots=True)
class Made:
    """A finished run: its manifest, how many rows it made, how many items gave none, and how long it took."""

    manifest: Manifest
    rows: int
    skipped: int
    elapsed_s: float


def make_with_progress(
    sink: Sink, what: str, unit: str, make: Callable[[Callable[[Progress], None]], Manifest]
) -> Made:
    """Run ``make`` with a progress bar; it takes the function that is called after each shard.

    Ctrl-C before the first one is raised with what is to be said then.
    """
    from tactile_toolkit.store.parts import MissingPartsError

    start_s = time.monotonic()
    rows = skipped = 0
    with sink.progress(what, unit) as update:

        def on_progress(progress: Progress) -> None:
            nonlocal rows, skipped
            if progress.record is not None:
                rows += progress.record.rows
                skipped += len(progress.record.skipped)
            update(progress.done, progress.total)

        try:
            manifest = make(on_progress)
        except MissingPartsError as error:
            sink.document({"complete": False, "array": error.array, "parts": error.parts})
            if error.parts is not None:
                sink.line(f"--array={error.array}")
            raise
        except KeyboardInterrupt as error:
            if rows:
                raise
            message = "interrupted before a shard was finished: none is kept, the same command starts again"
            raise KeyboardInterrupt(message) from error
    return Made(manifest, rows, skipped, time.monotonic() - start_s)


def print_part(sink: Sink, kind: DatasetKind, made: Made, out: str, part: str) -> None:
    """Say what one part of many has made, and what comes when all have ended."""
    sink.document(
        {
            "folder": str(out),
            "complete": False,
            "part": part,
            "rows": made.rows,
            "skipped": made.skipped,
            "elapsed_s": round(made.elapsed_s, 3),
        }
    )
    sink.line(f"{_made(made, kind.nouns)}; part {part} of the data set in {out} is there")
    sink.line("next: when all parts have ended, the same command with --finish instead of --part")


def _made(made: Made, nouns: str) -> str:
    if not made.rows and not made.skipped:
        return "nothing was left to make"
    left_out = f", {made.skipped:,} left out," if made.skipped else ""
    return f"made {counted(made.rows, nouns)}{left_out} in {duration_text(made.elapsed_s)}"


def print_conclusion(sink: Sink, kind: DatasetKind, made: Made, out: str, splits: Sequence[str]) -> None:
    """Say what was made and where, and which commands come next."""
    sink.line(f"{_made(made, kind.nouns)}; the data set is in {out}")
    table = made.manifest.split_table()
    split = next((name for name in splits if name in table and table[name]["rows"]), splits[0])
    sink.line(
        f"next: {kind.command} validate {out}   or in Python: "
        f"{kind.package}.load({str(out)!r}, split={split!r})"
    )


def print_forecast(sink: Sink, kind: DatasetKind, view: Forecast, out: str, making: Making) -> None:
    """Print what a run would make."""
    sink.document(view.to_dict())
    header = ("split", kind.nouns, "shards", "finished already")
    sink.table(header, [(entry.split, entry.rows, entry.shards, entry.finished) for entry in view.splits])
    if view.replaced is not None:
        parts = ", ".join(f"{split} {rows:,}" for split, rows in view.replaced.items())
        held = f"{counted(sum(view.replaced.values()), 'rows')} ({parts})" if parts else "no rows"
        sink.line(f"would replace the data set in {out}: {held}")
    sink.line(
        f"would make {counted(view.rows_to_make, kind.nouns)} in {out}: about {bytes_text(view.bytes)} of "
        f"Parquet, about {duration_text(view.seconds)} with {counted(making.processes, 'workers')} (measured "
        f"on {counted(view.sampled, kind.nouns)}); nothing was written"
    )
