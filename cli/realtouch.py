"""``realtouch``: look into, check and convert data sets of real touches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, asdict, dataclass, fields, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import typer

from cli.application import EXIT_FAILED, command, new_app, run
from cli.making import least_to_most, make_with_progress, print_left_out, print_set
from cli.options import TOUCH_SET, WORKERS, Opening, Work, argument, out_folder, process_count
from cli.output import Sink, flat_lines
from cli.products import gallery_of_touches, preview_touches
from cli.shared import add_shared
from realtouch.kind import KIND
from realtouch.touch_options import ImportColumns
from tactile_toolkit import catalog, places, store
from tactile_toolkit.checked_fields import choice, integer, switch, text
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.kind import DatasetKind, lazy
from tactile_toolkit.touch import contact_height_option, size_option
from tactile_toolkit.wording import counted, listed

if TYPE_CHECKING:
    from realtouch.summary import Summary
    from realtouch.verification import TouchVerification

app = new_app("realtouch", "Real touches: load, check, filter and convert the recordings of a GelSight Mini.")


@command(app)
def load(
    *,
    name: str = TOUCH_SET,
    split: str | None = catalog.ONE_SPLIT,
    opening: Opening,
    check: bool = switch(True, help="Check every round and the headers of its images."),
    sink: Sink,
) -> None:
    """Download what is missing, check it, and print what it holds.

    Example: realtouch load real-single-64x64 --split test
    """
    from realtouch.opening import load as open_set
    from realtouch.summary import summarise

    place = opening.open(sink, name).require(KIND, "load")
    dataset = open_set(place, split)
    if check:
        _require_intact(sink, _verified(sink, place, split, quick=True), name)
    summary = summarise(dataset)
    opened = split or " and ".join(dataset.splits)
    sink.document({"name": name, "split": opened, "checked": check, **summary.to_dict()})
    _print_summary(sink, opened, summary)
    arguments = ", ".join(map(repr, filter(None, (name, opened))))
    sink.line(f"next in Python: realtouch.load({arguments}).touches()")


@command(app)
def info(*, name: str = TOUCH_SET, split: str | None = catalog.SPLIT, opening: Opening, sink: Sink) -> None:
    """Show what each split of a data set holds and, if this toolkit made it, how.

    Example: realtouch info touches-64x64
    """
    from realtouch.convert.conversion import Source
    from realtouch.summary import summarise
    from realtouch.touch_dataset import dataset_of

    place = opening.open(sink, name, shows_all=True).require(KIND, "info")
    manifest = place.manifest
    operation = ""
    if manifest is not None:
        operation = store.typed(
            manifest.spec.get("operation"), str, f"{name}/{store.MANIFEST_FILE}", "spec.operation"
        )
        if not manifest.complete or operation in ("frames", "export", "merge", "split"):
            print_set(sink, KIND, manifest, name)
            return
    announce_fetching(sink, place, split)
    source = Source.open(place, split)
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
        sink.line(f"made by tactile-toolkit {manifest.toolkit_version}; {operation} with")
        for line in flat_lines(manifest.spec.get("options")):
            sink.line(f"  {line}")


@command(app)
def verify(
    *,
    name: str = TOUCH_SET,
    split: str | None = catalog.SPLIT,
    opening: Opening,
    quick: bool = switch(False, help="Read only the headers of images; decode none."),
    workers: int = WORKERS,
    sink: Sink,
) -> None:
    """Check every file, round, touch and frame, and list all errors.

    Exit code 3 when something is damaged.

    Example: realtouch verify real-single-64x64 --split test
    """
    place = opening.open(sink, name)
    if place.folder is not None and place.unfinished:
        place.require(KIND, "verify")
        store.require_finished(place.folder)
    result = _verified(sink, place, split, workers, quick=quick)
    findings = list(map(asdict, result.findings))
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
def reproduce(*, name: str = TOUCH_SET, opening: Opening, sink: Sink) -> None:
    """Measure what the Tactile MNIST paper states about the real touches.

    Exit code 1 when something differs.

    Example: realtouch reproduce real-single-64x64
    """
    from realtouch.convert.conversion import Source
    from realtouch.summary import paper_numbers
    from realtouch.touch_dataset import dataset_of

    place = opening.open(sink, name)
    announce_fetching(sink, place, None)
    source = Source.open(place)
    numbers = paper_numbers({split: dataset_of(shards) for split, shards in source.shards.items()})
    sink.document([number.to_dict() for number in numbers])
    rows = [(each.what, each.paper, each.found, "yes" if each.agrees else "NO") for each in numbers]
    sink.table(("what", "paper", "data", "agrees"), rows)
    if not all(number.agrees for number in numbers):
        raise typer.Exit(EXIT_FAILED)


def _verified(
    sink: Sink, place: places.Place, split: str | None, workers: int = 0, *, quick: bool
) -> TouchVerification:
    from realtouch.verification import verify as check

    count = process_count(workers)
    with sink.progress("checking", "rounds") as update:
        return check(place, split, quick=quick, workers=count, on_progress=update)


def _require_intact(sink: Sink, result: TouchVerification, name: str) -> None:
    """Name all damage on stderr; IntegrityError where there is any."""
    for finding in result.findings:
        sink.warn(f"damaged: {finding}")
    if not result.ok:
        raise IntegrityError(
            f"{counted(len(result.findings), 'problems')} in {name!r}",
            next="download or convert it again",
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


_FRAME = choice(
    "contact_end",
    ("contact_end", "contact_start", "peak", "best"),
    help="Frame of a clip: last or first of the contact, of the deepest press, or with the best score of "
    "contact.",
)


@dataclass(frozen=True, slots=True)
class ClipsToImages:
    """Make a data set of single images from one of clips: a frame of each clip, with its pose.

    Example: realtouch clips-to-images real-seq --frame peak --out touches
    """

    frame: str = _FRAME


@dataclass(frozen=True, slots=True)
class Resize:
    """Write the same data set with images or clips of another size.

    Example: realtouch resize real-single-320x240 --size 64x64 --out small
    """

    size: tuple[int, int] = size_option(MISSING)
    quality: int = integer(95, 1, 100, help="JPEG quality of images that are encoded again, 1 to 100.")


@dataclass(frozen=True, slots=True)
class Frames:
    """Write touches as plain image files with an index in CSV and Parquet.

    Example: realtouch frames real-single-64x64 --format jpeg --out pictures

    Example: realtouch frames real-seq --frame best --difference grey --out changes
    """

    kind: str = choice(
        "png",
        ("png", "jpeg"),
        name="--format",
        help="png: exact pixels; jpeg: the stored JPEGs, unchanged.",
    )
    frame: str = _FRAME
    difference: str | None = choice(
        None,
        ("grey", "absolute"),
        optional=True,
        help="Write the difference from the median of the clip or round: grey (128 means no change) or "
        "absolute.",
    )


@dataclass(frozen=True, slots=True)
class Select:
    """Write selected rounds and touches of a data set; images are copied byte for byte.

    Example: realtouch select real-single-64x64 --contact --labels 3,5 --out touched
    """

    contact: bool = switch(False, help="Only touches in contact with an object.")
    min_height_mm: float | None = contact_height_option()
    recalibrate_z: bool = switch(
        True,
        name="--recalibrate/--as-recorded",
        help="Take the deepest touch of each round as the height of the plate, if that is not known.",
    )
    ids: tuple[Any, ...] | None = catalog.IDS
    labels: tuple[str, ...] | None = catalog.LABELS
    per_class: int | None = catalog.PER_CLASS


@dataclass(frozen=True, slots=True)
class Export:
    """Write touches for other libraries; stored JPEGs are copied, never encoded again.

    Example: realtouch export real-single-64x64 --split train --format flat --out flat

    Example: realtouch export real-seq --split train --format lerobot --out robots
    """

    layout: str = choice(
        MISSING,
        ("flat", "webdataset", "lerobot", "replay", "fota", "sparsh", "anytouch"),
        name="--format",
        help="flat: Parquet, a row for each touch; webdataset: tars; lerobot: LeRobotDataset v3.0 of one "
        "split; replay: Zarr of Diffusion Policy, likewise; fota: tars of T3; sparsh: pickled images; "
        "anytouch: list files.",
    )
    frame: str = _FRAME


def _add(
    name: str, options_of: type, function: Callable[..., store.Manifest], nouns: str = KIND.nouns
) -> None:
    """Add a command: print what will be fetched, convert with progress, print what was made.

    ``options_of`` declares its options, named as the parameters of its function; the docstring is the help.
    """

    def convert(
        *,
        source: str = TOUCH_SET,
        opening: Opening,
        out: str = out_folder(),
        options: Any,
        split: str | None = catalog.SPLIT,
        limit: int | None = catalog.LIMIT,
        work: Work,
        sink: Sink,
    ) -> None:
        opened = opening.open(sink, source).require(KIND, name)
        make = partial(function, opened, out, **_arguments(options), split=split, limit=limit)
        announce_fetching(sink, opened, split)
        kind = replace(KIND, nouns=nouns)
        make_with_progress(sink, "converting", kind, make, work, out, print_set, KIND.nouns)

    convert.__doc__ = options_of.__doc__
    convert.__annotations__["options"] = options_of
    command(app, name)(convert)


def _arguments(options: Any) -> dict[str, Any]:
    """Return what a function takes; InputError for options that would have no effect."""
    found = {each.name: getattr(options, each.name) for each in fields(options)}
    if isinstance(options, Resize):
        found["width"], found["height"] = found.pop("size")
    if isinstance(options, Select):
        height_mm = found.pop("min_height_mm")
        # Those of the objects, which are numbers.
        ids = [catalog.id_range(each) if isinstance(each, str) else each for each in found.pop("ids") or ()]
        found["objects"], found["labels"] = ids, found["labels"] or ()
        if not options.contact and (height_mm is not None or not options.recalibrate_z):
            raise InputError("--min-height-mm and --as-recorded are about --contact", next="add --contact")
        found["min_height_m"] = None if height_mm is None else height_mm / 1000
    return found


def announce_fetching(sink: Sink, place: places.Place, split: str | None) -> None:
    """Print what of a data set on the Hub is about to be fetched: a published one may have many gigabytes."""
    if place.repository is None:
        return
    part = f"the files of split {split!r}" if split else "the files of all splits (--split takes one)"
    sink.info(f"{place.repository.repo_id}: fetching from the Hub what is not here yet of {part}")


def import_touches(
    *,
    source: str = argument("DIR", "Folder of images and a CSV table, or of tars."),
    file_format: Literal["folder", "webdataset", "replay", "fota", "sparsh", "anytouch"] = choice(
        MISSING,
        ("folder", "webdataset", "replay", "fota", "sparsh", "anytouch"),
        name="--format",
        help="Layout of the images.",
    ),
    out: str = out_folder(),
    columns: ImportColumns,
    table: str | None = text(metavar="FILE", help="Path of the table; by default the only CSV file in DIR."),
    classes: list[str] | None = text(
        metavar="A,B", read=listed, help="Names of the classes, in order; by default those found."
    ),
    split_name: str | None = text(
        name="--split",
        metavar="NAME",
        help="Split, if no column names it; by default that of tars called SPLIT-000000.tar, or train.",
    ),
    work: Work,
    sink: Sink,
) -> None:
    """Make a data set of touches from images and a table of labels and poses; images are not changed.

    Images that cannot be used are left out and listed with the reason. Columns that this program writes are
    found by their names.

    Example: realtouch import pictures --format folder --image-column file --label-column digit --out touches
    """
    from realtouch.exchange.importing import import_images

    make = partial(
        import_images, source, out, file_format, columns, table=table, classes=classes or (), split=split_name
    )
    kind = replace(KIND, nouns="touches")
    make_with_progress(sink, "importing", kind, make, work, out, _print_imported)


def _print_imported(
    sink: Sink, kind: DatasetKind, manifest: store.Manifest, out: str, _elapsed_s: float | None
) -> None:
    from realtouch.exchange.import_shards import NOT_IMPORTED
    from realtouch.exchange.importing import CONVERSION

    options = manifest.spec["options"]
    if CONVERSION in options:
        sink.info(f"the images were converted without loss: {options[CONVERSION]}")
    if not options["classes"]:
        sink.info("no classes are known (--label-column names their column): the label of all is -1")
    print_left_out(sink, manifest)
    fields = store.add_up(list(manifest.statistics().values())).get(NOT_IMPORTED, {})
    if fields:
        counts = ", ".join(f"{name} ({count:,})" for name, count in fields.items())
        sink.info(f"fields that were not imported, and of how many touches: {counts}")
    print_set(sink, kind, manifest, out)


_add("clips-to-images", ClipsToImages, lazy("realtouch.convert.media_conversions:clips_to_images"))
_add("resize", Resize, lazy("realtouch.convert.media_conversions:resize"))
_add("frames", Frames, lazy("realtouch.convert.picture_files:frames"), nouns="touches")
_add("select", Select, lazy("realtouch.convert.selection:select"))
# A row is a touch, or an episode of LeRobot.
_add("export", Export, lazy("realtouch.exchange.exporting:export"), nouns="rows")
command(app, "import")(import_touches)
_own: dict[str, Any] = {"preview": preview_touches, "gallery": gallery_of_touches}
add_shared(app, KIND, {**_own, "info": None, "verify": None, "validate": None, "export": None})

main = partial(run, app)
