"""``realtouch preview``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from cli.failures import reports_errors
from cli.options import Json, Quiet, local_place
from cli.output import Sink
from cli.preview_output import PREVIEW_FOLDER, PictureDryRun, write_previews
from cli.touch_options import Revision, TouchSet

__all__ = ["add_preview"]


class PictureKind(StrEnum):
    """Pictures of touches."""

    grid = "grid"
    overlay = "overlay"
    film_strip = "strip"
    drift = "drift"
    all = "all"


def add_preview(app: typer.Typer) -> None:
    """Add the command to a command line."""
    app.command()(preview)


@reports_errors
def preview(
    name: TouchSet,
    kind: Annotated[
        list[PictureKind] | None,
        typer.Option(
            "--kind",
            help="What to draw; may be repeated: a round as a grid (the default) or pasted on a map of the "
            "cell, a clip as a strip, the drift of the gel over all rounds.",
        ),
    ] = None,
    split: Annotated[str, typer.Option("--split", metavar="NAME", help="Split to open.")] = "train",
    row: Annotated[int, typer.Option("--round", min=0, metavar="N", help="Which round.")] = 0,
    touches: Annotated[int, typer.Option(min=1, metavar="N", help="How many touches a grid shows.")] = 32,
    touch: Annotated[int, typer.Option(min=0, metavar="N", help="Which touch a strip shows.")] = 0,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR|FILE.png",
            help="Folder to write, or the file of a single picture; touches.png for the grid alone, else the "
            "folder previews. Pictures of the same name are replaced.",
            parser=local_place,
        ),
    ] = None,
    revision: Revision = None,
    dry_run: PictureDryRun = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write pictures of touches as PNG, without a screen.

    Examples: realtouch preview real-single-64x64 --round 3 --out round.png;
    realtouch preview real-seq --kind all --touch 12

    The drift needs the extra `pictures`.
    """
    from realtouch.show.previews import PreviewSpec, plan_previews

    kinds = tuple(each.value for each in kind or ())
    plan = plan_previews(name, split, PreviewSpec(kinds, row, touches, touch), revision=revision)
    place = out or (PREVIEW_FOLDER if kinds else Path("touches.png"))
    write_previews(Sink(as_json, quiet), plan, place, dry_run)
