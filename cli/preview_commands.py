"""``mnist3d preview``, ``starstruck preview`` and ``realtouch preview``: pictures as PNG files."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.options import OneSplit, Revision, Split, TouchSet, local_place
from cli.output import Sink, bytes_text

if TYPE_CHECKING:
    from tactile_toolkit.pictures.writing import PicturePlan

__all__ = ["preview_digits", "preview_scenes", "preview_touches"]

_FOLDER = Path("previews")

PictureOut = Annotated[
    Path,
    typer.Option(
        "--out",
        "-o",
        metavar="DIR|FILE.png",
        help="Folder to write, or the file of a single picture; pictures of the same name are replaced.",
        parser=local_place,
    ),
]

PictureDryRun = Annotated[
    bool, typer.Option("--dry-run", help="Say which pictures would be drawn; write nothing.")
]


# Typer takes lists of enumerations, but not of literals, which all other choices are.
class DigitPicture(StrEnum):
    """Pictures of digits."""

    sheet = "sheet"
    object = "object"
    steps = "steps"
    histogram = "histogram"
    distributions = "distributions"
    all = "all"


def preview_digits(
    *,
    path: Annotated[
        str,
        typer.Argument(
            metavar="DIR|FILE",
            help="Data set folder, Parquet file, STL/3MF/PLY/OBJ/GLB file, or a picture of a digit.",
        ),
    ],
    kind: Annotated[
        list[DigitPicture] | None,
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
    out: PictureOut = _FOLDER,
    dry_run: PictureDryRun = False,
    sink: Sink,
) -> None:
    """Write pictures of digits as PNG, without a screen: sheets, single objects, steps, plots.

    Examples: mnist3d preview digits;  mnist3d preview digits --ids 17,408;  mnist3d preview part.stl

    Plots need the extra `pictures`.
    """
    from mnist3d.previews import DigitPreviewSpec, plan_previews
    from tactile_toolkit.pictures.writing import parse_ids

    kinds = tuple(each.value for each in kind or ())
    spec = DigitPreviewSpec(kinds, split, parse_ids("--ids", ids), per_class, images, writer_info)
    _write(sink, plan_previews(path, spec), out, dry_run)


class ScenePicture(StrEnum):
    """Pictures of scenes."""

    sheet = "sheet"
    scene = "scene"
    histogram = "histogram"
    all = "all"


def preview_scenes(
    *,
    path: Annotated[
        str, typer.Argument(metavar="DIR|FILE", help="Data set folder, or Parquet file of scenes.")
    ],
    kind: Annotated[
        list[ScenePicture] | None,
        typer.Option("--kind", help="What to draw; may be repeated. By default sheet and histogram."),
    ] = None,
    split: Split = None,
    ids: Annotated[
        str | None, typer.Option("--ids", metavar="ID,ID", help="These scenes; draws each one by default.")
    ] = None,
    per_class: Annotated[int, typer.Option(min=1, metavar="N", help="Scenes of each class on a sheet.")] = 8,
    out: PictureOut = _FOLDER,
    dry_run: PictureDryRun = False,
    sink: Sink,
) -> None:
    """Write pictures of scenes as PNG, without a screen: sheets, single scenes, class counts.

    Examples: starstruck preview scenes;  starstruck preview scenes --ids 17 --out scene.png

    A single scene shows the positions that were rejected while it was made, and an oblique view. Plots
    need the extra `pictures`.
    """
    from starstruck_gen.previews import plan_previews
    from tactile_toolkit.pictures.previews import PreviewSpec
    from tactile_toolkit.pictures.writing import parse_ids

    kinds = tuple(each.value for each in kind or ())
    spec = PreviewSpec(kinds, split, parse_ids("--ids", ids), per_class)
    _write(sink, plan_previews(path, spec), out, dry_run)


class TouchPicture(StrEnum):
    """Pictures of touches."""

    grid = "grid"
    overlay = "overlay"
    film_strip = "strip"
    all = "all"


def preview_touches(
    *,
    name: TouchSet,
    kind: Annotated[
        list[TouchPicture] | None,
        typer.Option(
            "--kind",
            help="What to draw; may be repeated: a round as a grid (the default) or pasted on a map of the "
            "cell, a clip as a strip.",
        ),
    ] = None,
    split: OneSplit = None,
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
    sink: Sink,
) -> None:
    """Write pictures of touches as PNG, without a screen.

    Examples: realtouch preview real-single-64x64 --round 3 --out round.png;
    realtouch preview real-seq --kind all --touch 12
    """
    from realtouch.show.previews import TouchPreviewSpec, plan_previews

    kinds = tuple(each.value for each in kind or ())
    plan = plan_previews(name, TouchPreviewSpec(kinds, split, row, touches, touch, revision))
    place = out or (_FOLDER if kinds else Path("touches.png"))
    _write(sink, plan, place, dry_run)


def _write(sink: Sink, plan: PicturePlan, out: Path, dry_run: bool) -> None:
    """Draw planned pictures and print where they are, or print only what would be drawn."""
    from tactile_toolkit.pictures.writing import renamed, write_pictures
    from tactile_toolkit.store.folder import DataFolder

    folder, pictures = renamed(plan.pictures, out)
    for reason in plan.left_out:
        sink.talk(f"left out: {reason}")
    if dry_run:
        planned = [{"file": picture.name, "what": picture.what} for picture in pictures]
        sink.document({"folder": str(folder), "pictures": planned, "left_out": list(plan.left_out)})
        for picture in pictures:
            sink.line(f"would write {folder / picture.name}: {picture.what}")
        return
    with sink.progress("drawing", "pictures") as update:
        written = write_pictures(DataFolder(str(folder.absolute())), pictures, update)
    entries = [made.to_dict() for made in written]
    sink.document({"folder": str(folder), "pictures": entries, "left_out": list(plan.left_out)})
    for made in written:
        size = f"{made.width:,} x {made.height:,} pixels, {bytes_text(made.bytes)}"
        sink.line(f"{folder / made.name}: {made.what} ({size})")
