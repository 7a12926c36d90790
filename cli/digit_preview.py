"""``mnist3d preview``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from cli.failures import reports_errors
from cli.options import Json, Quiet, Split
from cli.output import Sink
from cli.preview_output import PREVIEW_FOLDER, PictureDryRun, PictureOut, write_previews

__all__ = ["add_preview"]


class PictureKind(StrEnum):
    """Pictures of digits."""

    sheet = "sheet"
    object = "object"
    steps = "steps"
    histogram = "histogram"
    distributions = "distributions"
    all = "all"


def add_preview(app: typer.Typer) -> None:
    """Add the command to a command line."""
    app.command()(preview)


@reports_errors
def preview(
    path: Annotated[
        str,
        typer.Argument(
            metavar="DIR|FILE",
            help="Data set folder, Parquet file, STL/3MF/PLY/OBJ/GLB file, or a picture of a digit.",
        ),
    ],
    kind: Annotated[
        list[PictureKind] | None,
        typer.Option(
            "--kind",
            help="What to draw; may be repeated. Of a data set: sheet, histogram and distributions.",
        ),
    ] = None,
    split: Split = None,
    ids: Annotated[
        str | None, typer.Option("--ids", metavar="ID,ID", help="These digits; draws each one by default.")
    ] = None,
    per_class: Annotated[int, typer.Option(min=1, metavar="N", help="Digits of each class on a sheet.")] = 10,
    images: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH", help="Images that the data set was made from, as in generate; for steps."
        ),
    ] = None,
    writer_info: Annotated[
        Path | None, typer.Option(metavar="FILE", help="WriterInfo.npy of HWD+, for the steps.")
    ] = None,
    out: PictureOut = PREVIEW_FOLDER,
    dry_run: PictureDryRun = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write pictures of digits as PNG, without a screen: sheets, single objects, steps, plots.

    Examples: mnist3d preview digits;  mnist3d preview digits --ids 17,408;  mnist3d preview part.stl

    Plots and smooth oblique views need the extra `pictures`.
    """
    from mnist3d.previews import PreviewSpec, plan_previews
    from tactile_toolkit.pictures.writing import whole_numbers

    kinds = tuple(each.value for each in kind or ())
    spec = PreviewSpec(kinds, split, whole_numbers("--ids", ids), per_class, images, writer_info)
    write_previews(Sink(as_json, quiet), plan_previews(path, spec), out, dry_run)
