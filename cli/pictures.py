"""The commands that draw data sets: previews and galleries."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Annotated

from cli import options, output
from mnist3d.kind import KIND as DIGITS
from tactile_toolkit import catalog, gallery as galleries, mesh, pictures, wording
from tactile_toolkit.checked_fields import choice, integer, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind, lazy
from tactile_toolkit.wording import with_count

_SHEETS = "kinds=|sheet|all"
_is_picture_or_mesh = lazy("mnist3d.digit_previews:is_picture_or_mesh")


@dataclass(frozen=True, slots=True)
class PreviewOptions(catalog.RowFilter):
    """Options of previews of any kind, by the names of the fields of the specifications of the kinds."""

    kinds: tuple[str, ...] = choice(
        (),
        ("sheet", "steps", "grid", "overlay", "all"),
        name="--draw",
        help="What to draw; may be repeated. Meshes: a sheet (the default), or of digits the steps from ink "
        "to mesh. Touches: a round as a grid (the default), or an overlay on a map of the cell.",
    )
    # A single picture shows the first row, or those that --ids names.
    per_class: int | None = catalog.row_option("per_class", needs=_SHEETS)
    limit: int | None = catalog.row_option("limit", needs=_SHEETS)
    round_number: int = integer(
        0, name="--round", panel="Touches", help="Round of touches to draw, counted from 0."
    )
    touches: int = integer(
        32, 1, needs="kinds=|grid|all", panel="Touches", help="Number of touches in a grid."
    )
    images: Path | None = text(
        name="--source-images",
        metavar="PATH",
        read=Path,
        needs="kinds=steps|all",
        panel="Digits",
        help="Images of the source of the digits, as given to `mnist3d generate`.",
    )
    writer_info: Path | None = text(
        name="--source-writers",
        metavar="FILE",
        read=Path,
        needs="kinds=steps|all",
        panel="Digits",
        help="WriterInfo.npy of HWD+.",
    )
    unit: str | None = mesh.UNIT


def preview(
    *,
    name: str = options.argument("NAME|FILE", "Data set, mesh file, or a picture of a digit."),
    source_options: options.AnySourceOptions,
    drawing: Annotated[options.UserOptions, options.OptionsOf(PreviewOptions)],
    out: Path | None = text(
        name="--out -o",
        metavar="DIR|FILE.png",
        read=options.parse_local_path,
        shown="previews, a single grid touches.png",
        help="Folder to write, or file of a single picture.",
    ),
    overwrite: bool = options.OVERWRITE,
    dry_run: bool = options.DRY_RUN,
    sink: output.Sink,
) -> None:
    """Write pictures of a data set as PNG, without a screen.

    Examples: tactile preview digits --ids 17,408;  tactile preview part.stl;
    tactile preview real-single-64x64 --round 3 --out round.png
    """
    usual = "previews"
    if _is_picture_or_mesh(name):
        filters = {option: drawing.get(option) for option in ("per_class", "limit")}
        options.refuse({**asdict(source_options), **filters}, "a single file")
        plan = DIGITS.plan_previews(name, _preview_spec(DIGITS, drawing))
    else:
        data = source_options.open_set(sink, name)
        plan = data.kind.plan_previews(data.place, _preview_spec(data.kind, drawing))
        if data.kind.has_touches and not drawing.get("kinds"):
            usual = "touches.png"
    _write(sink, plan, out or Path(usual), overwrite=overwrite, dry_run=dry_run)


def _preview_spec(kind: DatasetKind, drawing: options.UserOptions) -> object:
    """Return the options of the previews of a kind; InputError for one that it does not have."""
    known = {field.name for field in fields(kind.preview_class)}
    options.refuse({name: True for name in drawing if name not in known}, kind.nouns)
    return kind.preview_class(**drawing)


def _write(
    sink: output.Sink, plan: pictures.PicturePlan, folder: Path, *, overwrite: bool, dry_run: bool
) -> None:
    """Draw planned pictures and print where they are, or print only what would be drawn."""
    drawn = plan.pictures
    if folder.suffix.lower() == ".png":
        if len(drawn) != 1:
            what = f"is the file {str(folder)!r}, but there are {len(drawn)} pictures"
            raise InputError(what, next="give a folder", field="out")
        drawn = (replace(drawn[0], name=folder.name),)
        folder = folder.parent
    for reason in plan.left_out:
        sink.info(f"left out: {reason}")
    left_out = {"left_out": list(plan.left_out)}
    if dry_run:
        documents = [{"file": picture.name, "what": picture.what} for picture in drawn]
        sink.document({"folder": str(folder), "pictures": documents, **left_out})
        for picture in drawn:
            sink.line(f"would write {folder / picture.name}: {picture.what}")
        return
    with sink.progress("drawing", "pictures") as update:
        written = replace(plan, pictures=drawn).write(folder, overwrite=overwrite, on_progress=update)
    sink.document({"folder": str(folder), "pictures": [asdict(made) for made in written], **left_out})
    for made in written:
        size = f"{made.width:,} x {made.height:,} pixels, {wording.bytes_text(made.bytes)}"
        sink.line(f"{folder / made.file}: {made.what} ({size})")


def gallery(
    *,
    name: str = options.NAME,
    source_options: options.AnySourceOptions,
    chosen: catalog.RowFilter,
    touches: int | None = integer(
        None, 1, optional=True, shown="64", help="Maximum number of touches of a round, evenly spaced."
    ),
    out: Path = options.local_out_folder("gallery"),
    job: options.FileJobOptions,
    sink: output.Sink,
) -> None:
    """Make a page of thumbnails, filters and 3D views that opens without a network or a server.

    Touches are shown as a grid, clips frame by frame. Takes about 40 kB per digit, 8 kB per scene; at most
    20,000 items and 2 GB.

    Examples: tactile gallery digits --out site --split test;  tactile gallery digits --per-class 1
    """
    data = source_options.open_set(sink, name)
    further = {"touches": touches} if touches else {}
    if not data.kind.has_touches:
        options.refuse(further, data.kind.nouns)
    page: galleries.Gallery = data.kind.plan_gallery(data.place, chosen, **further)
    start_s = time.monotonic()
    with sink.progress("making the gallery", page.nouns[1]) as update:
        site = page.write(
            str(out),
            options.process_count(job.workers),
            overwrite=job.overwrite,
            dry_run=job.dry_run,
            on_progress=update,
        )
    items = with_count(site.items, page.nouns[1])
    content = {"items": site.items, "splits": site.splits}
    sink.table(("split", page.nouns[1]), list(site.splits.items()))
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
