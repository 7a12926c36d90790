"""Runs that make a data set folder, for all command lines: progress during the run, then a summary."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from itertools import chain, islice
from typing import TYPE_CHECKING

from cli import options, output
from tactile_toolkit import places, store, wording
from tactile_toolkit.kind import DatasetKind, Facts
from tactile_toolkit.wording import with_count

if TYPE_CHECKING:
    from tactile_toolkit.generation import RowGenerator

_LEFT_OUT_SHOWN = 20


def generate_set(
    sink: output.Sink,
    what: str,
    rows: RowGenerator,
    out: str,
    splits: Sequence[str] | None,
    run_options: options.GenerateOptions,
    require: Callable[[], None] = lambda: None,
) -> store.Manifest | None:
    """Make a data set of a kind, or forecast it, and print a summary and the next step.

    Returns None if nothing, or only a part, was made.
    """
    if run_options.dry_run:
        _print_forecast(sink, rows, out, splits, run_options, require)
        return None
    make = partial(rows.generate, out, splits, require=require)
    manifest = make_with_progress(sink, what, rows.kind, make, run_options, out)
    if manifest is None:
        return None
    table = manifest.split_table()
    # A split with rows, so that the printed line works.
    split = next(name for name in splits or table if table[name]["rows"])
    call = rows.kind.loading_lines(manifest, out, split)[1]
    sink.line(f"next: tactile verify {out}   or in Python: {call}")
    return manifest


def make_with_progress(
    sink: output.Sink,
    what: str,
    kind: DatasetKind,
    make: Callable[..., store.Manifest],
    run_options: options.RunOptions,
    out: str,
    unit: str | None = None,
) -> store.Manifest | None:
    """Run ``make``, which takes the keywords of a run, and print a summary.

    ``unit`` names the items of the progress, if these are not rows. Returns None if only a part was made.
    """
    start_s = time.monotonic()
    rows = skipped = 0
    with sink.progress(what, unit or kind.nouns, keeps_parts=True) as update:

        def on_progress(progress: store.Progress) -> None:
            nonlocal rows, skipped
            if progress.record is not None:
                rows += progress.record.rows
                skipped += len(progress.record.skipped)
            update(progress.done, progress.total)

        try:
            manifest = make(**run_options.run_keywords(), on_progress=on_progress)
        except store.MissingPartsError as error:
            sink.document({"complete": False, "array": error.array, "parts": error.parts})
            # On stdout, so that a script can pass it to `sbatch`; the error message goes to stderr.
            sink.line(f"--array={error.array}")
            raise
    elapsed_s = time.monotonic() - start_s
    made = "nothing was left to make"
    if rows or skipped:
        made = f"made {with_count(rows, kind.nouns)} in {wording.duration_text(elapsed_s)}"
    if skipped:
        made += f", left out {with_count(skipped, unit or kind.nouns)}"
    if run_options.part is not None:
        counts = {"rows": rows, "skipped": skipped, "elapsed_s": round(elapsed_s, 3)}
        sink.document({"folder": out, "complete": False, "part": run_options.part, **counts})
        sink.line(f"{made}; part {run_options.part} of the data set in {out} is finished")
        sink.line("next: after all parts, run the same command with --finish instead of --part")
        return None
    # Another split may be unfinished: its finished shards stay and are shown, as by `info`.
    manifest = store.Manifest.so_far(store.open_folder(out)) or manifest
    print_set(sink, kind, manifest, out, elapsed_s, unit=unit)
    sink.line(f"{made}; the data set is in {out}")
    return manifest


def _print_forecast(
    sink: output.Sink,
    generator: RowGenerator,
    out: str,
    splits: Sequence[str] | None,
    run_options: options.GenerateOptions,
    require: Callable[[], None],
) -> None:
    kind = generator.kind
    view = generator.forecast(out, splits, require=require, **run_options.run_keywords())
    sink.document(asdict(view))
    header = ("split", kind.nouns, "shards", "finished already")
    sink.table(header, [tuple(entry.values()) for entry in view.splits])
    if view.replaced is not None:
        parts = ", ".join(f"{split} {rows:,}" for split, rows in view.replaced.items())
        held = with_count(sum(view.replaced.values()), "rows")
        sink.line(f"would replace the data set in {out}: {held} ({parts or 'no split'})")
    part = ""
    if run_options.part is not None:
        part = f" (part {run_options.part})"
    sink.line(
        f"would make {with_count(view.rows_to_make, kind.nouns)}{part} in {out}: about "
        f"{wording.bytes_text(view.bytes)} of Parquet, about {wording.duration_text(view.seconds)} "
        f"with {with_count(options.process_count(run_options.workers), 'workers')} (measured on "
        f"{with_count(view.sampled, kind.nouns)}); nothing was written"
    )


def print_set(
    sink: output.Sink,
    kind: DatasetKind,
    manifest: store.Manifest,
    out: str,
    elapsed_s: float | None = None,
    *,
    unit: str | None = None,
    split: str | None = None,
    has_folder: bool = True,
) -> None:
    """Print the content of a folder, what its kind tells about it, and the next step of an unfinished run.

    ``unit`` names the items that were left out, if these are not rows. ``split`` is the only one shown.
    Without ``has_folder``, ``out`` is a repository.
    """
    facts = Facts()
    is_own = manifest.kind == kind.name and not (manifest.is_copy or manifest.is_for_others)
    if manifest.complete and is_own and has_folder and kind.facts is not None:
        facts = kind.facts(store.open_folder(out), manifest)
    table = {name: held for name, held in manifest.split_table().items() if split in (None, name)}
    shard_counts = {split: count for split, count in manifest.shards_planned().items() if split in table}
    if elapsed_s is not None:
        elapsed_s = round(elapsed_s, 3)
    print_left_out(sink, manifest)
    sink.document(
        {
            "folder": out,
            "complete": manifest.complete,
            "toolkit_version": manifest.toolkit_version,
            "elapsed_s": elapsed_s,
            "shards_planned": shard_counts,
            "splits": table,
            "skipped": manifest.skipped_reasons(),
            **facts.document,
            "spec": manifest.spec,
        }
    )
    if not manifest.complete:
        _print_unfinished(sink, kind, manifest, out)
    counts = [
        (
            name,
            e["rows"],
            f"{e['shards']:,} of {shard_counts[name]:,}",
            wording.bytes_text(e["bytes"]),
            e["skipped"],
        )
        for name, e in table.items()
    ]
    sink.table(("split", kind.nouns, "shards", "Parquet", "left out"), counts)
    sink.table(facts.header, facts.rows)
    for reason, count in manifest.skipped_reasons().items():
        items = with_count(count, unit or kind.nouns)
        sink.line(f"left out {items}: {reason} (each is named in {out}/manifest.json)")
    for line in facts.lines:
        sink.line(line)


def _print_unfinished(sink: output.Sink, kind: DatasetKind, manifest: store.Manifest, out: str) -> None:
    """Print what is under way in a folder, or was interrupted, and how to continue it."""
    record = places.open_place(out).download
    activity = "run"
    next_step = f"run the same `{kind.command_of(manifest)}` again, or add --finish to list missing shards"
    if record is not None:
        activity = "download"
        next_step = f"download {record.repo_id} there again; it continues"
    sink.line(f"{out}: unfinished, the {activity} is under way or was interrupted; next: {next_step}")


def print_left_out(sink: output.Sink, manifest: store.Manifest) -> None:
    """Print the first files and items of the source that were left out, with the reasons."""
    skipped = (f"{item.message} ({item.reason})" for record in manifest.shards for item in record.skipped)
    source = manifest.spec.get("source")
    files = source.get("left_out", {}) if isinstance(source, dict) else {}
    named = (f"{name} ({reason})" for name, reason in files.items())
    for line in islice(chain(named, skipped), _LEFT_OUT_SHOWN):
        sink.info(wording.printable(f"left out: {line}"))
