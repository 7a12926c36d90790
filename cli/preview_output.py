"""Writing pictures as all command lines do it: plan, say what is left out, draw, list what was written."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.options import local_place
from cli.output import Sink, bytes_text

if TYPE_CHECKING:
    from tactile_toolkit.pictures.writing import PicturePlan

__all__ = ["PREVIEW_FOLDER", "PictureDryRun", "PictureOut", "write_previews"]

PREVIEW_FOLDER = Path("previews")

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


def write_previews(sink: Sink, plan: PicturePlan, out: Path, dry_run: bool) -> None:
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
    for note in dict.fromkeys(note for made in written for note in made.notes):
        sink.talk(f"note: {note}")
    entries = [made.to_dict() for made in written]
    sink.document({"folder": str(folder), "pictures": entries, "left_out": list(plan.left_out)})
    for made in written:
        size = f"{made.width:,} x {made.height:,} pixels, {bytes_text(made.bytes)}"
        sink.line(f"{folder / made.name}: {made.what} ({size})")
