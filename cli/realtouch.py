"""``realtouch``: look into, check and convert data sets of real touches."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from cli.application import EXIT_FAILED, command, new_app, run
from cli.folders import print_converted, print_unfinished
from cli.options import Json, OneSplit, Revision, Split, TouchSet, Workers, process_count
from cli.output import Sink
from cli.preview_commands import preview_touches
from cli.shared_commands import add_shared
from cli.touch_conversions import add_conversions
from cli.touch_tables import announce_fetching, print_summary, raise_findings
from realtouch.kind import KIND
from tactile_toolkit.checked_fields import switch
from tactile_toolkit.wording import counted

if TYPE_CHECKING:
    from realtouch.integrity.verify import TouchVerification


app = new_app("realtouch", "Real touches: load, check, filter and convert the recordings of a GelSight Mini.")


@command(app)
def load(
    *,
    name: TouchSet,
    split: OneSplit = None,
    revision: Revision = None,
    check: bool = switch(True, help="Check every round and the headers of its pictures."),
    sink: Sink,
) -> None:
    """Download what is missing, check it, and print what it holds.

    Example: realtouch load real-single-64x64 --split test
    """
    from realtouch.opening import load as open_set
    from realtouch.summary import summarise

    dataset = open_set(name, split, revision=revision)
    if check:
        raise_findings(sink, _verified(sink, name, split, revision, quick=True), name)
    summary = summarise(dataset)
    opened = split or " and ".join(dataset.splits)
    sink.document({"name": name, "split": opened, "checked": check, **summary.to_dict()})
    print_summary(sink, opened, summary)
    arguments = ", ".join(map(repr, filter(None, (name, opened))))
    sink.line(f"next in Python: realtouch.load({arguments}).touches()")


@command(app)
def info(name: TouchSet, split: Split = None, revision: Revision = None, as_json: Json = False) -> None:
    """Show what each split of a data set holds and, for one of ours, how it was made.

    Example: realtouch info touches-64x64
    """
    from realtouch.convert.plan import Source
    from realtouch.dataset import dataset_of
    from realtouch.integrity.agreement import folder_meant
    from realtouch.summary import summarise
    from tactile_toolkit.store.job import manifest_so_far
    from tactile_toolkit.store.manifest import MANIFEST_FILE
    from tactile_toolkit.store.typed_json import typed

    sink = Sink(as_json)
    folder = folder_meant(name)
    manifest = None if folder is None else manifest_so_far(folder)
    if manifest is not None and not manifest.complete:
        sink.document({"name": name, "complete": False, "splits": manifest.split_table()})
        print_unfinished(sink, manifest, name, "rounds", f"realtouch {manifest.spec.get('operation')}")
        return
    if manifest is not None and manifest.spec.get("operation") in ("frames", "export"):
        print_converted(sink, manifest, name)
        return
    announce_fetching(sink, name, split)
    source = Source.open(name, revision, split)
    summaries = {each: summarise(dataset_of(shards, source.kind)) for each, shards in source.shards.items()}
    sink.document(
        {
            "name": name,
            "splits": {each: summary.to_dict() for each, summary in summaries.items()},
            "spec": manifest.spec if manifest else None,
        }
    )
    for each, summary in summaries.items():
        print_summary(sink, each, summary)
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
    quick: bool = switch(False, help="Read headers of pictures; decode none."),
    workers: Workers = 0,
    sink: Sink,
) -> None:
    """Check every file, round, touch and frame, and list all that is wrong.

    Exit code 3 when something is damaged.

    Example: realtouch verify real-single-64x64 --split test
    """
    result = _verified(sink, name, split, revision, workers, quick=quick)
    findings = [
        {"file": f.file, "row": f.row, "touch": f.touch, "field": f.field, "problem": f.problem}
        for f in result.findings
    ]
    sink.document(
        {
            "ok": result.ok,
            "rounds": result.rounds,
            "touches": result.touches,
            "findings": findings,
            "unprotected": list(result.unprotected),
        }
    )
    raise_findings(sink, result, name)
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
    """Measure what the Tactile MNIST paper states of the real touches, number by number.

    Exit code 1 when the data say something else.

    Example: realtouch reproduce real-single-64x64
    """
    from realtouch.convert.plan import Source
    from realtouch.dataset import dataset_of
    from realtouch.reproduce import paper_numbers

    announce_fetching(sink, name, None)
    source = Source.open(name, revision, None)
    numbers = paper_numbers(
        {split: dataset_of(shards, source.kind) for split, shards in source.shards.items()}
    )
    sink.document([number.to_dict() for number in numbers])
    rows = [(each.what, each.paper, each.found, "yes" if each.agrees else "NO") for each in numbers]
    sink.table(("what", "paper", "data", "agrees"), rows)
    if not all(number.agrees for number in numbers):
        raise typer.Exit(EXIT_FAILED)


add_conversions(app)
add_shared(app, KIND, preview_touches)


def main() -> None:
    """Run the command line."""
    run(app)


def _verified(
    sink: Sink, name: str, split: str | None, revision: str | None, workers: int = 0, *, quick: bool
) -> TouchVerification:
    from realtouch.integrity.verify import verify as check

    count = process_count(workers)
    with sink.progress("checking", "rounds") as update:
        return check(name, split, revision=revision, quick=quick, workers=count, on_progress=update)
