"""Making a data set folder as all command lines do it: progress while it lasts, then what was made."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cli.options import Making, Work
from cli.output import Sink, bytes_text, duration_text
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.wording import counted

if TYPE_CHECKING:
    from tactile_toolkit.store.build import Progress
    from tactile_toolkit.store.forecast import Forecast
    from tactile_toolkit.store.manifest import Manifest


PrintMade = Callable[[Sink, "Manifest", str, float | None], None]
"""Prints what a folder holds: with how long it took where it was just made, else None."""


@dataclass(frozen=True, slots=True)
class Made:
    """A finished run: what its folder holds now, what it made, what gave no row, and how long it took."""

    manifest: Manifest
    nouns: str
    rows: int
    skipped: int
    elapsed_s: float

    @property
    def text(self) -> str:
        """What it made, in words."""
        if not self.rows and not self.skipped:
            return "nothing was left to make"
        left_out = f", {self.skipped:,} left out," if self.skipped else ""
        return f"made {counted(self.rows, self.nouns)}{left_out} in {duration_text(self.elapsed_s)}"


def generate_set(
    sink: Sink,
    kind: DatasetKind,
    making: Making,
    out: str,
    splits: Sequence[str] | None,
    *,
    what: str,
    forecast: Callable[..., Forecast],
    make: Callable[..., Manifest],
    print_made: PrintMade,
) -> None:
    """Make a data set of a kind, or forecast it, and print what was made and what comes next."""
    if making.dry_run:
        _print_forecast(sink, kind, forecast(making.chosen_runner(), overwrite=making.overwrite), out, making)
        return
    made = make_with_progress(sink, what, kind.nouns, make, making, out)
    if made is None:
        return
    print_made(sink, made.manifest, out, made.elapsed_s)
    sink.line(f"{made.text}; the data set is in {out}")
    table = made.manifest.split_table()
    # One that has rows, so that the line works when it is tried.
    split = next((name for name in splits or table if name in table and table[name]["rows"]), None)
    call = f"{kind.package}.load({out!r}, split={split or next(iter(splits or table))!r})"
    sink.line(f"next: {kind.command} verify {out}   or in Python: {call}")


def make_with_progress(
    sink: Sink,
    what: str,
    nouns: str,
    make: Callable[..., Manifest],
    work: Work,
    out: str,
    *,
    unit: str | None = None,
) -> Made | None:
    """Run ``make`` with a progress bar, which counts ``unit`` where that is not the ``nouns`` of rows.

    It takes ``workers``, ``overwrite`` and ``on_progress``. Ctrl-C before the first shard is raised with what
    is to be said then. None where this was one part of many: what it made has been said.
    """
    from tactile_toolkit.store.build import MissingPartsError
    from tactile_toolkit.store.folder import DataFolder
    from tactile_toolkit.store.job import manifest_so_far

    start_s = time.monotonic()
    rows = skipped = 0
    with sink.progress(what, unit or nouns) as update:

        def on_progress(progress: Progress) -> None:
            nonlocal rows, skipped
            if progress.record is not None:
                rows += progress.record.rows
                skipped += len(progress.record.skipped)
            update(progress.done, progress.total)

        try:
            manifest = make(workers=work.chosen_runner(), overwrite=work.overwrite, on_progress=on_progress)
        except MissingPartsError as error:
            sink.document({"complete": False, "array": error.array, "parts": error.parts})
            # On stdout, for a script to hand to `sbatch`; the sentence about it goes to stderr.
            sink.line(f"--array={error.array}")
            raise
        except KeyboardInterrupt as error:
            if rows or skipped:
                raise
            # What runs before this one have finished is kept all the same.
            raise KeyboardInterrupt(
                "interrupted before this run finished a shard: it leaves nothing, the same command starts "
                "again"
            ) from error
    made = Made(manifest, nouns, rows, skipped, time.monotonic() - start_s)
    if work.part is None:
        # Another split may be unfinished: what is finished of it stays and is shown, as `info` shows it.
        return replace(made, manifest=manifest_so_far(DataFolder(out)) or manifest)
    counts = {"rows": made.rows, "skipped": made.skipped, "elapsed_s": round(made.elapsed_s, 3)}
    sink.document({"folder": out, "complete": False, "part": work.part, **counts})
    sink.line(f"{made.text}; part {work.part} of the data set in {out} is there")
    sink.line("next: when all parts have ended, the same command with --finish instead of --part")
    return None


def _print_forecast(sink: Sink, kind: DatasetKind, view: Forecast, out: str, making: Making) -> None:
    sink.document(view.to_dict())
    header = ("split", kind.nouns, "shards", "finished already")
    sink.table(header, [(entry.split, entry.rows, entry.shards, entry.finished) for entry in view.splits])
    if view.replaced is not None:
        parts = ", ".join(f"{split} {rows:,}" for split, rows in view.replaced.items())
        held = f"{counted(sum(view.replaced.values()), 'rows')} ({parts})" if parts else "no rows"
        sink.line(f"would replace the data set in {out}: {held}")
    part = "" if making.part is None else f" (part {making.part})"
    sink.line(
        f"would make {counted(view.rows_to_make, kind.nouns)}{part} in {out}: about "
        f"{bytes_text(view.bytes)} of Parquet, about {duration_text(view.seconds)} with "
        f"{counted(making.processes, 'workers')} (measured on {counted(view.sampled, kind.nouns)}); nothing "
        "was written"
    )
