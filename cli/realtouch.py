"""``realtouch``: inspect, check and convert data sets of real touches."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import partial

import typer

import realtouch
from cli import (
    application,
    contents,
    options,
    output,
    pictures,
    runs,
    shared,
    touch_conversions,
)
from cli.touch_conversions import check
from realtouch import touch_options
from realtouch.kind import KIND
from tactile_toolkit import catalog, checked_fields, kind, places, store
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.wording import with_count

app = application.new_app(
    "realtouch", "Real touches: load, check, import, filter and convert recordings of tactile sensors."
)


@application.command(app)
def load(
    *,
    name: str = options.TOUCH_SET,
    split: str | None = touch_options.ONE_SPLIT,
    opening: options.Opening,
    check: bool = checked_fields.switch(True, help="Also check every round and the headers of its images."),
    sink: output.Sink,
) -> None:
    """Download missing files, check the data set, and print a summary.

    Example: realtouch load real-single-64x64 --split test
    """
    place = opening.open(sink, name).require(KIND, "load")
    dataset = realtouch.load(place, split)
    if check:
        result = _verified(sink, place, split, quick=True)
        if place.unfinished:  # which was allowed
            findings = (each for each in result.findings if each.file != store.MANIFEST_FILE)
            result = replace(result, findings=tuple(findings))
        _require_intact(sink, result, name, unfinished=bool(place.unfinished))
    summary = realtouch.summarise(dataset)
    opened = split or " and ".join(dataset.splits)
    sink.document({"name": name, "split": opened, "checked": check, **summary.to_dict()})
    _print_summary(sink, opened, summary)
    arguments = ", ".join(map(repr, filter(None, (name, opened))))
    sink.line(f"next in Python: realtouch.load({arguments}).touches()")


@application.command(app)
def info(
    *,
    name: str = options.TOUCH_SET,
    split: str | None = catalog.SPLIT,
    opening: options.Opening,
    sink: output.Sink,
) -> None:
    """Show what each split of a data set holds and, if this toolkit made it, how it was made.

    Example: realtouch info touches-64x64
    """
    place = opening.open(sink, name, shows_all=True).require(KIND, "info")
    manifest = place.manifest
    operation = ""
    if manifest is not None:
        operation = manifest.operation(f"{name}/{store.MANIFEST_FILE}")
        if not manifest.complete or operation in ("frames", "export", "merge", "split"):
            runs.print_set(sink, KIND, manifest, name)
            return
    touch_conversions.announce_fetching(sink, place, split)
    source = realtouch.Source.open(place, split)
    summaries = {
        each: realtouch.summarise(realtouch.dataset_of(shards)) for each, shards in source.shards.items()
    }
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
        sink.line(f"made by tactile-toolkit {manifest.toolkit_version}; {operation} with")
        for line in contents.flat_lines(manifest.spec.get("options")):
            sink.line(f"  {line}")


@application.command(app)
def verify(
    *,
    name: str = options.TOUCH_SET,
    split: str | None = catalog.SPLIT,
    opening: options.Opening,
    quick: bool = checked_fields.switch(False, help="Read only the headers of images; decode none."),
    workers: int = options.WORKERS,
    sink: output.Sink,
) -> None:
    """Check every file, round, touch and frame, and list all errors.

    Exit code 3 if something is damaged.

    Example: realtouch verify real-single-64x64 --split test
    """
    place = opening.open(sink, name)
    result = _verified(sink, place, split, workers, quick=quick)
    findings = list(map(asdict, result.findings))
    counts_of = {"rounds": result.rounds, "touches": result.touches}
    unprotected = list(result.unprotected)
    sink.document({"ok": result.ok, **counts_of, "findings": findings, "unprotected": unprotected})
    if place.folder is not None:
        store.require_finished(place.folder, [each.file for each in result.findings])
    _require_intact(sink, result, name, unfinished=bool(place.unfinished))
    how = "every header was read" if quick else "every picture was decoded"
    counts = f"{with_count(result.rounds, 'rounds')}, {with_count(result.touches, 'touches')}"
    sink.line(f"{name}: {counts}: nothing is wrong; {how}")
    if result.unprotected:
        sink.line(
            f"{with_count(len(result.unprotected), 'files')} unprotected, {result.unprotected[0]!r} first: "
            "neither their pages, nor a manifest, nor the Hub have checksums, so a changed number is not "
            "noticed"
        )


@application.command(app)
def reproduce(
    *,
    name: str = options.TOUCH_SET,
    opening: options.Opening,
    sink: output.Sink,
) -> None:
    """Compare the published touches with what the Tactile MNIST paper states about them.

    Exit code 1 if a number differs.

    Example: realtouch reproduce real-single-64x64
    """
    place = opening.open(sink, name).require(KIND, "reproduce")
    touch_conversions.announce_fetching(sink, place, None)
    source = realtouch.Source.open(place)
    numbers = realtouch.paper_numbers(
        {split: realtouch.dataset_of(shards) for split, shards in source.shards.items()}
    )
    sink.document([number.to_dict() for number in numbers])
    rows = [(each.what, each.paper, each.found, "yes" if each.agrees else "NO") for each in numbers]
    sink.table(("what", "paper", "data", "agrees"), rows)
    if not all(number.agrees for number in numbers):
        raise typer.Exit(application.EXIT_FAILED)


def _verified(
    sink: output.Sink, place: places.Place, split: str | None, workers: int = 0, *, quick: bool
) -> realtouch.TouchVerification:
    count = options.process_count(workers)
    with sink.progress("checking", "rounds") as update:
        return realtouch.verify(place, split, quick=quick, workers=count, on_progress=update)


def _require_intact(
    sink: output.Sink, result: realtouch.TouchVerification, name: str, *, unfinished: bool = False
) -> None:
    """Name all damage on stderr; IntegrityError if there is any."""
    for finding in result.findings:
        sink.warn(f"damaged: {finding}")
    if not result.ok:
        next_step = "download or convert it again"
        if unfinished:
            next_step = "run the same command with --check, which makes damaged shards again"
        raise IntegrityError(f"{with_count(len(result.findings), 'problems')} in {name!r}", next=next_step)


def _print_summary(sink: output.Sink, split: str, summary: realtouch.Summary) -> None:
    """Print the figures of one split."""
    width, height = summary.image_size
    contact = f"not counted ({summary.contact_rule})"
    if summary.contact_share is not None:
        contact = f"{summary.contact_share:.1%} ({summary.contact_rule})"
    gels = ", ".join(f"{gel}: {with_count(n, 'rounds')}" for gel, n in summary.gel_ids.items())
    per_round = "-".join(map(str, sorted({min(summary.touches_per_round), max(summary.touches_per_round)})))
    rows: list[tuple[str, object]] = [
        ("rounds", f"{summary.rounds:,}"),
        ("touches", f"{summary.touches:,} ({per_round} per round)"),
        ("objects", f"{summary.objects:,}" if summary.objects else "unknown"),
        ("with contact", contact),
        ("labels", ", ".join(f"{name}: {count}" for name, count in summary.labels.items()) or "none"),
        ("picture", f"{width} x {height} pixels"),
        ("gels", gels or "unknown"),
        *((f"extra {name}", type_text) for name, type_text in summary.extra.items()),
    ]
    if summary.clip_frames is not None:
        least, median, most = summary.clip_frames
        rows.append(("clips", f"{least} to {most} frames, median {median}, {summary.fps:g} per second"))
    sink.table((split, summary.kind), rows)


_convert = partial(touch_conversions.add_conversion, app)
_convert("clips-to-images", touch_conversions.ClipsToImages, kind.lazy("realtouch:clips_to_images"))
_convert("resize", touch_conversions.Resize, kind.lazy("realtouch:resize"))
_convert("depth", touch_conversions.Depth, kind.lazy("realtouch:add_depth"))
_convert("frames", touch_conversions.Frames, kind.lazy("realtouch:frames"), nouns="touches")
_convert("select", touch_conversions.Select, kind.lazy("realtouch:select"))
_convert("export", touch_conversions.Export, kind.lazy("realtouch:export"), nouns="rows")
application.command(app, "import")(touch_conversions.import_touches)
application.command(app)(check)
_left_out = dict.fromkeys(("info", "verify", "validate", "export", "select"))
shared.add_shared(
    app, KIND, {**_left_out, "preview": pictures.preview_touches, "gallery": pictures.gallery_of_touches}
)

main = partial(application.run, app)
