"""The command line of MNIST 3D, and files for printers from pictures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import typer

import mnist3d
from cli import checks, options, output, pictures, runs, shared
from cli.application import EXIT_FAILED, command, new_app, run as run_app
from cli.options import Job, argument, local_place, process_count
from cli.output import Sink
from mnist3d import digit_options
from mnist3d.digit_options import PROFILES, SPLITS, SolidSize, SplitSpec
from mnist3d.kind import KIND
from tactile_toolkit import cards, catalog, checked_fields, mesh, places, run, store
from tactile_toolkit.checked_fields import choice, integer, real, switch, text
from tactile_toolkit.kind import DatasetKind, lazy
from tactile_toolkit.wording import bytes_text, with_count

_FORMATS = ("stl", "3mf", "ply", "obj", "glb")

# A relief on a plate is as thick as the upper half of a solid without one.
_THICKNESS_MM = 8.0
_THICKNESS_ON_BASE_MM = 4.0
_CHECKS = checks.Geometry("meshes", lazy("mnist3d.digit_checks:validate_paths"))

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
    images: Annotated[options.Given, options.OptionsOf(digit_options.SourceOptions)],
    division: SplitSpec,
    per_class: int | None = catalog.PER_CLASS,
    limit: int | None = catalog.LIMIT,
    solid: digit_options.SolidSpec,
    words: cards.OwnerWords,
    making: options.Making,
    sink: output.Sink,
) -> None:
    """Make a data set of printable 3D digits.

    Example: mnist3d generate --split train --per-class 10 --out digits

    After an interruption, the same command continues; finished shards are kept.
    """
    spec = mnist3d.DigitSetSpec(
        source=mnist3d.chosen_source(source, images, division.seed),
        solid=solid,
        split=division,
        per_class=per_class,
        limit=limit,
    )
    making_of = mnist3d.DigitGenerator.of(spec, None if split is None else SPLITS)
    splits: Sequence[str] | None = None
    if split == "all":
        splits = tuple(making_of.items())
    elif split is not None:
        splits = (split,)
    # Before the first digit, also for a forecast, which measures how long a worker takes.
    run.prepare_batch_process()
    manifest = runs.generate_set(sink, "making digits", making_of, out, splits, making, _print_made)
    if words.given() and not making.dry_run:
        if manifest is not None and manifest.complete:
            cards.rewrite_card(KIND, store.open_folder(out), manifest, words)
        else:
            next_step = "state the licence and other words when it is finished"
            sink.info(f"note: {out} is unfinished; next: {next_step}")


def _print_made(
    sink: output.Sink, kind: DatasetKind, manifest: store.Manifest, out: str, elapsed_s: float | None
) -> None:
    from mnist3d.digit_card import facts_table  # pyarrow

    # The report that the figures come from is written at the end of a run.
    summaries = []
    if manifest.complete:
        summaries = mnist3d.summarise(store.open_folder(out), manifest)
    splits = [summary.to_dict() for summary in summaries] or manifest.split_table()
    skipped = manifest.skipped_reasons()
    facts = facts_table(summaries, mnist3d.SUMMED_UP)
    runs.print_left_out(sink, manifest)
    runs.print_set(sink, kind, manifest, out, elapsed_s, *facts, splits=splits, skipped=skipped)
    for line in mesh.PrintReport.advice(word for each in summaries for word in each.facets["warnings"]):
        sink.line(line)


def _preview(
    *,
    path: str = options.argument(
        "DIR|FILE", "Data set folder, Parquet file, STL/3MF/PLY/OBJ/GLB file, or a picture of a digit."
    ),
    opening: options.Opening,
    spec: digit_options.DigitPreviewSpec,
    pictures: pictures.Pictures,
    sink: output.Sink,
) -> None:
    """Write pictures of digits as PNG, without a screen: a sheet of each split, or steps from ink to mesh.

    Examples: mnist3d preview digits;  mnist3d preview digits --ids 17,408;  mnist3d preview part.stl
    """
    name: str | places.Place = path
    if not mnist3d.is_picture_or_mesh(path):
        name = opening.open(sink, path)
    pictures.write(sink, KIND.plan_previews(name, spec))


@dataclass(frozen=True, slots=True)
class PrintShape:
    """Options for the shape of the solids."""

    thickness_mm: float | None = real(
        None,
        above=0,
        optional=True,
        shown="8, 4 above a plate",
        help="Thickness of the solid, without its base plate.",
    )
    base_mm: float | None = real(
        None,
        above=0,
        optional=True,
        help="Put the solid on a base plate of this thickness, which joins its parts.",
    )
    bridge_mm: float | None = real(
        None,
        above=0,
        optional=True,
        help="Join separate parts by bridges of at most this width; they are never wider than the strokes.",
    )
    edge_profile: str = choice("round", PROFILES, help="Shape of the edges.")
    vertices: int | None = integer(
        None, 100, optional=True, shown="as many as the strokes need", help="Approximate number of vertices."
    )

    def changes(self) -> dict[str, object]:
        """Return the parameters of the algorithm that differ from the usual ones."""
        half_thickness_mm = (self.thickness_mm or _THICKNESS_MM) / 2
        if self.base_mm is not None:
            half_thickness_mm = self.thickness_mm or _THICKNESS_ON_BASE_MM
        changed: dict[str, object] = {"half_thickness_mm": half_thickness_mm, "profile": self.edge_profile}
        if self.bridge_mm is not None:
            changed |= {"join_bodies": True, "bridge_width_mm": self.bridge_mm}
        if self.vertices is not None:
            changed["target_vertices"] = self.vertices
        return changed


@dataclass(frozen=True, slots=True)
class PictureReading:
    """Options for what is ink in a picture."""

    threshold: str = choice(
        "auto",
        ("auto", "local", "global"),
        help="Even out the light and find the page (local), or apply one threshold (global); auto takes "
        "local for pictures without clean paper.",
    )
    invert: bool = switch(False, help="The ink is lighter than the paper; by default, this is detected.")


@command(app)
def solidify(
    *,
    pictures: list[str] = argument("PICTURE", "Pictures, or folders of pictures.", several=True),
    out: str = text(
        "prints",
        name="--out -o",
        metavar="FILE|DIR",
        read=lambda words: str(local_place(words)),
        help="File to write, such as drawing.stl or drawing.3mf, or a folder for several pictures.",
    ),
    file_format: str = choice("stl", _FORMATS, name="--format", help="Format of the files in a folder."),
    size: SolidSize,
    shape: PrintShape,
    reading: PictureReading,
    nozzle_mm: float = real(0.4, above=0, help="Diameter of the nozzle; walls need two lines."),
    preview: bool = switch(False, help="Write a picture of each solid beside its file: NAME-preview.png."),
    job: Job,
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
        ink="light" if reading.invert else "auto",
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
    files = [file.to_dict() for file in made.files]
    failed = [{"picture": each.name, "problem": each.problem, "detail": each.detail} for each in made.failed]
    sink.document({"out": out, "files": files, "failed": failed})
    _print_files(sink, made.files, spec)
    if made.files:
        size_text = bytes_text(sum(file.bytes for file in made.files))
        counted = with_count(len(made.files), "files")
        done = "would write" if job.dry_run else "wrote"
        sink.line(f"{done} {counted} ({size_text}), each checked to be a solid")
    for each in made.failed:
        sink.warn(f"failed: {each.name}: {each.detail}")
    if made.failed:
        raise typer.Exit(EXIT_FAILED)


def _print_files(sink: Sink, files: Iterable[mnist3d.PrintedPicture], spec: mnist3d.PrintSpec) -> None:
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
        for line in file.report.explained(spec.profile):
            sink.line(f"{file.file}: {line}")


shared.add_shared(app, KIND, {"preview": _preview}, print_made=_print_made, checks=_CHECKS)
main = partial(run_app, app)
