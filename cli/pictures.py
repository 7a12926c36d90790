"""Commands that draw data sets: previews and galleries."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from cli import options, output
from realtouch.kind import KIND
from realtouch.touch_options import TouchPreviewSpec
from tactile_toolkit import catalog, checked_fields, gallery, pictures, store, wording
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.wording import with_count


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
            written = replace(plan, pictures=drawn).write(store.open_folder(str(folder.absolute())), update)
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


def _make_page(sink: output.Sink, page: gallery.Gallery, out: Path, job: options.Job) -> None:
    """Make a gallery with progress and print what was made, or only what would be made."""
    nouns = page.nouns[1]
    start_s = time.monotonic()
    try:
        with sink.progress("making the gallery", nouns) as update:
            site = gallery.build_site(
                page,
                str(out),
                options.process_count(job.workers),
                overwrite=job.overwrite,
                dry_run=job.dry_run,
                on_progress=update,
            )
    except KeyboardInterrupt as error:
        # The default message says that finished work is kept; half a gallery is not.
        raise KeyboardInterrupt(f"interrupted; {out} is unchanged") from error
    items = with_count(site.items, nouns)
    content = {"items": site.items, "splits": site.splits}
    sink.table(("split", nouns), list(site.splits.items()))
    if job.dry_run:
        sink.document({"path": site.path, **content})
        verb = "replace the gallery in" if site.is_replaced else "make"
        sink.line(f"would {verb} {out}: {items}; nothing was written")
        return
    sink.document({"page": site.page, "files": site.files, "bytes": site.bytes, **content})
    took = wording.duration_text(time.monotonic() - start_s)
    size = f"{with_count(site.files, 'files')}, {wording.bytes_text(site.bytes)}"
    sink.line(f"made {out} in {took}: {items}, {size}")
    sink.line(f"next: open {site.page} in a browser")


def gallery_of_meshes(
    *,
    kind: DatasetKind,
    name: str = options.ANY_SET,
    opening: options.Opening,
    chosen: catalog.RowFilter,
    out: Path = options.local_out_folder("gallery"),
    job: options.Job,
    sink: output.Sink,
) -> None:
    """Make a page of thumbnails, filters and 3D views that opens without a network or a server.

    Takes about 40 kB per digit, 8 kB per scene; at most 20,000 items and 2 GB.

    Examples: gallery DIR --out site --split test;  gallery DIR --per-class 1
    """
    _make_page(sink, kind.plan_gallery(opening.open(sink, name), chosen), out, job)


def gallery_of_touches(
    *,
    kind: DatasetKind,
    name: str = options.TOUCH_SET,
    opening: options.Opening,
    chosen: catalog.RowFilter,
    touches: int = checked_fields.integer(64, 1, help="Maximum number of touches of a round, evenly spaced."),
    out: Path = options.local_out_folder("gallery"),
    job: options.Job,
    sink: output.Sink,
) -> None:
    """Make a page of rounds: touches as a grid, clips frame by frame; no network or server is needed.

    At most 20,000 rounds and 2 GB.

    Example: realtouch gallery real-single-64x64 --out site --split test
    """
    place = opening.open(sink, name).require(kind, "gallery")
    _make_page(sink, KIND.plan_gallery(place, chosen, touches=touches), out, job)
