"""``realtouch``: look into, check and convert data sets of real touches."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer

from cli.application import EXIT_FAILED, command, new_app, run
from cli.folders import add_shared
from cli.making import least_to_most, print_converted, print_unfinished
from cli.options import Json, OneSplit, Revision, Split, TouchSet, Workers, process_count
from cli.output import Sink
from cli.pictures import preview_touches
from cli.touch_conversions import add_conversions, announce_fetching
from realtouch.kind import KIND
from tactile_toolkit.checked_fields import switch
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.wording import counted

if TYPE_CHECKING:
    from realtouch.summary import Summary
    from realtouch.verification import TouchVerification


app = new_app("realtouch", "Real touches: load, check, filter and convert the recordings of a GelSight Mini.")


@command(app)
def load(
    *,
    name: TouchSet,
    split: OneSplit = None,
    revision: Revision = None,
    check: bool = switch(True, help="Check every round and the headers of its images."),
    sink: Sink,
) -> None:
    """Download what is missing, check it, and print what it holds.

    Example: realtouch load real-single-64x64 --split test
    """
    from realtouch.opening import load as open_set
    from realtouch.summary import summarise

    dataset = open_set(name, split, revision=revision)
    if check:
        _require_intact(sink, _verified(sink, name, split, revision, quick=True), name)
    summary = summarise(dataset)
    opened = split or " and ".join(dataset.splits)
    sink.document({"name": name, "split": opened, "checked": check, **summary.to_dict()})
    _print_summary(sink, opened, summary)
    arguments = ", ".join(map(repr, filter(None, (name, opened))))
    sink.line(f"next in Python: realtouch.load({arguments}).touches()")


@command(app)
def info(name: TouchSet, split: Split = None, revision: Revision = None, as_json: Json = False) -> None:
    """Show what each split of a data set holds and, if this toolkit made it, how.

    Example: realtouch info touches-64x64
    """
    from realtouch.convert.plan import Source
    from realtouch.dataset import dataset_of
    from realtouch.summary import summarise
    from tactile_toolkit.catalog.locate import folder_named
    from tactile_toolkit.store.job import manifest_so_far
    from tactile_toolkit.store.manifest import MANIFEST_FILE
    from tactile_toolkit.store.names import typed

    sink = Sink(as_json)
    folder = folder_named(name)
    manifest = None if folder is None else manifest_so_far(folder)
    if manifest is not None and not manifest.complete:
        sink.document({"name": name, "complete": False, "splits": manifest.split_table()})
        print_unfinished(sink, manifest, name, KIND.nouns, f"realtouch {manifest.spec.get('operation')}")
        return
    if manifest is not None and manifest.spec.get("operation") in ("frames", "export", "merge", "split"):
        print_converted(sink, manifest, name, nouns=KIND.nouns)
        return
    announce_fetching(sink, name, split)
    source = Source.open(name, revision, split)
    summaries = {each: summarise(dataset_of(shards)) for each, shards in source.shards.items()}
    sink.document(
        {
            "name": name,
            "splits": {each: summary.to_dict() for each, summary in summaries.items()},
            "spec": manifest.spec if manifest else None,
        }
    )
    for each, summary in summaries.items():
        _print_summary(sink, each, summary)
    if manifest is not None:
        where = f"{name}/{MANIFEST_FILE}"
        operation = typed(manifest.spec.get("operation"), str, where, "spec.operation")
        values = typed(manifest.spec.get("options") or {}, dict, where, "spec.options")
        options = ", ".join(f"{key} {value}" for key, value in values.items())
        sink.line(f"made by tactile-toolkit {manifest.toolkit_version}: {operation}, {options}")


@command(app)
def verify(
    *,
    name: TouchSet,
    split: Split = None,
    revision: Revision = None,
    quick: bool = switch(False, help="Read only the headers of images; decode none."),
    workers: Workers = 0,
    sink: Sink,
) -> None:
    """Check every file, round, touch and frame, and list all errors.

    Exit code 3 when something is damaged.

    Example: realtouch verify real-single-64x64 --split test
    """
    result = _verified(sink, name, split, revision, workers, quick=quick)
    findings = [
        {name: getattr(finding, name) for name in ("file", "row", "touch", "field", "problem")}
        for finding in result.findings
    ]
    counts_of = {"rounds": result.rounds, "touches": result.touches}
    unprotected = list(result.unprotected)
    sink.document({"ok": result.ok, **counts_of, "findings": findings, "unprotected": unprotected})
    _require_intact(sink, result, name)
    how = "every header was read" if quick else "every picture was decoded"
    counts = f"{counted(result.rounds, 'rounds')}, {counted(result.touches, 'touches')}"
    sink.line(f"{name}: {counts}: nothing is wrong; {how}")
    if result.unprotected:
        sink.line(
            f"{counted(len(result.unprotected), 'files')} unprotected, {result.unprotected[0]!r} first: no "
            "checksums of pages and none by a manifest or the Hub, so that a changed number shows nowhere"
        )


@command(app)
def reproduce(*, name: TouchSet, revision: Revision = None, sink: Sink) -> None:
    """Measure what the Tactile MNIST paper states about the real touches.

    Exit code 1 when something differs.

    Example: realtouch reproduce real-single-64x64
    """
    from realtouch.convert.plan import Source
    from realtouch.dataset import dataset_of
    from realtouch.summary import paper_numbers

    announce_fetching(sink, name, None)
    source = Source.open(name, revision, None)
    numbers = paper_numbers({split: dataset_of(shards) for split, shards in source.shards.items()})
    sink.document([number.to_dict() for number in numbers])
    rows = [(each.what, each.paper, each.found, "yes" if each.agrees else "NO") for each in numbers]
    sink.table(("what", "paper", "data", "agrees"), rows)
    if not all(number.agrees for number in numbers):
        raise typer.Exit(EXIT_FAILED)


def _verified(
    sink: Sink, name: str, split: str | None, revision: str | None, workers: int = 0, *, quick: bool
) -> TouchVerification:
    from realtouch.verification import verify as check

    count = process_count(workers)
    with sink.progress("checking", "rounds") as update:
        return check(name, split, revision=revision, quick=quick, workers=count, on_progress=update)


def _require_intact(sink: Sink, result: TouchVerification, name: str) -> None:
    """Name all damage on stderr; IntegrityError where there is any."""
    for finding in result.findings:
        sink.warn(f"damaged: {finding}")
    if not result.ok:
        raise IntegrityError(
            f"{counted(len(result.findings), 'problems')} in {name!r}",
            next="download or convert it again, or open it with on_error='skip' to leave them out",
        )


def _print_summary(sink: Sink, split: str, summary: Summary) -> None:
    """Print the figures of one split."""
    width, height = summary.image_size
    contact = "unknown"
    if summary.contact_share is not None:
        contact = f"{summary.contact_share:.1%} ({summary.contact_rule})"
    gels = ", ".join(f"{gel}: {counted(n, 'rounds')}" for gel, n in summary.gel_ids.items())
    rows: list[tuple[str, Any]] = [
        ("rounds", f"{summary.rounds:,}"),
        ("touches", f"{summary.touches:,} ({least_to_most(summary.touches_per_round)} per round)"),
        ("objects", f"{summary.objects:,}"),
        ("with contact", contact),
        ("labels", ", ".join(f"{name}: {count}" for name, count in summary.labels.items())),
        ("picture", f"{width} x {height} pixels"),
        ("gels", gels or "unknown"),
    ]
    if summary.clip_frames is not None:
        least, median, most = summary.clip_frames
        rows.append(("clips", f"{least} to {most} frames, median {median}, {summary.fps:g} per second"))
    sink.table((split, summary.kind), rows)


add_conversions(app)
add_shared(app, KIND, preview_touches)


def main() -> None:
    """Run the command line."""
    run(app)
