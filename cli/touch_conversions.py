"""``realtouch to-single | resize | frames | select``: a data set of touches becomes another one."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cli.application import command
from cli.making import make_with_progress, print_part
from cli.options import (
    Json,
    Limit,
    Quiet,
    Split,
    TouchSet,
    Work,
    place_of_data,
)
from cli.output import Sink
from cli.touch_tables import announce_fetching, print_made
from realtouch.kind import KIND

if TYPE_CHECKING:
    from tactile_toolkit.store.manifest import Manifest

__all__ = ["add_conversions"]


class DifferenceName(StrEnum):
    """Ways to show what differs from the background."""

    grey = "grey"
    absolute = "absolute"


class FrameName(StrEnum):
    """Ways to choose the frame of a clip that shows the contact."""

    contact_end = "contact_end"
    contact_start = "contact_start"
    peak = "peak"
    median = "median"
    best = "best"


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
    as_json: Json = False
    quiet: Quiet = False

    def run(
        self, convert: Callable[..., Manifest], source: str, out: str, *values: Any, **options: Any
    ) -> None:
        """Say what will be fetched, convert with a progress bar, and say what was made."""
        sink = Sink(self.as_json, self.quiet)
        announce_fetching(sink, source, self.split)
        made = make_with_progress(
            sink,
            "converting",
            "rounds",
            lambda on_progress: convert(
                source,
                out,
                *values,
                **options,
                split=self.split,
                limit=self.limit,
                workers=self.chosen_runner(),
                overwrite=self.overwrite,
                on_progress=on_progress,
            ),
        )
        if self.part is not None:
            print_part(sink, KIND, made, out, self.part)
            return
        print_made(sink, made.manifest, out)


def add_conversions(app: typer.Typer) -> None:
    """Add the commands to a command line."""
    command(app, "to-single")(to_single)
    for each in (resize, frames, select):
        command(app)(each)


def to_single(
    *,
    source: TouchSet,
    out: Target,
    frame: Frame = FrameName.contact_end,
    converting: Converting,
) -> None:
    """Make a data set of single images of one of clips: a frame of each, with the pose at that moment.

    Example: realtouch to-single real-seq touches --frame peak
    """
    from realtouch.convert.api import to_single as convert

    converting.run(convert, source, out, frame.value)


def resize(
    *,
    source: TouchSet,
    out: Target,
    size: Annotated[str, typer.Option("--size", metavar="WIDTHxHEIGHT", help="Size wanted, pixels.")],
    quality: Annotated[int, typer.Option(min=1, max=100, help="JPEG quality of what is encoded again.")] = 95,
    converting: Converting,
) -> None:
    """Write the same data set with pictures or clips of another size.

    Example: realtouch resize real-single-320x240 small --size 64x64
    """
    from realtouch.convert.api import resize as convert

    converting.run(convert, source, out, *_size(size), quality=quality)


def frames(
    *,
    source: TouchSet,
    out: Target,
    png: Annotated[bool, typer.Option("--png", help="Write PNG (the default); pixels stay exact.")] = False,
    jpeg: Annotated[bool, typer.Option("--jpeg", help="Write the stored JPEGs as they are.")] = False,
    frame: Frame = FrameName.contact_end,
    difference: Annotated[
        DifferenceName | None,
        typer.Option(
            help="Write what differs from the median of clip or round: grey (128: no change) or absolute."
        ),
    ] = None,
    converting: Converting,
) -> None:
    """Write touches as plain image files with an index in CSV and Parquet.

    Example: realtouch frames real-single-64x64 pictures --jpeg

    Example: realtouch frames real-seq changes --frame best --difference grey
    """
    from realtouch.convert.api import frames as convert
    from tactile_toolkit.errors import InputError

    if png and jpeg:
        message = "--png and --jpeg were both given; expected one of them"
        raise InputError(message)
    kind: Literal["png", "jpeg"] = "jpeg" if jpeg else "png"
    form = None if difference is None else difference.value
    converting.run(convert, source, out, kind, frame.value, difference=form)


def select(
    *,
    source: TouchSet,
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
    converting: Converting,
) -> None:
    """Write some rounds and touches of a data set; pictures pass through byte for byte.

    Example: realtouch select real-single-64x64 touched --contact --labels 3,5
    """
    from realtouch.convert.api import select as convert

    converting.run(
        convert,
        source,
        out,
        contact=contact,
        min_height_m=min_height_mm / 1000,
        recalibrate_z=recalibrate,
        labels=_listed(labels),
        objects=[_object_id(text) for text in _listed(objects)],
    )


def _size(text: str) -> tuple[int, int]:
    """Parse ``64x64``."""
    from tactile_toolkit.errors import InputError

    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text.strip().lower())
    if match is None:
        message = f"--size is {text!r}; expected WIDTHxHEIGHT in pixels, such as 64x64"
        raise InputError(message)
    return int(match[1]), int(match[2])


def _listed(text: str | None) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()] if text else []


def _object_id(text: str) -> int:
    from tactile_toolkit.errors import InputError

    if not text.isdecimal():
        message = f"--objects has {text!r}; expected whole numbers, such as 12,408"
        raise InputError(message)
    return int(text)
