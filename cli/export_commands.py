"""``export``: files for printers, alike for every kind of data set that holds meshes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import typer

from cli.application import EXIT_FAILED, command
from cli.options import Limit, LocalOut, Workers, process_count
from cli.output import Sink, bytes_text, counted
from tactile_toolkit.kind import DatasetKind

if TYPE_CHECKING:
    from tactile_toolkit.printing.checked import Failure
    from tactile_toolkit.printing.objects import PrintObject
    from tactile_toolkit.printing.packing import PlateSpec
    from tactile_toolkit.printing.simulator import Physics

__all__ = ["add_export"]

T = TypeVar("T")

_ROWS_SHOWN = 20


MeshFormat = Literal["stl", "3mf", "ply", "obj", "glb", "mjcf", "urdf", "usd"]
"""Formats of mesh files on the command line."""

ObjectLayout = Literal["flat"]
"""Layouts of tables for other libraries."""


def _beds(begun: str) -> list[str]:
    from tactile_toolkit.printing.packing import BEDS_MM

    return [name for name in BEDS_MM if name.startswith(begun)]


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """Options of the command, in the order of its help."""

    name: Annotated[
        str, typer.Argument(metavar="DIR", help="Data set: a folder, a Parquet file or a Hub repository.")
    ]
    split: Annotated[str, typer.Option(metavar="NAME", help="Split to export, or all.")] = "all"
    file_format: Annotated[
        MeshFormat | None,
        typer.Option(
            "--format",
            help="Format of the files, mm (glb, mjcf, urdf, usd: m). Default stl; plates are 3mf or mjcf.",
        ),
    ] = None
    layout: Annotated[
        ObjectLayout | None,
        typer.Option(help="Instead of files, tables: Parquet, a row for each object, its mesh as GLB."),
    ] = None
    ids: Annotated[
        str | None, typer.Option(metavar="3,17,40-60", help="Only the objects with these ids.")
    ] = None
    labels: Annotated[str | None, typer.Option(metavar="3,7", help="Only the objects of these classes.")] = (
        None
    )
    limit: Limit = None
    scale: Annotated[float, typer.Option(metavar="FACTOR", help="Factor on all lengths.")] = 1.0
    plate: Annotated[
        str | None,
        typer.Option(
            "--plate",
            "--bed",
            metavar="256x256|prusa-mk4",
            help="Pack the objects on build plates of this size, in mm, or of this printer.",
            autocompletion=_beds,
        ),
    ] = None
    gap: Annotated[
        float | None,
        typer.Option(metavar="MM", help="Distance between objects on a plate.", show_default="3"),
    ] = None
    margin: Annotated[
        float | None,
        typer.Option(metavar="MM", help="Room at the edges of a plate, for a skirt.", show_default="7"),
    ] = None
    density: Annotated[
        float | None,
        typer.Option(metavar="KG/M3", help="Density of bodies for simulators.", show_default="1240, PLA"),
    ] = None
    friction: Annotated[
        float | None, typer.Option(help="Sliding friction of bodies for simulators.", show_default="0.5")
    ] = None
    out: LocalOut = Path("prints")
    workers: Workers = 1
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace files of an earlier export that differ.")
    ] = False
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", help="Say which files would be made and how large; write nothing."),
    ] = False


def add_export(app: typer.Typer, kind: DatasetKind) -> None:
    """Add the command for a kind of data set of meshes to its command line."""

    @command(app)
    def export(options: ExportOptions, sink: Sink) -> None:
        """Write files for printers and simulators, or tables for other libraries.

        One file per object, or objects packed on build plates; tables have a row for each.

        Objects keep the pose that they have, their lowest point at z = 0.

        Every file is read back and has to be the same solid, or it is removed and named.

        A stopped export goes on when the same command is given again; what is there already is kept.

        Exit code 1 when an object or plate could not be written as a solid.
        """
        from tactile_toolkit.printing.objects import choose, choose_rows

        if options.layout is not None:
            _refuse_options_of_files(options)
            _export_flat(sink, kind, _chosen(kind, options, choose_rows), options)
            return
        spec = _plate_spec(options)
        _physics(options)  # what cannot be used is said before any work
        objects = _chosen(kind, options, choose)
        if spec is None:
            failures = _export_files(sink, objects, options)
        else:
            failures = _export_plates(sink, objects, spec, options)
        for failure in failures:
            sink.insist(f"failed: {failure.name}: {failure.detail}")
        if failures:
            raise typer.Exit(EXIT_FAILED)


def _plate_spec(options: ExportOptions) -> PlateSpec | None:
    from tactile_toolkit.errors import InputError
    from tactile_toolkit.printing.packing import PlateSpec

    if options.plate is None:
        # None where not given, so that a distance without plates is refused instead of ignored.
        for option, value in (("--gap", options.gap), ("--margin", options.margin)):
            if value is not None:
                message = f"{option} is about build plates; next: add --plate 256x256"
                raise InputError(message)
        return None
    if options.file_format not in (None, "3mf", "mjcf"):
        message = (
            f"--plate writes 3mf or mjcf, which hold named objects; --format {options.file_format} does not"
        )
        raise InputError(message)
    given = {"gap_mm": options.gap, "margin_mm": options.margin}
    return PlateSpec.parse(options.plate, **{name: mm for name, mm in given.items() if mm is not None})


def _physics(options: ExportOptions) -> Physics:
    from tactile_toolkit.errors import InputError
    from tactile_toolkit.printing.simulator import MODELS, Physics

    given = {"density_kg_m3": options.density, "friction": options.friction}
    chosen = {name: value for name, value in given.items() if value is not None}
    if chosen and options.file_format not in MODELS:
        message = (
            "--density and --friction are about bodies for simulators; next: add --format mjcf, urdf or usd"
        )
        raise InputError(message)
    return Physics(**chosen)


def _refuse_options_of_files(options: ExportOptions) -> None:
    from tactile_toolkit.errors import InputError

    names = {"file_format": "--format", "scale": "--scale", "plate": "--plate", "gap": "--gap"}
    names |= {name: f"--{name}" for name in ("margin", "density", "friction")}
    plain = ExportOptions(options.name)
    for name, option in names.items():
        if getattr(options, name) != getattr(plain, name):
            message = (
                f"{option} is about files, --layout writes tables of meshes as they are stored; next: leave "
                "one of them out"
            )
            raise InputError(message)


def _chosen(kind: DatasetKind, options: ExportOptions, choose: Callable[..., T]) -> T:
    from tactile_toolkit.catalog.locate import splits_of
    from tactile_toolkit.printing.objects import parse_ids

    # One by one, as no loader opens several splits as one data set.
    splits = splits_of(options.name) if options.split == "all" else (options.split,)
    labels = None if options.labels is None else [word.strip() for word in options.labels.split(",")]
    ids = None if options.ids is None else parse_ids(options.ids)
    datasets = ((split, kind.load(options.name, split)) for split in splits)
    return choose(datasets, ids=ids, labels=labels, limit=options.limit)


def _export_files(sink: Sink, objects: list[PrintObject], options: ExportOptions) -> tuple[Failure, ...]:
    from tactile_toolkit.printing.singles import export_files, forecast_files

    ending, out = options.file_format or "stl", options.out
    if options.dry_run:
        view = forecast_files(
            *(objects, ending, options.scale),
            physics=_physics(options),
            out=str(out),
            overwrite=options.overwrite,
        )
        sink.document({"out": str(out), **view.to_dict()})
        sink.line(
            f"would write {counted(view.files, f'{ending} files')} to {out}, about {bytes_text(view.bytes)} "
            f"(measured on {view.sampled}); nothing was written"
        )
        return view.failures
    with sink.progress("writing", "files") as update:
        made = export_files(
            objects,
            str(out),
            ending,
            scale=options.scale,
            physics=_physics(options),
            overwrite=options.overwrite,
            workers=process_count(options.workers),
            on_progress=update,
        )
    sink.document({"out": str(out), **made.to_dict()})
    if made.files and len(made.files) <= _ROWS_SHOWN:
        sizes = [" x ".join(f"{side:.1f}" for side in file.size_mm) for file in made.files]
        rows = [
            (file.file, size, f"{file.volume_mm3:,.0f}", file.bytes, file.state)
            for file, size in zip(made.files, sizes, strict=True)
        ]
        sink.table(("file", "size mm", "volume mm³", "bytes", ""), rows)
    kept = sum(file.state == "kept" for file in made.files)
    size = bytes_text(sum(file.bytes for file in made.files))
    sink.line(
        f"{counted(len(made.files), 'files')} in {out} ({size}), each read back as a solid{_kept(kept)}"
    )
    return made.failures


def _export_flat(sink: Sink, kind: DatasetKind, choices: Any, options: ExportOptions) -> None:
    from cli.touch_tables import print_converted
    from tactile_toolkit.exchange.tables import export_tables, forecast_tables

    chosen_by = {"ids": options.ids, "labels": options.labels, "limit": options.limit}
    what, out = (kind, options.name, choices, chosen_by), str(options.out)
    if options.dry_run:
        rows, size = forecast_tables(*what, out, overwrite=options.overwrite)
        sink.document({"folder": out, "rows": rows, "bytes": size})
        made = f"{counted(rows, kind.nouns)} to {out}, about {bytes_text(size)}"
        sink.line(f"would write {made}; nothing was written")
        return
    with sink.progress("writing", kind.nouns) as update:
        manifest = export_tables(
            *what,
            out,
            overwrite=options.overwrite,
            workers=process_count(options.workers),
            on_progress=lambda progress: update(progress.done, progress.total),
        )
    print_converted(sink, manifest, out, kind.nouns)


def _export_plates(
    sink: Sink, objects: list[PrintObject], spec: PlateSpec, options: ExportOptions
) -> tuple[Failure, ...]:
    from tactile_toolkit.printing.layout import arrange, measure
    from tactile_toolkit.printing.plates import TABLE_FILE, forecast_plates, write_plates

    out, dry_run, overwrite = options.out, options.dry_run, options.overwrite
    with sink.progress("measuring", "objects") as update:
        measured = measure(objects, spec, options.scale, update)
    with sink.progress("packing", "objects") as update:
        layout = arrange(measured, update)
    # Plates in MJCF are bodies that lie on a floor; 3MF knows neither density nor friction.
    if options.file_format == "mjcf":
        layout = replace(layout, physics=_physics(options))
    if dry_run:
        made = forecast_plates(layout, str(out), overwrite=overwrite)
    else:
        with sink.progress("writing", "plates") as update:
            made = write_plates(layout, str(out), overwrite=overwrite, on_progress=update)
    sink.document({"out": str(out), **made.to_dict()})
    if made.removed:
        verb = "would remove" if dry_run else "removed"
        sink.talk(f"{verb} plates of the export that was there before: {', '.join(made.removed)}")
    rows = [
        (plate.file, plate.objects, f"{plate.share:.0%}", bytes_text(plate.bytes)) for plate in made.plates
    ]
    sink.table(("plate", "objects", "needed of the plate", "size"), rows)
    verb = "would write" if dry_run else "wrote"
    ending = f"maps beside them, and {TABLE_FILE} says which object lies where"
    kept = sum(plate.state == "kept" for plate in made.plates)
    placed, plates = counted(len(made.rows), "objects"), counted(len(made.plates), "plates")
    sink.line(
        f"{verb} {placed} on {plates} of {spec.text} to {out} (no packing needs fewer than "
        f"{made.least_plates}){_kept(kept)}; {'nothing was written' if dry_run else ending}"
    )
    return made.failures


def _kept(count: int) -> str:
    return f"; {count:,} {'was' if count == 1 else 'were'} there already" if count else ""
