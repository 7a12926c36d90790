"""The command that makes files for printers from pictures."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import typer

import mnist3d
from cli.application import EXIT_FAILED
from cli.options import Job, argument, local_place, process_count
from cli.output import Sink
from mnist3d.digit_options import PROFILES, SolidSize
from tactile_toolkit import mesh
from tactile_toolkit.checked_fields import choice, integer, real, switch, text
from tactile_toolkit.wording import bytes_text, with_count

_DONE = {True: "would write", False: "wrote"}
_FORMATS = ("stl", "3mf", "ply", "obj", "glb")
_INK = {True: "light", False: "auto"}
# A relief on a plate is as thick as the upper half of a solid without one.
_THICKNESS_MM = {True: 4.0, False: 8.0}


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
        thickness_mm = self.thickness_mm or _THICKNESS_MM[self.base_mm is not None]
        halves = 1 if self.base_mm is not None else 2
        changed: dict[str, object] = {
            "half_thickness_mm": thickness_mm / halves,
            "profile": self.edge_profile,
        }
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
        ink=_INK[reading.invert],
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
        sink.line(f"{_DONE[job.dry_run]} {counted} ({size_text}), each checked to be a solid")
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
        for line in mesh.explained(file.report, spec.profile):
            sink.line(f"{file.file}: {line}")
