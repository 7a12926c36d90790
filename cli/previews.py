"""Options of all ``preview`` commands, and the command for touches."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path

from cli import options, output
from realtouch.kind import KIND
from realtouch.touch_options import TouchPreviewSpec
from tactile_toolkit import checked_fields, pictures, store, wording
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind


@dataclass(frozen=True, slots=True)
class Pictures:
    """Options for the files of pictures."""

    out: Path | None = checked_fields.text(
        name="--out -o",
        metavar="DIR|FILE.png",
        read=options.local_place,
        shown="previews",
        help="Folder to write, or file of a single picture; existing pictures are replaced.",
    )
    dry_run: bool = options.DRY_RUN

    def write(self, sink: output.Sink, plan: pictures.PicturePlan, usual: str = "previews") -> None:
        """Draw planned pictures and print where they are, or print only what would be drawn."""
        folder = self.out or Path(usual)
        drawn = plan.pictures
        if folder.suffix.lower() == ".png":
            if len(drawn) != 1:
                what = f"--out is the file {str(folder)!r}, but there are {len(drawn)} pictures"
                raise InputError(what, next="give a folder")
            folder, drawn = folder.parent, (replace(drawn[0], name=folder.name),)
        for reason in plan.left_out:
            sink.info(f"left out: {reason}")
        left_out = {"left_out": list(plan.left_out)}
        if self.dry_run:
            planned = [{"file": picture.name, "what": picture.what} for picture in drawn]
            sink.document({"folder": str(folder), "pictures": planned, **left_out})
            for picture in drawn:
                sink.line(f"would write {folder / picture.name}: {picture.what}")
            return
        with sink.progress("drawing", "pictures") as update:
            written = pictures.write_pictures(store.open_folder(str(folder.absolute())), drawn, update)
        sink.document({"folder": str(folder), "pictures": [asdict(made) for made in written], **left_out})
        for made in written:
            size = f"{made.width:,} x {made.height:,} pixels, {wording.bytes_text(made.bytes)}"
            sink.line(f"{folder / made.file}: {made.what} ({size})")


def preview_touches(
    *,
    kind: DatasetKind,
    name: str = options.TOUCH_SET,
    opening: options.Opening,
    spec: TouchPreviewSpec,
    pictures: Pictures,
    sink: output.Sink,
) -> None:
    """Write pictures of touches as PNG, without a screen; a single grid is written to touches.png.

    Examples: realtouch preview real-single-64x64 --round 3 --out round.png;
    realtouch preview real-seq --kind all
    """
    usual = "touches.png"
    if spec.kinds:
        usual = "previews"
    place = opening.open(sink, name).require(kind, "preview")
    pictures.write(sink, KIND.plan_previews(place, spec), usual)
