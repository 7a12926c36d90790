"""``starstruck preview``."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from cli.failures import reports_errors
from cli.options import Json, Quiet, Split
from cli.output import Sink
from cli.preview_output import PREVIEW_FOLDER, PictureDryRun, PictureOut, write_previews

__all__ = ["add_preview"]


class PictureKind(StrEnum):
    """Pictures of scenes."""

    sheet = "sheet"
    scene = "scene"
    histogram = "histogram"
    all = "all"


def add_preview(app: typer.Typer) -> None:
    """Add the command to a command line."""
    app.command()(preview)


@reports_errors
def preview(
    path: Annotated[
        str, typer.Argument(metavar="DIR|FILE", help="Data set folder, or Parquet file of scenes.")
    ],
    kind: Annotated[
        list[PictureKind] | None,
        typer.Option("--kind", help="What to draw; may be repeated. By default sheet and histogram."),
    ] = None,
    split: Split = None,
    ids: Annotated[
        str | None, typer.Option("--ids", metavar="ID,ID", help="These scenes; draws each one by default.")
    ] = None,
    per_class: Annotated[int, typer.Option(min=1, metavar="N", help="Scenes of each class on a sheet.")] = 8,
    out: PictureOut = PREVIEW_FOLDER,
    dry_run: PictureDryRun = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write pictures of scenes as PNG, without a screen: sheets, single scenes, class counts.

    Examples: starstruck preview scenes;  starstruck preview scenes --ids 17 --out scene.png

    A single scene shows the positions that were rejected while it was made, and an oblique view. Plots and
    smooth oblique views need the extra `pictures`.
    """
    from starstruck_gen.previews import PreviewSpec, plan_previews
    from tactile_toolkit.pictures.writing import whole_numbers

    kinds = tuple(each.value for each in kind or ())
    spec = PreviewSpec(kinds, split, whole_numbers("--ids", ids), per_class)
    write_previews(Sink(as_json, quiet), plan_previews(path, spec), out, dry_run)
