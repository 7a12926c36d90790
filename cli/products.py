"""What is made of a data set: pictures, a page, and files for printers, simulators and other libraries."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cli.application import EXIT_FAILED, OptionsOf
from cli.making import make_with_progress, print_set
from cli.options import (
    ANY_SET,
    DRY_RUN,
    JOB,
    TOUCH_SET,
    WORKERS,
    Opening,
    Work,
    local_out_folder,
    local_place,
    process_count,
)
from cli.output import Sink, bytes_text, duration_text
from realtouch.touch_options import TouchPreviewSpec
from tactile_toolkit import catalog, exchange, places, printing, store
from tactile_toolkit.checked_fields import choice, integer, real, switch, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.wording import counted

if TYPE_CHECKING:
    from tactile_toolkit.gallery import Gallery
    from tactile_toolkit.pictures import PicturePlan


@dataclass(frozen=True, slots=True)
class Pictures:
    """Where pictures go."""

    out: Path | None = text(
        name="--out -o",
        metavar="DIR|FILE.png",
        read=local_place,
        shown="previews",
        help="Folder to write, or the file of a single picture; pictures of the same name are replaced.",
    )
    dry_run: bool = DRY_RUN

    def write(self, sink: Sink, plan: PicturePlan, usual: str = "previews") -> None:
        """Draw planned pictures and print where they are, or print only what would be drawn."""
        from tactile_toolkit.pictures import write_pictures

        folder, pictures = self.out or Path(usual), plan.pictures
        if folder.suffix.lower() == ".png":
            if len(pictures) != 1:
                what = f"--out is the file {str(folder)!r} for {len(pictures)} pictures"
                raise InputError(what, next="give a folder")
            folder, pictures = folder.parent, (replace(pictures[0], name=folder.name),)
        for reason in plan.left_out:
            sink.info(f"left out: {reason}")
        left_out = {"left_out": list(plan.left_out)}
        if self.dry_run:
            planned = [{"file": picture.name, "what": picture.what} for picture in pictures]
            sink.document({"folder": str(folder), "pictures": planned, **left_out})
            for picture in pictures:
                sink.line(f"would write {folder / picture.name}: {picture.what}")
            return
        with sink.progress("drawing", "pictures") as update:
            written = write_pictures(store.DataFolder(str(folder.absolute())), pictures, update)
        sink.document({"folder": str(folder), "pictures": [asdict(made) for made in written], **left_out})
        for made in written:
            size = f"{made.width:,} x {made.height:,} pixels, {bytes_text(made.bytes)}"
            sink.line(f"{folder / made.file}: {made.what} ({size})")


def preview_touches(
    *,
    kind: DatasetKind,
    name: str = TOUCH_SET,
    opening: Opening,
    spec: TouchPreviewSpec,
    pictures: Pictures,
    sink: Sink,
) -> None:
    """Write pictures of touches as PNG, without a screen; a grid alone goes to touches.png.

    Examples: realtouch preview real-single-64x64 --round 3 --out round.png;
    realtouch preview real-seq --kind all
    """
    from realtouch.previews import plan_previews

    plan = plan_previews(opening.open(sink, name).require(kind, "preview"), spec)
    pictures.write(sink, plan, "previews" if spec.kinds else "touches.png")


@dataclass(frozen=True, slots=True)
class Job:
    """How files other than those of a data set are made."""

    workers: int = WORKERS
    overwrite: bool = switch(False, panel=JOB, help="Replace files of an earlier run that differ.")
    dry_run: bool = DRY_RUN


def _make_page(sink: Sink, gallery: Gallery, out: Path, job: Job) -> None:
    """Make a gallery with progress and print what was made, or only what would be made."""
    from tactile_toolkit.gallery import PAGE_FILE, build_site, site_folder

    nouns, workers = gallery.nouns[1], process_count(job.workers)
    if job.dry_run:
        path = site_folder(gallery, str(out), overwrite=job.overwrite)
        items, splits = counted(gallery.size, nouns), dict(gallery.splits)
        sink.document({"path": str(path), "items": gallery.size, "splits": splits})
        sink.table(("split", nouns), list(splits.items()))
        verb = "replace the gallery in" if (path / PAGE_FILE).exists() else "make"
        sink.line(f"would {verb} {out}: {items}; nothing was written")
        return
    start_s = time.monotonic()
    try:
        with sink.progress("making the gallery", nouns) as update:
            site = build_site(gallery, str(out), workers, overwrite=job.overwrite, on_progress=update)
    except KeyboardInterrupt as error:
        # The usual words promise that finished work is kept, but half a page would be of no use.
        raise KeyboardInterrupt(f"interrupted; nothing was left behind, {out} is as it was before") from error
    index = str(Path(site.path) / PAGE_FILE)
    made = {"items": site.items, "files": site.files, "bytes": site.bytes, "splits": site.splits}
    sink.document({"page": index, **made})
    sink.table(("split", nouns), list(site.splits.items()))
    took = duration_text(time.monotonic() - start_s)
    items, files = counted(site.items, nouns), counted(site.files, "files")
    sink.line(f"made {out} in {took}: {items}, {files}, {bytes_text(site.bytes)}")
    sink.line(f"next: open {index} in a browser")


def gallery_of_meshes(
    *,
    kind: DatasetKind,
    name: str = ANY_SET,
    opening: Opening,
    chosen: catalog.Chosen,
    out: Path = local_out_folder("gallery"),
    job: Job,
    sink: Sink,
) -> None:
    """Make a page of thumbnails, filters and 3D views that opens without a network or a server.

    Takes about 40 kB per digit, 8 kB per scene; at most 20,000 items and 2 GB.

    Examples: gallery DIR --out site --split test;  gallery DIR --per-class 1
    """
    _make_page(sink, kind.plan_gallery(opening.open(sink, name), chosen), out, job)


def gallery_of_touches(
    *,
    kind: DatasetKind,
    name: str = TOUCH_SET,
    opening: Opening,
    chosen: catalog.Chosen,
    touches: int = integer(64, 1, help="Maximum number of touches of a round, evenly spaced."),
    out: Path = local_out_folder("gallery"),
    job: Job,
    sink: Sink,
) -> None:
    """Make a page of rounds: touches as a grid, clips frame by frame; no network or server is needed.

    At most 20,000 rounds and 2 GB.

    Example: realtouch gallery real-single-64x64 --out site --split test
    """
    from realtouch.gallery import plan_gallery

    _make_page(
        sink,
        plan_gallery(opening.open(sink, name).require(kind, "gallery"), chosen, touches=touches),
        out,
        job,
    )


_ROWS_SHOWN = 20


@dataclass(frozen=True, slots=True)
class Form:
    """What is written."""

    file_format: str | None = choice(
        None,
        ("stl", "3mf", "ply", "obj", "glb", *printing.MODELS, "flat"),
        optional=True,
        name="--format",
        shown="stl, plates 3mf",
        help="Format of the files, in mm (glb, mjcf, urdf, usd: in m); plates are 3mf or mjcf. flat: "
        "Parquet tables with a row for each object, its mesh as GLB.",
    )
    scale: float = real(1.0, help="Factor for all lengths.")
    plate: str | None = text(
        metavar="256x256|prusa-mk4",
        help="Pack the objects on build plates of this size, in mm, or of this printer.",
    )


def export(
    *,
    kind: DatasetKind,
    name: str = ANY_SET,
    opening: Opening,
    form: Form,
    chosen: catalog.Chosen,
    distances: Annotated[dict[str, Any], OptionsOf(printing.PlateSpec)],
    material: Annotated[dict[str, Any], OptionsOf(printing.Physics)],
    out: Path = local_out_folder("prints"),
    job: Job,
    sink: Sink,
) -> None:
    """Write files for printers and simulators, or tables for other libraries.

    Writes a file for each object, or build plates of several objects, or tables with a row for each
    object.

    Examples: export DIR --ids 3,17 --format 3mf;  export DIR --per-class 1 --plate 256x256

    Objects keep their pose; their lowest point is at z = 0.

    Every file is read back; one that is not the same solid is removed and named.

    After an interruption, the same command continues; finished files are kept.

    Exit code 1 when an object or plate could not be written as a solid.
    """
    some = chosen.given()
    # What cannot be used is reported before any work.
    if form.file_format == "flat":
        given = [*distances, *material, *(["scale"] if form.scale != 1 else [])]
        _refuse(given, "about files, not about tables of meshes as they are stored", "leave it out")
    elif form.file_format not in printing.MODELS:
        _refuse(material, "about bodies for simulators", "add --format mjcf, urdf or usd")
    if form.plate is None:
        _refuse(distances, "about build plates", "add --plate 256x256")
    elif form.file_format not in (None, "3mf", "mjcf"):
        _refuse(["plate"], "about 3mf and mjcf, which hold named objects", "one of these")
    place = opening.open(sink, name).require(kind, "export")
    datasets = catalog.open_splits(place, some.pop("split"), kind.load, kind.nouns).items()
    if form.file_format == "flat":
        _export_flat(sink, kind, place, catalog.choose_rows(datasets, **some), some, str(out), job)
        return
    bodies = printing.Physics(**material)
    spec = None if form.plate is None else printing.PlateSpec.parse(form.plate, **distances)
    objects = printing.choose(datasets, **some)
    if spec is None:
        _export_files(sink, objects, form.file_format or "stl", form.scale, bodies, str(out), job)
    else:
        # Plates in MJCF are bodies that lie on a floor; 3MF knows neither density nor friction.
        on_floor = bodies if form.file_format == "mjcf" else None
        _export_plates(sink, objects, spec, form.scale, on_floor, str(out), job)


def _refuse(given: Iterable[str], why: str, instead: str) -> None:
    """Refuse options that would have no effect."""
    for name in given:
        raise InputError(f"--{name.replace('_', '-')} is {why}", next=instead)


def _export_files(
    sink: Sink,
    objects: list[printing.PrintObject],
    ending: str,
    scale: float,
    physics: printing.Physics,
    out: str,
    job: Job,
) -> None:

    how: dict[str, Any] = {"scale": scale, "physics": physics, "overwrite": job.overwrite}
    with sink.progress("checking" if job.dry_run else "writing", "files") as update:
        made = printing.export_files(
            *(objects, out, ending),
            **how,
            dry_run=job.dry_run,
            workers=process_count(job.workers),
            on_progress=update,
        )
    sink.document({"out": out, **asdict(made)})
    if len(made.files) <= _ROWS_SHOWN:
        rows = [
            (
                file.file,
                " x ".join(f"{side:.1f}" for side in file.size_mm),
                f"{file.volume_mm3:,.0f}",
                file.bytes,
                file.state,
            )
            for file in made.files
        ]
        sink.table(("file", "size mm", "volume mm³", "bytes", ""), rows)
    kept = _kept(sum(file.state == "kept" for file in made.files))
    size = bytes_text(sum(file.bytes for file in made.files))
    if job.dry_run:
        count = counted(len(made.files), f"{ending} files")
        sink.line(f"would write {count} to {out} ({size}){kept}; nothing was written")
    else:
        sink.line(f"{counted(len(made.files), 'files')} in {out} ({size}), each read back as a solid{kept}")
    _report_failures(sink, made.failed)


def _export_flat(
    sink: Sink,
    kind: DatasetKind,
    place: places.Place,
    choices: Any,
    some: Mapping[str, Any],
    out: str,
    job: Job,
) -> None:

    plan = exchange.plan_tables(kind, place, choices, some, out)
    if job.dry_run:
        if not job.overwrite:
            store.inspect_job(store.DataFolder(out), plan)
        rows = sum(task.size for task in plan.tasks)
        sink.document({"folder": out, "rows": rows})
        sink.line(f"would write {counted(rows, kind.nouns)} to {out}; nothing was written")
        return
    make = partial(store.build, store.DataFolder(out), plan, write_card=kind.write_card)
    work = Work(job.workers, overwrite=job.overwrite)
    make_with_progress(sink, "writing", kind, make, work, out, print_set)


def _export_plates(
    sink: Sink,
    objects: list[printing.PrintObject],
    spec: printing.PlateSpec,
    scale: float,
    bodies: printing.Physics | None,
    out: str,
    job: Job,
) -> None:

    with sink.progress("measuring", "objects") as update:
        measured = printing.measure(objects, spec, scale, update)
    with sink.progress("packing", "objects") as update:
        layout = replace(printing.arrange(measured, update), physics=bodies)
    done = (
        "writing",
        "wrote",
        "removed",
        f"maps next to them, and {printing.TABLE_FILE} lists which object lies where",
    )
    planned = ("checking", "would write", "would remove", "nothing was written")
    doing, wrote, removed, ending = planned if job.dry_run else done
    with sink.progress(doing, "plates") as update:
        made = printing.write_plates(
            layout, out, overwrite=job.overwrite, dry_run=job.dry_run, on_progress=update
        )
    document = asdict(made)
    sink.document({"out": out, "plates": document.pop("files"), **document})
    if made.removed:
        sink.info(f"{removed} plates of the export that was there before: {', '.join(made.removed)}")
    rows = [
        (plate.file, plate.objects, f"{plate.share:.0%}", bytes_text(plate.bytes)) for plate in made.files
    ]
    sink.table(("plate", "objects", "needed of the plate", "size"), rows)
    kept = _kept(sum(plate.state == "kept" for plate in made.files))
    placed, plates = counted(len(made.objects), "objects"), counted(len(made.files), "plates")
    sink.line(
        f"{wrote} {placed} on {plates} of {spec.text} to {out} (no packing needs fewer than "
        f"{made.least_plates}){kept}; {ending}"
    )
    _report_failures(sink, made.failed)


def _report_failures(sink: Sink, failures: Iterable[printing.Failure]) -> None:
    """Name what could not be written; then the exit code is that of a failed validation."""
    for failure in failures:
        sink.warn(f"failed: {failure.name}: {failure.detail}")
    if failures:
        raise typer.Exit(EXIT_FAILED)


def _kept(count: int) -> str:
    return f"; {count:,} {'was' if count == 1 else 'were'} there already" if count else ""
