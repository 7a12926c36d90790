"""Making a data set folder as all command lines do it: progress while it lasts, then what was made."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from itertools import chain, islice
from typing import TYPE_CHECKING, Any

from cli.options import ANY_SET, Making, Opening, Work, argument, out_folder, process_count
from cli.output import Sink, bytes_text, duration_text
from tactile_toolkit.catalog.spec import Chosen
from tactile_toolkit.checked_fields import integer, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.wording import counted, listed, printable

if TYPE_CHECKING:
    from tactile_toolkit.making import Forecast, Making as RowMaking
    from tactile_toolkit.store.build import Progress
    from tactile_toolkit.store.manifest import Manifest


_LEFT_OUT_SHOWN = 20

PrintMade = Callable[..., None]
"""Prints what a folder holds.

Of a sink, a kind, a manifest, the folder, and how long it took where it was just made, else None.
"""


def generate_set(
    sink: Sink,
    what: str,
    rows: RowMaking,
    out: str,
    splits: Sequence[str] | None,
    making: Making,
    print_made: PrintMade,
    require: Callable[[], None] = lambda: None,
) -> None:
    """Make a data set of a kind, or forecast it, and print what was made and what comes next."""
    from tactile_toolkit.making import forecast, generate

    if making.dry_run:
        runner, overwrite = making.chosen_runner(), making.overwrite
        view = forecast(rows, out, splits, runner, overwrite=overwrite, require=require)
        _print_forecast(sink, rows.kind, view, out, making)
        return
    make = partial(generate, rows, out, splits, require=require)
    manifest = make_with_progress(sink, what, rows.kind, make, making, out, print_made)
    if manifest is None:
        return
    table = manifest.split_table()
    # One that has rows, so that the line works when it is tried.
    split = next(name for name in splits or table if table[name]["rows"])
    call = rows.kind.loading_lines(manifest, out, split)[1]
    sink.line(f"next: {rows.kind.command} verify {out}   or in Python: {call}")


def make_with_progress(
    sink: Sink,
    what: str,
    kind: DatasetKind,
    make: Callable[..., Manifest],
    work: Work,
    out: str,
    print_made: PrintMade,
    unit: str | None = None,
) -> Manifest | None:
    """Run ``make`` and print what was made; progress counts ``unit`` where that is not the nouns of rows.

    It takes ``workers``, ``overwrite`` and ``on_progress``. Returns None where this was one part of many.
    """
    from tactile_toolkit.store.folder import DataFolder
    from tactile_toolkit.store.job import MissingPartsError, manifest_so_far

    start_s = time.monotonic()
    rows = skipped = 0
    with sink.progress(what, unit or kind.nouns) as update:

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
    elapsed_s = time.monotonic() - start_s
    left_out = f", {counted(skipped, unit) if unit else f'{skipped:,}'} left out," if skipped else ""
    made = f"made {counted(rows, kind.nouns)}{left_out} in {duration_text(elapsed_s)}"
    made = made if rows or skipped else "nothing was left to make"
    if work.part is not None:
        counts = {"rows": rows, "skipped": skipped, "elapsed_s": round(elapsed_s, 3)}
        sink.document({"folder": out, "complete": False, "part": work.part, **counts})
        sink.line(f"{made}; part {work.part} of the data set in {out} is there")
        sink.line("next: when all parts have ended, the same command with --finish instead of --part")
        return None
    # Another split may be unfinished: what is finished of it stays and is shown, as `info` shows it.
    manifest = manifest_so_far(DataFolder(out)) or manifest
    print_made(sink, kind, manifest, out, elapsed_s)
    sink.line(f"{made}; the data set is in {out}")
    return manifest


def _print_forecast(sink: Sink, kind: DatasetKind, view: Forecast, out: str, making: Making) -> None:
    sink.document(asdict(view))
    header = ("split", kind.nouns, "shards", "finished already")
    sink.table(header, [tuple(entry.values()) for entry in view.splits])
    if view.replaced is not None:
        parts = ", ".join(f"{split} {rows:,}" for split, rows in view.replaced.items())
        held = f"{counted(sum(view.replaced.values()), 'rows')} ({parts})" if parts else "no rows"
        sink.line(f"would replace the data set in {out}: {held}")
    part = "" if making.part is None else f" (part {making.part})"
    sink.line(
        f"would make {counted(view.rows_to_make, kind.nouns)}{part} in {out}: about "
        f"{bytes_text(view.bytes)} of Parquet, about {duration_text(view.seconds)} with "
        f"{counted(process_count(making.workers), 'workers')} (measured on "
        f"{counted(view.sampled, kind.nouns)}); nothing was written"
    )


def print_set(
    sink: Sink,
    kind: DatasetKind,
    manifest: Manifest,
    out: str,
    elapsed_s: float | None = None,
    header: Sequence[str] = (),
    rows: Sequence[Sequence[object]] = (),
    left_out: str = "",
    **further: Any,
) -> None:
    """Print what a folder holds, and how it continues where its run is not finished.

    ``rows`` are printed of a finished one in place of the counts of the manifest; ``left_out`` is what items
    that were left out are called, where they are no rows; ``further`` are JSON values for the document.
    """
    from tactile_toolkit.store.folder import DataFolder
    from tactile_toolkit.store.origin import read_record

    table = manifest.split_table()
    planned = {split: count for split, count in manifest.shards_planned().items() if split in table}
    sink.document(
        {
            "folder": out,
            "complete": manifest.complete,
            "toolkit_version": manifest.toolkit_version,
            "elapsed_s": None if elapsed_s is None else round(elapsed_s, 3),
            "shards_planned": planned,
            "splits": table,
            **further,
            "spec": manifest.spec,
        }
    )
    if not manifest.complete:
        record = read_record(DataFolder(out))
        found = "the run is under way or was interrupted" if table else "no shard is finished yet"
        made_by = kind.command_of(manifest)
        next_step = f"the same `{made_by}` continues where it stopped, --finish names what is missing"
        if record is not None:
            found = "the download is under way or was interrupted"
            next_step = f"download {record.repo_id} there again, it continues where it stopped"
        sink.line(f"{out}: unfinished, {found}; {next_step}")
    if not (manifest.complete and header):
        header = ("split", kind.nouns, "shards", "Parquet", "left out")
        rows = [
            (name, e["rows"], f"{e['shards']:,} of {planned[name]:,}", bytes_text(e["bytes"]), e["skipped"])
            for name, e in table.items()
        ]
    sink.table(header, rows)
    for reason, count in manifest.skipped_reasons().items():
        items = counted(count, left_out or kind.nouns)
        sink.line(f"left out {items}: {reason} (each is named in {out}/manifest.json)")


def print_left_out(sink: Sink, manifest: Manifest) -> None:
    """Print the first items that gave no row, and the first files of the source that hold none."""
    skipped = (f"{item.message} ({item.reason})" for record in manifest.shards for item in record.skipped)
    source = manifest.spec.get("source")
    files = source.get("left_out") if isinstance(source, dict) else None
    named = (f"{name} ({reason})" for name, reason in (files.items() if isinstance(files, dict) else ()))
    for line in islice(chain(named, skipped), _LEFT_OUT_SHOWN):
        sink.info(printable(f"left out: {line}"))


def least_to_most(counts: Sequence[int]) -> str:
    """Write how many rows classes have: ``"10"`` where all have as many, else ``"8-10"``."""
    least, most = min(counts), max(counts)
    return str(most) if least == most else f"{least}-{most}"


def _fractions(words: str) -> tuple[float, ...]:
    try:
        shares = tuple(map(float, listed(words)))
    except ValueError:
        shares = ()
    if not shares or not all(0 < share <= 1 for share in shares) or sum(shares) > 1 + 1e-9:
        raise InputError(
            f"--fractions is {words!r}; expected shares that add up to 1 or less, such as 0.8,0.2"
        )
    return shares


def merge(
    *,
    kind: DatasetKind,
    names: list[str] = argument("DIR...", "Data sets of one kind.", several=True),
    opening: Opening,
    out: str = out_folder("merged"),
    work: Work,
    sink: Sink,
) -> None:
    """Merge data sets whose ids differ into one; shards are copied unchanged.

    Example: merge DIR OTHER --out both
    """
    from tactile_toolkit.exchange.copies import merge_sets

    places = [opening.open(sink, name) for name in names]
    make = partial(merge_sets, kind, places, out)
    make_with_progress(sink, "copying", kind, make, work, out, print_set)


def split(
    *,
    kind: DatasetKind,
    name: str = ANY_SET,
    opening: Opening,
    out: str = out_folder("parts"),
    fractions: tuple[float, ...] = text(
        (),
        metavar="0.8,0.2",
        read=_fractions,
        help="Fractions of the rows of each split, one for each part.",
    ),
    seed: int = integer(0, help="Random seed for --fractions."),
    chosen: Chosen,
    work: Work,
    sink: Sink,
) -> None:
    """Divide a data set into several of the same kind: OUT/part-1, OUT/part-2 and so on.

    Rows are drawn at random (--fractions), or part-1 gets the objects that --ids, --labels and similar
    options choose, and part-2 all others.

    Examples: split DIR --fractions 0.8,0.2 --out parts;  split DIR --ids 3,17,40-60 --out parts
    """
    from tactile_toolkit.exchange.copies import divide, write_part

    given = {each: value for each, value in chosen.given().items() if value is not None}
    if bool(given) == bool(fractions):
        raise InputError("expected either --fractions, or --ids and the like", next="add --fractions 0.8,0.2")
    options = {"fractions": fractions, "seed": seed} if fractions else given
    source = opening.open(sink, name)
    for number, rows in enumerate(divide(kind, source, fractions, seed, given), 1):
        place = f"{out.rstrip('/')}/part-{number}"
        make = partial(write_part, kind, source, rows, {**options, "part": number}, place)
        make_with_progress(sink, "copying", kind, make, work, place, print_set)
