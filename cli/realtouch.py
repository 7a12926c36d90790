"""``realtouch``: look into, check and convert data sets of real touches."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from cli.application import new_app, run
from cli.card_commands import add_card
from cli.failures import reports_errors
from cli.gallery_commands import add_touch_gallery
from cli.hub_download import add_download
from cli.hub_upload import add_upload
from cli.making import make_with_progress
from cli.options import Json, Limit, Overwrite, Quiet, Workers
from cli.output import Sink
from cli.rooms import Room
from cli.touch_preview import add_preview
from cli.touch_tables import print_made, print_summary, raise_findings
from cli.unfinished import print_unfinished

if TYPE_CHECKING:
    from dataset_store.build import Progress
    from dataset_store.manifest import Manifest
    from realtouch.checks import TouchVerification

__all__ = ["app", "main"]

app = new_app("realtouch", "Real touches: load, check, filter and convert the recordings of a GelSight Mini.")


class FrameName(StrEnum):
    """Ways to choose the frame of a clip that shows the contact."""

    contact_end = "contact_end"
    contact_start = "contact_start"
    peak = "peak"
    median = "median"


Name = Annotated[
    str, typer.Argument(metavar="NAME|DIR", help="Short name (real-single-64x64), Hub id, folder or file.")
]
Target = Annotated[Path, typer.Argument(metavar="OUT", help="Folder to write.")]
Split = Annotated[str | None, typer.Option("--split", metavar="NAME", help="Only this split.")]
Revision = Annotated[
    str | None, typer.Option("--revision", metavar="REV", help="Branch, tag or commit of a Hub data set.")
]
Frame = Annotated[
    FrameName,
    typer.Option(
        "--frame",
        help="Frame of a clip: last or first of contact, of the deepest press, or most unlike the median.",
    ),
]


@app.command()
@reports_errors
def load(
    name: Name,
    split: Annotated[str, typer.Option("--split", metavar="NAME", help="Split to open.")] = "train",
    revision: Revision = None,
    check: Annotated[bool, typer.Option(help="Check every round and the headers of its pictures.")] = True,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Download what is missing, check it, and print what it holds.

    Example: realtouch load real-single-64x64 --split test
    """
    from realtouch.opening import load as open_set
    from realtouch.summary import summarise

    sink = Sink(as_json, quiet)
    dataset = open_set(name, split, revision=revision)
    if check:
        raise_findings(_verified(sink, name, split, revision, quick=True), name)
    summary = summarise(dataset)
    sink.document({"name": name, "split": split, "checked": check, **summary.to_dict()})
    print_summary(sink, split, summary)
    sink.line(f"next in Python: realtouch.load({name!r}, {split!r}).touches()")


@app.command()
@reports_errors
def info(name: Name, revision: Revision = None, as_json: Json = False) -> None:
    """Show what each split of a data set holds and, for one of ours, how it was made.

    Example: realtouch info touches-64x64
    """
    from dataset_store.parts import manifest_so_far
    from dataset_store.storage import DataFolder
    from realtouch.conversion import Source
    from realtouch.opening import dataset_of
    from realtouch.summary import summarise

    sink = Sink(as_json)
    manifest = manifest_so_far(DataFolder(name)) if Path(name).is_dir() else None
    if manifest is not None and not manifest.complete:
        sink.document({"name": name, "complete": False, "splits": manifest.split_table()})
        print_unfinished(sink, manifest, Path(name), "rounds", f"realtouch {manifest.spec['operation']}")
        return
    if manifest is not None and manifest.spec.get("operation") == "frames":
        print_made(sink, manifest, Path(name))
        return
    source = Source.open(name, revision)
    summaries = {split: summarise(dataset_of(shards, source.kind)) for split, shards in source.shards.items()}
    sink.document(
        {
            "name": name,
            "splits": {split: summary.to_dict() for split, summary in summaries.items()},
            "spec": manifest.spec if manifest else None,
        }
    )
    for split, summary in summaries.items():
        print_summary(sink, split, summary)
    if manifest is not None:
        options = ", ".join(f"{key} {value}" for key, value in manifest.spec.get("options", {}).items())
        sink.line(
            f"made by tactile-toolkit {manifest.toolkit_version}: {manifest.spec['operation']}, {options}"
        )


@app.command()
@reports_errors
def verify(
    name: Name,
    split: Split = None,
    revision: Revision = None,
    quick: Annotated[bool, typer.Option("--quick", help="Read headers of pictures; decode none.")] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Check every file, round, touch and frame, and list all that is wrong.

    Exit code 3 when something is damaged.

    Example: realtouch verify real-single-64x64 --split test
    """
    sink = Sink(as_json, quiet)
    result = _verified(sink, name, split, revision, quick=quick)
    findings = [
        {"file": f.file, "row": f.row, "touch": f.touch, "field": f.field, "problem": f.problem}
        for f in result.findings
    ]
    sink.document({"ok": result.ok, "rounds": result.rounds, "touches": result.touches, "findings": findings})
    raise_findings(result, name)
    how = "every header was read" if quick else "every picture was decoded"
    sink.line(f"{name}: {result.rounds:,} rounds, {result.touches:,} touches: nothing is wrong; {how}")


@app.command("to-single")
@reports_errors
def to_single(
    source: Name,
    out: Target,
    frame: Frame = FrameName.contact_end,
    limit: Limit = None,
    workers: Workers = 0,
    overwrite: Overwrite = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make a data set of single images of one of clips: a frame of each, with the pose at that moment.

    Example: realtouch to-single real-seq touches --frame peak
    """
    from realtouch.convert import to_single as convert

    def make(report: Callable[[Progress], None]) -> Manifest:
        return convert(
            source,
            str(out),
            frame.value,
            limit=limit,
            workers=workers or os.cpu_count() or 1,
            overwrite=overwrite,
            on_progress=report,
        )

    _run(Sink(as_json, quiet), make, out)


@app.command()
@reports_errors
def resize(
    source: Name,
    out: Target,
    size: Annotated[str, typer.Option("--size", metavar="WIDTHxHEIGHT", help="Size wanted, pixels.")],
    quality: Annotated[int, typer.Option(min=1, max=100, help="JPEG quality of what is encoded again.")] = 95,
    limit: Limit = None,
    workers: Workers = 0,
    overwrite: Overwrite = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write the same data set with pictures or clips of another size.

    Example: realtouch resize real-single-320x240 small --size 64x64
    """
    from realtouch.convert import resize as convert

    width, height = _size(size)

    def make(report: Callable[[Progress], None]) -> Manifest:
        return convert(
            source,
            str(out),
            width,
            height,
            quality=quality,
            limit=limit,
            workers=workers or os.cpu_count() or 1,
            overwrite=overwrite,
            on_progress=report,
        )

    _run(Sink(as_json, quiet), make, out)


@app.command()
@reports_errors
def frames(
    source: Name,
    out: Target,
    png: Annotated[bool, typer.Option("--png", help="Write PNG (the default); pixels stay exact.")] = False,
    jpeg: Annotated[bool, typer.Option("--jpeg", help="Write the stored JPEGs as they are.")] = False,
    frame: Frame = FrameName.contact_end,
    limit: Limit = None,
    workers: Workers = 0,
    overwrite: Overwrite = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write touches as plain image files with an index in CSV and Parquet.

    Example: realtouch frames real-single-64x64 pictures --jpeg
    """
    from dataset_store.errors import InputError
    from realtouch.convert import frames as convert

    if png and jpeg:
        message = "--png and --jpeg were both given; expected one of them"
        raise InputError(message)
    kind: Literal["png", "jpeg"] = "jpeg" if jpeg else "png"

    def make(report: Callable[[Progress], None]) -> Manifest:
        return convert(
            source,
            str(out),
            kind,
            frame.value,
            limit=limit,
            workers=workers or os.cpu_count() or 1,
            overwrite=overwrite,
            on_progress=report,
        )

    _run(Sink(as_json, quiet), make, out)


@app.command()
@reports_errors
def select(
    source: Name,
    out: Target,
    contact: Annotated[bool, typer.Option("--contact", help="Only touches that met an object.")] = False,
    min_height_mm: Annotated[
        float, typer.Option(metavar="MM", help="Height above the plate from which a touch counts.")
    ] = 6.0,
    recalibrate: Annotated[
        bool,
        typer.Option("--recalibrate/--as-recorded", help="Take each round's deepest touch as the plate."),
    ] = True,
    labels: Annotated[str | None, typer.Option(metavar="3,5", help="Only these classes.")] = None,
    objects: Annotated[str | None, typer.Option(metavar="ID,ID", help="Only these objects.")] = None,
    limit: Limit = None,
    workers: Workers = 0,
    overwrite: Overwrite = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write some rounds and touches of a data set; pictures pass through byte for byte.

    Example: realtouch select real-single-64x64 touched --contact --labels 3,5
    """
    from realtouch.convert import select as convert

    def make(report: Callable[[Progress], None]) -> Manifest:
        return convert(
            source,
            str(out),
            contact=contact,
            min_height_m=min_height_mm / 1000,
            recalibrate_z=recalibrate,
            labels=_listed(labels),
            objects=[_whole(text) for text in _listed(objects)],
            limit=limit,
            workers=workers or os.cpu_count() or 1,
            overwrite=overwrite,
            on_progress=report,
        )

    _run(Sink(as_json, quiet), make, out)


add_preview(app)
add_card(app, Room("realtouch"))
add_upload(app, Room("realtouch"))
add_download(app, Room("realtouch"))
add_touch_gallery(app)


def main() -> None:
    """Run the command line."""
    run(app)


def _run(sink: Sink, make: Callable[[Callable[[Progress], None]], Manifest], out: Path) -> None:
    """Run a conversion with a progress bar and say what it made."""
    print_made(sink, make_with_progress(sink, "converting", "rounds", make).manifest, out)


def _verified(
    sink: Sink, name: str, split: str | None, revision: str | None, *, quick: bool
) -> TouchVerification:
    from realtouch.checks import verify as check

    with sink.progress("checking", "rounds") as update:
        return check(name, split, revision=revision, quick=quick, on_progress=update)


def _size(text: str) -> tuple[int, int]:
    """Parse ``64x64``."""
    from dataset_store.errors import InputError

    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text.strip().lower())
    if match is None:
        message = f"--size is {text!r}; expected WIDTHxHEIGHT in pixels, such as 64x64"
        raise InputError(message)
    return int(match[1]), int(match[2])


def _listed(text: str | None) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()] if text else []


def _whole(text: str) -> int:
    from dataset_store.errors import InputError

    if not text.isdigit():
        message = f"--objects has {text!r}; expected whole numbers, such as 12,408"
        raise InputError(message)
    return int(text)
