"""``realtouch``: load, import, check and convert recordings of tactile sensors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, asdict, replace
from functools import partial
from pathlib import Path

import typer

import realtouch
from cli import application, contents, options, output, runs
from cli.options import GenerateOptions, RunOptions, SourceOptions, argument, out_folder
from realtouch import touch_options
from realtouch.importing import import_options
from realtouch.kind import KIND
from tactile_toolkit import catalog, checked_fields, places, store, touch
from tactile_toolkit.checked_fields import text
from tactile_toolkit.wording import with_count

_MAPPED = text(
    name="--map",
    metavar="NAME=COLUMN",
    several=True,
    help="Column of the image, label, round, object, position, pose, split or time; any other NAME renames "
    "a column. @FILE reads such lines from a file.",
)
app = application.new_app(
    "realtouch", "Real touches: load, import, check and convert recordings of tactile sensors."
)


@application.command(app)
def load(
    *,
    name: str = options.NAME,
    split: str | None = touch_options.ONE_SPLIT,
    source_options: SourceOptions,
    sink: output.Sink,
) -> None:
    """Download missing files, check the data set quickly, and print what it holds and the line for Python.

    Example: realtouch load real-single-64x64 --split test
    """
    place = source_options.open_source(sink, name).require(KIND, "realtouch load")
    dataset = realtouch.load(place, split)
    # An unfinished data set was allowed, or is refused above.
    is_unfinished = bool(place.unfinished)
    contents.verify_touches(
        output.Sink(quiet=True), place, split, quick=True, allows_unfinished=is_unfinished
    )
    summary = realtouch.summarise(dataset)
    opened = split or " and ".join(dataset.splits)
    sink.document({"name": name, "split": opened, **summary.to_dict()})
    sink.table((opened, summary.kind), summary.table())
    arguments = ", ".join(map(repr, filter(None, (name, opened))))
    sink.line(f"next in Python: realtouch.load({arguments}).touches()")


@application.command(app, "import")
def import_touches(
    *,
    source: str = argument("SOURCE", "Folder or file of videos, images, episodes, arrays or ROS bags."),
    out: str = out_folder(),
    spec: import_options.ImportSpec,
    columns: import_options.ImportColumns,
    mapped: list[str] | None = _MAPPED,
    alignment: import_options.Alignment,
    run_options: GenerateOptions,
    sink: output.Sink,
) -> None:
    """Make a data set of touches from recordings; pictures are stored unchanged if possible.

    Items that cannot be used are left out and listed with the reason. Columns with the names that `tactile
    export` writes need no option; all others are kept.

    Example: realtouch import takes --map label=object --map pose=x_mm,y_mm,z_mm,qx,qy,qz,qw --out touches
    """
    columns = columns.with_mapped(mapped or ())
    for of_topic in columns.for_each_topic():
        folder = out
        if of_topic is not columns:
            folder = f"{out}/{of_topic.image_name.strip('/').replace('/', '-')}"
        topic_spec = replace(spec, columns=of_topic, alignment=alignment)
        if run_options.dry_run:
            _print_preview(sink, realtouch.preview_import(source, topic_spec), folder)
            continue
        make = partial(realtouch.import_touches, source, folder, topic_spec)
        manifest = runs.make_with_progress(sink, "importing", KIND, make, run_options, folder, "touches")
        if manifest is not None:
            _print_imported(sink, manifest)
            sink.line(f"next: realtouch check {folder}   tactile gallery {folder}")


def _print_preview(sink: output.Sink, preview: realtouch.ImportPreview, out: str) -> None:
    sink.document(asdict(preview))
    by = f", recognised by {preview.recognised_by}" if preview.recognised_by else ""
    sink.line(f"format: {preview.layout}{by}")
    if preview.cut:
        sink.line(f"recordings are cut: {preview.cut}")
    sink.line(f"pictures: {preview.pictures}")
    for note in preview.notes:
        sink.line(note)
    sink.line(f"classes: {', '.join(preview.classes) or 'none; all labels are -1'}")
    counts = ", ".join(f"{split} {count:,}" for split, count in preview.splits.items())
    rounds = with_count(preview.rounds, "rounds")
    sink.line(f"would make {with_count(preview.touches, 'touches')} in {rounds} in {out}: {counts}")
    sink.table(("column", "becomes", "unit"), preview.columns, title="columns and other data of the source")
    names = dict.fromkeys(name for values in preview.first for name in values)
    rows = [(name, *(values.get(name, "") for values in preview.first)) for name in names]
    sink.table(("stored as", *(f"touch {number}" for number in range(len(preview.first)))), rows)
    if preview.streams:
        sink.table(import_options.STREAM_HEADER, preview.streams)
    if preview.left_out:
        sink.table(("left out because of", "touches", "the first"), preview.left_out)


def _print_imported(sink: output.Sink, manifest: store.Manifest) -> None:
    options = manifest.spec["options"]
    if import_options.CONVERSION in options:
        sink.info(f"pictures: {options[import_options.CONVERSION]}")
    if not options["classes"]:
        sink.info("no classes are known (--map label=COLUMN names their column), so all labels are -1")
    for note in manifest.spec.get(import_options.NOTES, ()):
        sink.info(note)
    if import_options.STREAMS in manifest.spec:
        sink.table(import_options.STREAM_HEADER, manifest.spec[import_options.STREAMS])
    if import_options.LEFT_OUT in manifest.spec:
        sink.info(f"not read: {'; '.join(manifest.spec[import_options.LEFT_OUT])}")
    counted = manifest.total_statistics()
    for note, count in counted.get(import_options.CLIPS, {}).items():
        sink.info(f"{with_count(count, 'clips')}: {note}")
    for note, count in counted.get(import_options.PICTURES, {}).items():
        sink.info(f"{with_count(count, 'pictures')}: {note}")
    fields = counted.get(import_options.NOT_IMPORTED, {})
    if fields:
        counts = ", ".join(f"{name} ({count:,})" for name, count in fields.items())
        sink.info(f"fields that were not imported, with their numbers of touches: {counts}")


@application.command(app)
def check(
    *,
    name: str = options.NAME,
    split: str | None = catalog.row_option("split"),
    source_options: SourceOptions,
    limits: touch_options.CheckLimits,
    drawn: Path | None = text(
        name="--pictures",
        metavar="DIR",
        read=options.parse_local_path,
        help="Folder for a picture of each finding.",
    ),
    workers: int = options.WORKERS,
    sink: output.Sink,
) -> None:
    """Find frozen frames, exchanged channels, duplicates and other faults of recordings.

    `tactile verify` checks the files of a data set. Import other recordings first, with `realtouch import`.
    Exit code 1 if something is found.

    Example: realtouch check touches --pictures found
    """
    document = contents.print_faults(
        sink, source_options.open_source(sink, name), split, workers, limits, drawn
    )
    sink.document(document)
    if not document["ok"]:
        raise typer.Exit(application.EXIT_FAILED)


def convert(
    sink: output.Sink,
    place: places.Place,
    split: str | None,
    make: Callable[..., store.Manifest],
    run_options: RunOptions,
    out: str,
) -> None:
    """Print what will be fetched, convert touches with progress, and print what was made."""
    contents.announce_fetching(sink, place, split)
    runs.make_with_progress(sink, "converting", KIND, make, run_options, out)


@application.command(app)
def resize(
    *,
    name: str = options.NAME,
    source_options: SourceOptions,
    out: str = out_folder(),
    size_px: tuple[int, int] = touch.size_option(MISSING),
    quality: int = checked_fields.integer(
        95, 1, 100, help="JPEG quality of images that are encoded again, 1 to 100."
    ),
    split: str | None = catalog.row_option("split"),
    limit: int | None = catalog.row_option("limit"),
    run_options: RunOptions,
    sink: output.Sink,
) -> None:
    """Write the same data set with images or clips of another size.

    Example: realtouch resize real-single-320x240 --size 64x64 --out small
    """
    place = source_options.open_source(sink, name).require(KIND, "realtouch resize")
    size: options.UserOptions = {"width": size_px[0], "height": size_px[1], "quality": quality}
    make = partial(realtouch.resize, place, out, **size, split=split, limit=limit)
    convert(sink, place, split, make, run_options, out)


@application.command(app)
def stills(
    *,
    name: str = options.NAME,
    source_options: SourceOptions,
    out: str = out_folder(),
    clip_frame: str = touch_options.FRAME(),
    split: str | None = catalog.row_option("split"),
    limit: int | None = catalog.row_option("limit"),
    run_options: RunOptions,
    sink: output.Sink,
) -> None:
    """Make a data set of single images from one of clips: a frame of each clip, with its pose.

    Example: realtouch stills real-seq --clip-frame peak --out touches
    """
    place = source_options.open_source(sink, name).require(KIND, "realtouch stills")
    make = partial(realtouch.clips_to_images, place, out, frame=clip_frame, split=split, limit=limit)
    convert(sink, place, split, make, run_options, out)


main = partial(application.run, app)
