"""Commands that import, check and convert touches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path

import typer

import realtouch
from cli import application, options, output, runs
from cli.options import TOUCH_SET, Making, Opening, Work, argument, out_folder
from realtouch import touch_options
from realtouch.kind import KIND
from realtouch.touches import damage
from tactile_toolkit import catalog, checked_fields, places, store, touch
from tactile_toolkit.checked_fields import choice, text
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.wording import comma_separated, with_count

_FRAME = checked_fields.choice(
    "contact_end",
    ("contact_end", "contact_start", "peak", "best"),
    help="Frame of a clip: end or start of the contact, the deepest press, or the highest contact score.",
)
_MAPPED = text(
    name="--map",
    metavar="NAME=COLUMN",
    several=True,
    help="Column of the image, label, round, object, position, pose, split or time; any other NAME renames "
    "a column. @FILE reads such lines from a file.",
)
_STREAMS = text(
    name="--stream",
    metavar="FILE",
    several=True,
    help="Table with times, such as poses or forces, that is aligned with the pictures.",
)


@dataclass(frozen=True, slots=True)
class _Options:
    """Options of a conversion."""

    def arguments(self) -> options.Given:
        """Return the arguments of the conversion."""
        return {each.name: getattr(self, each.name) for each in fields(self)}


@dataclass(frozen=True, slots=True)
class ClipsToImages(_Options):
    """Make a data set of single images from one of clips: a frame of each clip, with its pose.

    Example: realtouch clips-to-images real-seq --frame peak --out touches
    """

    frame: str = _FRAME


@dataclass(frozen=True, slots=True)
class Resize(_Options):
    """Write the same data set with images or clips of another size.

    Example: realtouch resize real-single-320x240 --size 64x64 --out small
    """

    size_px: tuple[int, int] = touch.size_option(MISSING)
    quality: int = checked_fields.integer(
        95, 1, 100, help="JPEG quality of images that are encoded again, 1 to 100."
    )

    def arguments(self) -> options.Given:
        """Return the arguments of the conversion; width and height are separate."""
        width, height = self.size_px
        return {"width": width, "height": height, "quality": self.quality}


@dataclass(frozen=True, slots=True)
class Depth(_Options):
    """Write the same data set with depth maps in metres, as the twin of the sensor reads them.

    Each pixel has an expected error.

    Example: realtouch depth recordings --sensor my-sensor --out depths
    """

    sensor: str = checked_fields.text(
        MISSING, metavar="MODEL", help="Folder that `tactile-sim calibrate` wrote."
    )
    fast: bool = checked_fields.switch(
        False, help="Use a faster method, with about twice the error and a tenth of the time."
    )


@dataclass(frozen=True, slots=True)
class Frames(_Options):
    """Write touches as plain image files with an index in CSV and Parquet.

    Example: realtouch frames real-single-64x64 --format jpeg --out pictures

    Example: realtouch frames real-seq --frame best --difference grey --out changes
    """

    kind: str = checked_fields.choice(
        "png",
        ("png", "jpeg"),
        name="--format",
        help="png: exact pixels; jpeg: the stored JPEGs, unchanged.",
    )
    frame: str = _FRAME
    difference: str | None = checked_fields.choice(
        None,
        ("grey", "absolute"),
        optional=True,
        help="Write the difference from the median of the clip or round: grey (128 means no change) or "
        "absolute.",
    )


@dataclass(frozen=True, slots=True)
class Select(_Options):
    """Write selected rounds and touches of a data set; images are copied byte for byte.

    Example: realtouch select real-single-64x64 --contact --labels 3,5 --out touched
    """

    contact: bool = checked_fields.switch(False, help="Only touches in contact with an object.")
    min_height_mm: float | None = touch.HeightRule.option(needs="contact")
    as_recorded: bool = checked_fields.switch(
        False,
        needs="contact",
        help="Take heights as recorded; by default, if the height of the plate is unknown, above the deepest "
        "touch of each round.",
    )
    ids: catalog.IdChoice | None = catalog.IDS
    labels: tuple[str, ...] | None = catalog.LABELS
    per_class: int | None = catalog.PER_CLASS

    def arguments(self) -> options.Given:
        """Return the arguments of the conversion."""
        # Ids of objects are numbers.
        objects = [each if isinstance(each, int) else catalog.id_range(each) for each in self.ids or ()]
        min_height_m = None
        if self.min_height_mm is not None:
            min_height_m = self.min_height_mm / 1000
        return {
            "contact": self.contact,
            "min_height_m": min_height_m,
            "recalibrate_z": not self.as_recorded,
            "objects": objects,
            "labels": self.labels or (),
            "per_class": self.per_class,
        }


@dataclass(frozen=True, slots=True)
class Export(_Options):
    """Write touches for other libraries; stored JPEGs are copied, never encoded again.

    Example: realtouch export real-single-64x64 --split train --format flat --out flat

    Example: realtouch export real-seq --split train --format lerobot --out robots
    """

    layout: str = checked_fields.choice(
        MISSING,
        ("flat", "webdataset", "lerobot", "oxt", "replay", "fota", "anytouch"),
        name="--format",
        help="flat: Parquet, a row for each touch; webdataset: tars; lerobot: LeRobotDataset v3.0; oxt: Zarr "
        "of FTP-1; replay: Zarr of Diffusion Policy; fota: tars of T3; anytouch: list "
        "files. lerobot, oxt and replay hold one split.",
    )
    frame: str = _FRAME


def add_conversion(
    app: typer.Typer,
    name: str,
    options_of: type,
    function: Callable[..., store.Manifest],
    nouns: str = KIND.nouns,
) -> None:
    """Add a command: print what will be fetched, convert with progress, print what was made.

    ``options_of`` is the class of its options. They have the names of parameters of ``function``, unless the
    method ``arguments`` is overridden. Its docstring is the help. ``nouns`` names the rows of the result.
    """

    def convert(
        *,
        source: str = TOUCH_SET,
        opening: Opening,
        out: str = out_folder(),
        options: _Options,
        split: str | None = catalog.SPLIT,
        limit: int | None = catalog.LIMIT,
        work: Work,
        sink: output.Sink,
    ) -> None:
        opened = opening.open(sink, source).require(KIND, name)
        make = partial(function, opened, out, **options.arguments(), split=split, limit=limit)
        announce_fetching(sink, opened, split)
        kind = replace(KIND, nouns=nouns)
        runs.make_with_progress(sink, "converting", kind, make, work, out, runs.print_set, KIND.nouns)

    convert.__doc__ = options_of.__doc__
    convert.__annotations__["options"] = options_of
    application.command(app, name)(convert)


def announce_fetching(sink: output.Sink, place: places.Place, split: str | None) -> None:
    """Print which splits will be fetched from the Hub, as published data sets have many gigabytes."""
    if place.repository is None:
        return
    part = "all splits (--split selects one)"
    if split:
        part = f"split {split!r}"
    sink.info(f"{place.repository.repo_id}: fetching the missing files of {part} from the Hub")


def import_touches(
    *,
    source: str = argument("SOURCE", "Folder or file of videos, images, episodes or arrays."),
    file_format: str | None = choice(
        None,
        touch_options.IMPORT_LAYOUTS,
        optional=True,
        name="--format",
        help="Format of the source; by default it is recognised by its content.",
    ),
    out: str = out_folder(),
    columns: touch_options.ImportColumns,
    mapped: list[str] | None = _MAPPED,
    table: str | None = text(
        metavar="FILE", help="Table of the images or videos; by default the only one in SOURCE."
    ),
    streams: list[str] | None = _STREAMS,
    alignment: touch_options.Alignment,
    cut: str | None = text(
        metavar="frames|whole|contact|FILE",
        help="How a recording is divided into touches: by picture, not at all, by contact, or by a table.",
    ),
    classes: list[str] | None = text(
        metavar="A,B", read=comma_separated, help="Names of the classes, in order; by default those found."
    ),
    split_name: str | None = text(
        name="--split",
        metavar="NAME",
        help="Name of the split, if no column has it; by default from the names of tars (SPLIT-000000.tar), "
        "or train.",
    ),
    making: Making,
    sink: output.Sink,
) -> None:
    """Make a data set of touches from recordings; pictures are stored unchanged if possible.

    Items that cannot be used are left out and listed with the reason. Columns with the names that `realtouch
    frames` and `realtouch export` write need no option; all others are kept.

    Example: realtouch import takes --map label=object --map pose=x_mm,y_mm,z_mm,qx,qy,qz,qw --out touches
    """
    reading: options.Given = {
        "layout": file_format,
        "columns": columns.with_mapped(mapped or ()),
        "table": table,
        "streams": streams or (),
        "alignment": alignment,
        "cut": cut,
        "classes": classes or (),
        "split": split_name,
    }
    if making.dry_run:
        _print_preview(sink, realtouch.preview_import(source, **reading), out)
        return
    make = partial(realtouch.import_touches, source, out, **reading)
    if runs.make_with_progress(sink, "importing", KIND, make, making, out, _print_imported, "touches"):
        sink.line(f"next: realtouch check {out}   realtouch gallery {out}")


def _print_preview(sink: output.Sink, found: realtouch.ImportPreview, out: str) -> None:
    sink.document(asdict(found))
    by = f", recognised by {found.recognised_by}" if found.recognised_by else ""
    sink.line(f"format: {found.layout}{by}")
    if found.cut:
        sink.line(f"recordings are cut: {found.cut}")
    sink.line(f"pictures: {found.pictures}")
    sink.line(f"classes: {', '.join(found.classes) or 'none; all labels are -1'}")
    counts = ", ".join(f"{split} {count:,}" for split, count in found.splits.items())
    rounds = with_count(found.rounds, "rounds")
    sink.line(f"would make {with_count(found.touches, 'touches')} in {rounds} in {out}: {counts}")
    sink.table(("column", "becomes", "unit"), found.columns, title="columns of the source")
    names = dict.fromkeys(name for values in found.first for name in values)
    rows = [(name, *(values.get(name, "") for values in found.first)) for name in names]
    sink.table(("stored as", *(f"touch {number}" for number in range(len(found.first)))), rows)
    if found.streams:
        sink.table(touch_options.STREAM_HEADER, found.streams)
    if found.left_out:
        sink.table(("left out because of", "touches", "the first"), found.left_out)


def _print_imported(
    sink: output.Sink, kind: DatasetKind, manifest: store.Manifest, out: str, _elapsed_s: float | None
) -> None:
    options = manifest.spec["options"]
    if realtouch.CONVERSION in options:
        sink.info(f"pictures: {options[realtouch.CONVERSION]}")
    if not options["classes"]:
        sink.info("no classes are known (--map label=COLUMN names their column), so all labels are -1")
    if touch_options.STREAMS in manifest.spec:
        sink.table(touch_options.STREAM_HEADER, manifest.spec[touch_options.STREAMS])
    if touch_options.LEFT_OUT in manifest.spec:
        sink.info(f"not read: {', '.join(manifest.spec[touch_options.LEFT_OUT])}")
    runs.print_left_out(sink, manifest)
    counted = manifest.total_statistics()
    for note, count in counted.get(touch_options.CLIPS, {}).items():
        sink.info(f"{with_count(count, 'clips')}: {note}")
    fields = counted.get(realtouch.NOT_IMPORTED, {})
    if fields:
        counts = ", ".join(f"{name} ({count:,})" for name, count in fields.items())
        sink.info(f"fields that were not imported, with their numbers of touches: {counts}")
    runs.print_set(sink, kind, manifest, out, left_out="touches")


def check(
    *,
    name: str = options.TOUCH_SET,
    split: str | None = catalog.SPLIT,
    opening: options.Opening,
    limits: touch_options.CheckLimits,
    drawn: Path | None = text(
        name="--pictures",
        metavar="DIR",
        read=options.local_place,
        help="Folder for a picture of each finding.",
    ),
    workers: int = options.WORKERS,
    sink: output.Sink,
) -> None:
    """Find frozen frames, exchanged channels, duplicates and other faults of recordings.

    `verify` checks the files of a data set. Import other recordings first, with `import`. Exit code 1 if
    something is found.

    Example: realtouch check touches --pictures found
    """
    place = opening.open(sink, name)
    with sink.progress("checking", "rounds") as update:
        result = realtouch.check(
            place, split, limits=limits, workers=options.process_count(workers), on_progress=update
        )
    made: list[str] = []
    if drawn is not None and result.findings:
        folder = store.open_folder(str(drawn.absolute()))
        written = result.pictures().write(folder)
        made = [str(drawn / each.file) for each in written]
    sink.line(
        f"{name}: {with_count(result.rounds, 'rounds')}, {with_count(result.touches, 'touches')}; "
        f"all stored pictures were compared, {result.decoded:,} decoded"
    )
    for path in made:
        sink.line(f"drawn: {path}")
    sink.document(
        {
            "name": name,
            "ok": result.ok,
            "rounds": result.rounds,
            "touches": result.touches,
            "decoded": result.decoded,
            "findings": list(map(asdict, result.findings)),
            "pictures": made,
        }
    )
    for fault in result.findings:
        _warn_of(sink, fault)
    if not result.ok:
        sink.line(f"{with_count(len(result.findings), 'findings')} in {name}")
        raise typer.Exit(application.EXIT_FAILED)
    sink.line(f"{name}: nothing was found")


def _warn_of(sink: output.Sink, fault: realtouch.RecordingFinding) -> None:
    """Print a finding, the first touches that have it, and the next step."""
    sink.warn(f"{fault.rule} in {fault.where}: {fault.found}; expected {fault.expected}")
    named = ", ".join(fault.touches)
    if len(fault.touches) == damage.MAX_NAMED:
        named = f"{named}, ..."
    if fault.count:
        sink.warn(f"  {with_count(fault.count, 'touches')}: {named}")
    sink.warn(f"  next: {fault.next}")
