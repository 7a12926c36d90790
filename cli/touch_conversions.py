"""``realtouch to-single | resize | frames | select | export``: a data set of touches becomes another one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cli.application import command
from cli.making import make_with_progress
from cli.options import (
    Limit,
    MinHeight,
    Out,
    Split,
    TouchSet,
    Work,
    is_count,
    parse_size,
    place_of_data,
)
from cli.output import Sink
from cli.touch_tables import announce_fetching, print_converted
from realtouch.kind import KIND

if TYPE_CHECKING:
    from realtouch.exchange.items import ImportColumns
    from tactile_toolkit.store.manifest import Manifest

__all__ = ["add_conversions"]

_SKIPPED_SHOWN = 20


DifferenceName = Literal["grey", "absolute"]
"""Ways to show what differs from the background."""

FrameName = Literal["contact_end", "contact_start", "peak", "median", "best"]
"""Ways to choose the frame of a clip that shows the contact."""

LayoutName = Literal["flat", "webdataset", "lerobot", "replay", "fota", "sparsh", "anytouch"]
"""Formats of other libraries."""

ImportLayout = Literal["folder", "webdataset", "fota", "sparsh", "anytouch"]
"""Formats of others that become touches."""

Target = Annotated[str, typer.Argument(metavar="OUT", help="Folder to write.", parser=place_of_data)]
Frame = Annotated[
    FrameName,
    typer.Option(
        "--frame",
        help="Frame of a clip: last or first of contact, of the deepest press, most unlike the median, or "
        "that of the best contact score.",
    ),
]


@dataclass(frozen=True, slots=True)
class Converting(Work):
    """Options of all conversions."""

    split: Split = None
    limit: Limit = None

    def run(
        self,
        sink: Sink,
        convert: Callable[..., Manifest],
        source: str,
        out: str,
        *values: Any,
        nouns: str = KIND.nouns,
        **options: Any,
    ) -> None:
        """Say what will be fetched, convert with a progress bar, and say how many ``nouns`` were made."""
        announce_fetching(sink, source, self.split)
        make = partial(convert, source, out, *values, **options, split=self.split, limit=self.limit)
        made = make_with_progress(sink, "converting", nouns, make, self, out, unit=KIND.nouns)
        if made is not None:
            print_converted(sink, made.manifest, out)


def _column(words: str) -> Any:
    return typer.Option(metavar="NAME", help=words)


@dataclass(frozen=True, slots=True)
class Columns:
    """Options that name columns; those of our own exports are found without."""

    image_column: Annotated[str, _column("Column of the images' paths; of tars, their ending.")] = "file"
    label_column: Annotated[
        str | None, _column("Column of the classes, numbers or names: label_name or label by default.")
    ] = None
    round_column: Annotated[str | None, _column("Column of what touches belong together by.")] = None
    object_column: Annotated[str | None, _column("Column of the number of the object.")] = None
    position_columns: Annotated[
        str | None, typer.Option(metavar="X,Y", help="Columns of the intended position, m, cell frame.")
    ] = None
    pose_columns: Annotated[
        str | None,
        typer.Option(metavar="X,Y,Z,QX,QY,QZ,QW", help="Columns of the gel's pose, m, cell frame; or one."),
    ] = None
    split_column: Annotated[str | None, _column("Column of the split.")] = None

    def chosen(self) -> ImportColumns:
        """Return what functions take."""
        from realtouch.exchange.items import ImportColumns

        return ImportColumns(
            self.image_column,
            self.label_column,
            self.round_column,
            self.object_column,
            None if self.position_columns is None else tuple(_listed(self.position_columns)),
            None if self.pose_columns is None else tuple(_listed(self.pose_columns)),
            self.split_column,
        )


def add_conversions(app: typer.Typer) -> None:
    """Add the commands to a command line."""
    command(app, "to-single")(to_single)
    for each in (resize, frames, select, export):
        command(app)(each)
    command(app, "import")(import_touches)


def to_single(
    *,
    source: TouchSet,
    out: Target,
    frame: Frame = "contact_end",
    converting: Converting,
    sink: Sink,
) -> None:
    """Make a data set of single images of one of clips: a frame of each, with the pose at that moment.

    Example: realtouch to-single real-seq touches --frame peak
    """
    from realtouch.convert.api import to_single as convert

    converting.run(sink, convert, source, out, frame)


def resize(
    *,
    source: TouchSet,
    out: Target,
    size: Annotated[str, typer.Option("--size", metavar="WIDTHxHEIGHT", help="Size wanted, pixels.")],
    quality: Annotated[int, typer.Option(min=1, max=100, help="JPEG quality of what is encoded again.")] = 95,
    converting: Converting,
    sink: Sink,
) -> None:
    """Write the same data set with pictures or clips of another size.

    Example: realtouch resize real-single-320x240 small --size 64x64
    """
    from realtouch.convert.api import resize as convert

    converting.run(sink, convert, source, out, *parse_size(size), quality=quality)


def frames(
    *,
    source: TouchSet,
    out: Target,
    png: Annotated[bool, typer.Option("--png", help="Write PNG (the default); pixels stay exact.")] = False,
    jpeg: Annotated[bool, typer.Option("--jpeg", help="Write the stored JPEGs as they are.")] = False,
    frame: Frame = "contact_end",
    difference: Annotated[
        DifferenceName | None,
        typer.Option(
            help="Write what differs from the median of clip or round: grey (128: no change) or absolute."
        ),
    ] = None,
    converting: Converting,
    sink: Sink,
) -> None:
    """Write touches as plain image files with an index in CSV and Parquet.

    Example: realtouch frames real-single-64x64 pictures --jpeg

    Example: realtouch frames real-seq changes --frame best --difference grey
    """
    from realtouch.convert.api import frames as convert
    from tactile_toolkit.errors import InputError

    # PNG is the default; --png says so in scripts, and must not meet its contrary.
    if png and jpeg:
        message = "--png and --jpeg were both given; expected one of them"
        raise InputError(message)
    kind: Literal["png", "jpeg"] = "jpeg" if jpeg else "png"
    converting.run(sink, convert, source, out, kind, frame, difference=difference)


def select(
    *,
    source: TouchSet,
    out: Target,
    contact: Annotated[bool, typer.Option("--contact", help="Only touches that met an object.")] = False,
    min_height_mm: MinHeight = None,
    recalibrate: Annotated[
        bool,
        typer.Option(
            "--recalibrate/--as-recorded",
            help="Take each round's deepest touch as the plate, where its height is not known.",
        ),
    ] = True,
    labels: Annotated[str | None, typer.Option(metavar="3,5", help="Only these classes.")] = None,
    objects: Annotated[str | None, typer.Option(metavar="ID,ID", help="Only these objects.")] = None,
    converting: Converting,
    sink: Sink,
) -> None:
    """Write some rounds and touches of a data set; pictures pass through byte for byte.

    Example: realtouch select real-single-64x64 touched --contact --labels 3,5
    """
    from realtouch.convert.api import select as convert
    from tactile_toolkit.errors import InputError

    if not contact and (min_height_mm is not None or not recalibrate):
        message = "--min-height-mm and --as-recorded are about --contact; next: add --contact"
        raise InputError(message)
    converting.run(
        sink,
        convert,
        source,
        out,
        contact=contact,
        min_height_m=None if min_height_mm is None else min_height_mm / 1000,
        recalibrate_z=recalibrate,
        labels=_listed(labels),
        objects=[_object_id(text) for text in _listed(objects)],
    )


def export(
    *,
    source: TouchSet,
    layout: Annotated[
        LayoutName,
        typer.Option(
            help="flat: Parquet, a row for each touch; webdataset: tars; lerobot: LeRobotDataset v3.0 of one "
            "split; replay: Zarr of Diffusion Policy, likewise; fota: tars of T3; sparsh: pickled images; "
            "anytouch: list files."
        ),
    ],
    out: Out,
    frame: Frame = "contact_end",
    converting: Converting,
    sink: Sink,
) -> None:
    """Write touches for other libraries; stored JPEGs are copied, never encoded again.

    Example: realtouch export real-single-64x64 --split train --layout flat --out flat

    Example: realtouch export real-seq --split train --layout lerobot --out robots
    """
    from realtouch.exchange.api import export as convert

    # A row is a touch, or an episode of LeRobot.
    converting.run(sink, convert, source, out, layout, nouns="rows", frame=frame)


def import_touches(
    *,
    source: Annotated[
        str, typer.Argument(metavar="DIR", help="Folder of images and a CSV table, or of tars.")
    ],
    layout: Annotated[ImportLayout, typer.Option(help="How the images lie.")],
    out: Out,
    columns: Columns,
    table: Annotated[
        str | None, typer.Option(metavar="FILE", help="The table; the only CSV file there by default.")
    ] = None,
    classes: Annotated[
        str | None, typer.Option(metavar="A,B", help="Names of the classes in order; those found by default.")
    ] = None,
    split: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Split, where no column states it; else the one of tars called SPLIT-000000.tar, or train.",
        ),
    ] = None,
    work: Work,
    sink: Sink,
) -> None:
    """Make a data set of touches of images and a table of labels and poses; images stay as they are.

    What cannot be used is left out, and named with the reason. Columns that this program writes are found by
    their names.

    Example: realtouch import pictures --layout folder --image-column file --label-column digit --out touches
    """
    from realtouch.exchange.importing import NOT_IMPORTED, import_images
    from tactile_toolkit.store.shards import add_up

    make = partial(
        import_images,
        source,
        out,
        layout,
        columns.chosen(),
        table=table,
        classes=_listed(classes),
        split=split,
    )
    made = make_with_progress(sink, "importing", KIND.nouns, make, work, out, unit="touches")
    if made is None:
        return
    skipped = [item for record in made.manifest.shards for item in record.skipped]
    for item in skipped[:_SKIPPED_SHOWN]:
        sink.talk(f"left out: {item.message} ({item.reason})")
    fields = add_up(list(made.manifest.statistics().values())).get(NOT_IMPORTED, {})
    if fields:
        listed = ", ".join(f"{name} ({count:,})" for name, count in fields.items())
        sink.talk(f"fields that were not imported, and of how many touches: {listed}")
    print_converted(sink, made.manifest, out, "touches")


def _listed(text: str | None) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()] if text else []


def _object_id(text: str) -> int:
    from tactile_toolkit.errors import InputError

    if not is_count(text):
        message = f"--objects has {text!r}; expected whole numbers, such as 12,408"
        raise InputError(message)
    return int(text)
