"""The command line of MNIST 3D, and files for printers from pictures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

import mnist3d
from cli import options, runs
from cli.application import EXIT_FAILED, command, new_app, run as run_app
from cli.contents import print_content
from cli.options import FileJobOptions, argument, parse_local_path, process_count, refuse
from cli.output import Sink
from mnist3d import digit_options
from mnist3d.digit_options import SPLITS, PictureReading, PrintShape, SolidSize, SplitSpec
from mnist3d.kind import KIND
from tactile_toolkit import cards, catalog, checked_fields, mesh, places, run
from tactile_toolkit.checked_fields import choice, real, switch, text
from tactile_toolkit.kind import lazy
from tactile_toolkit.wording import bytes_text, with_count

if TYPE_CHECKING:
    from mnist3d.picture_prints import PrintedPicture

_chosen_source = lazy("mnist3d.digit_generation:chosen_source")
_is_mesh_file = lazy("mnist3d.digit_checks:is_mesh_file")
_FORMATS = ("stl", "3mf", "ply", "obj", "glb")

app = new_app("mnist3d", "Printable 3D digits: from images of handwriting to validated data sets of meshes.")


@command(app)
def generate(
    *,
    split: str | None = checked_fields.choice(
        None,
        (*SPLITS, "all"),
        shown="all",
        help="Split to make. By default, all images of a folder are in train.",
    ),
    out: str = options.out_folder("mnist3d-data"),
    source: str = checked_fields.choice(
        "synthetic", digit_options.SOURCES, help="Where the images come from."
    ),
    images: Annotated[options.UserOptions, options.OptionsOf(digit_options.SourceOptions)],
    division: SplitSpec,
    per_class: int | None = catalog.row_option("per_class"),
    limit: int | None = catalog.row_option("limit"),
    solid: digit_options.SolidSpec,
    words: cards.OwnerWords,
    run_options: options.GenerateOptions,
    sink: Sink,
) -> None:
    """Make a data set of printable 3D digits.

    Example: mnist3d generate --split train --per-class 10 --out digits

    After an interruption, the same command continues; finished shards are kept.
    """
    spec = mnist3d.DigitSetSpec(
        source=_chosen_source(source, images, division.seed),
        solid=solid,
        split=division,
        per_class=per_class,
        limit=limit,
    )
    digits = mnist3d.DigitGenerator.of(spec, None if split is None else SPLITS)
    splits: Sequence[str] | None = None
    if split == "all":
        splits = tuple(digits.items())
    elif split is not None:
        splits = (split,)
    # Before the first digit, also for a forecast, which measures how long a worker takes.
    run.prepare_batch_process()
    manifest = runs.generate_set(sink, "making digits", digits, out, splits, run_options)
    if words.given() and not run_options.dry_run:
        if manifest is not None and manifest.complete:
            options.data_set(places.open_place(out), KIND).rewrite_card(words)
        else:
            next_step = "state the licence and other words when it is finished"
            sink.info(f"note: {out} is unfinished; next: {next_step}")


@command(app)
def validate(
    *,
    paths: list[str] = argument(
        "NAME|FILE", "Data sets, or files of meshes.", several=True, read=options.parse_path
    ),
    source_options: options.SourceOptions,
    split: str | None = catalog.row_option("split"),
    limit: int | None = catalog.row_option("limit"),
    unit: str | None = mesh.UNIT,
    nozzle_mm: float = real(0.4, above=0, help="Nozzle of the printer: walls need two lines of it."),
    workers: int = options.WORKERS,
    sink: Sink,
) -> None:
    """Check that each mesh of data sets, or of mesh files, is a solid that prints well.

    Warnings about printing are listed. `tactile verify --content` checks the files of a data set as well.

    Example: mnist3d validate digits

    Exit code 1 if a mesh is not a solid.
    """
    sources: list[str | places.Place] = []
    # All names are opened first, so that a wrong one is reported at once.
    for path in paths:
        if _is_mesh_file(path):
            sources.append(path)
        else:
            mesh.refuse_unit(unit, path)
            sources.append(source_options.open_source(sink, path))
    if all(isinstance(source, str) for source in sources):
        refuse({**asdict(source_options), "split": split, "limit": limit}, "mesh files")
    profile = mesh.PrintProfile(nozzle_mm=nozzle_mm)
    results = print_content(sink, KIND, sources, split, limit, workers, unit=unit, profile=profile)
    sink.document(results)
    if any(result["failed"] for result in results):
        raise typer.Exit(EXIT_FAILED)


@command(app)
def solidify(
    *,
    pictures: list[str] = argument("PICTURE", "Pictures, or folders of pictures.", several=True),
    out: str = text(
        "prints",
        name="--out -o",
        metavar="FILE|DIR",
        read=lambda words: str(parse_local_path(words)),
        help="File to write, such as drawing.stl or drawing.3mf, or a folder for several pictures.",
    ),
    file_format: str = choice("stl", _FORMATS, name="--format", help="Format of the files in a folder."),
    size: SolidSize,
    shape: PrintShape,
    reading: PictureReading,
    nozzle_mm: float = real(0.4, above=0, help="Diameter of the nozzle; walls need two lines."),
    preview: bool = switch(False, help="Write a picture of each solid beside its file: NAME-preview.png."),
    job: FileJobOptions,
    sink: Sink,
) -> None:
    """Make files for printers from pictures: a drawing, handwriting, a logo, a scan or a photograph.

    Example: mnist3d solidify drawing.jpg --out drawing.stl --height-mm 60

    Without a size, the longer side of a picture becomes 100 mm. Every file is read back and checked.

    Exit code 1 if a picture could not be used.
    """
    spec = mnist3d.PrintSpec(
        changes=shape.changes(),
        size=size,
        base_mm=shape.base_mm,
        ink=reading.foreground,
        threshold=reading.threshold,
        profile=mesh.PrintProfile(nozzle_mm=nozzle_mm),
        ending=f".{file_format}",
        preview=preview,
    )
    with sink.progress("checking" if job.dry_run else "making", "files") as update:
        made = mnist3d.print_pictures(
            *(pictures, out, spec),
            overwrite=job.overwrite,
            dry_run=job.dry_run,
            workers=process_count(job.workers),
            on_progress=update,
        )
    failed = [
        {"picture": picture.name, "problem": picture.problem, "detail": picture.detail}
        for picture in made.failed
    ]
    sink.document({"out": out, "files": [file.to_dict() for file in made.files], "failed": failed})
    _print_files(sink, made.files, spec)
    if made.files:
        size_text = bytes_text(sum(file.bytes for file in made.files))
        counted = with_count(len(made.files), "files")
        done = "would write" if job.dry_run else "wrote"
        sink.line(f"{done} {counted} ({size_text}), each checked to be a solid")
    for picture in made.failed:
        sink.warn(f"failed: {picture.name}: {picture.detail}")
    if made.failed:
        raise typer.Exit(EXIT_FAILED)


def _print_files(sink: Sink, files: Iterable[PrintedPicture], spec: mnist3d.PrintSpec) -> None:
    """Print size and volume of each file, and parts that will not print."""
    rows = [
        (
            file.file,
            " x ".join(f"{side:.1f}" for side in file.report.size_mm),
            f"{file.report.volume_mm3:,.0f}",
            f"{file.report.mass_g:.1f}",
            file.report.bodies,
            ", ".join(file.report.warnings) or "none",
        )
        for file in files
    ]
    sink.table(("file", "size mm", "volume mm³", "g of PLA", "parts", "print warnings"), rows)
    for file in files:
        for note in file.notes:
            sink.line(f"{file.file}: note: {note}")
        for line in file.report.explained(spec.profile, spec.advice_options()):
            sink.line(f"{file.file}: {line}")


main = partial(run_app, app)
