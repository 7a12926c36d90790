"""The command that writes files for printers, simulators and other libraries."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from cli import application, options, output, runs
from tactile_toolkit import catalog, checked_fields, exchange, printing, store, wording
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.wording import with_count

_ROWS_SHOWN = 20
_UNCHANGED = {"scale": 1, "base_mm": None}


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """Format and scale of exported files, and the size of build plates."""

    file_format: str | None = checked_fields.choice(
        None,
        ("stl", "3mf", "ply", "obj", "glb", *printing.MODELS, "flat"),
        optional=True,
        name="--format",
        shown="stl, plates 3mf",
        help="Format of the files, in mm (glb, mjcf, urdf, usd: in m); plates are 3mf or mjcf. flat: "
        "Parquet tables with a row for each object, its mesh as GLB.",
    )
    scale: float = checked_fields.real(1.0, help="Factor for all lengths.")
    base_mm: float | None = checked_fields.real(
        None,
        above=0,
        optional=True,
        help="Put the upper half of each object on a base plate of this thickness, which prints without "
        "support.",
    )
    plate: str | None = checked_fields.text(
        metavar="256x256|prusa-mk4",
        complete=printing.PlateSpec.printers(),
        help="Pack the objects on build plates of this size, in mm, or of this printer.",
    )
    calibration_plate: bool = checked_fields.switch(
        False,
        help="Write one plate with a ball, a cone, a ridge, steps and two objects, onto which a sensor is "
        "pressed for `tactile-sim calibrate`.",
    )


def export(
    *,
    kind: DatasetKind,
    name: str = options.ANY_SET,
    opening: options.Opening,
    form: ExportOptions,
    chosen: catalog.RowFilter,
    distances: Annotated[options.Given, options.OptionsOf(printing.PlateSpec)],
    material: Annotated[options.Given, options.OptionsOf(printing.Physics)],
    out: Path = options.local_out_folder("prints"),
    job: options.Job,
    sink: output.Sink,
) -> None:
    """Write files for printers and simulators, or tables for other libraries.

    Writes a file for each object, or build plates of several objects, or tables with a row for each
    object.

    Examples: export DIR --ids 3,17 --format 3mf;  export DIR --per-class 1 --plate 256x256;
    export DIR --calibration-plate --out plate

    Objects keep their pose; their lowest point is at z = 0.

    Every file is read back; one that is not the same solid is removed and named.

    After an interruption, the same command continues; finished files are kept.

    Exit code 1 if an object or plate could not be written as a solid.
    """
    _refuse_without_effect(form, distances, material)
    place = opening.open(sink, name).require(kind, "export")
    if form.file_format == "flat":
        _export_flat(sink, kind, exchange.plan_tables(kind, place, chosen, str(out)), str(out), job)
        return
    filters = chosen.given()
    datasets = catalog.open_splits(place, filters.pop("split"), kind.load, kind.nouns).items()
    bodies = printing.Physics(**material)
    spec = None
    if form.plate is not None:
        spec = printing.PlateSpec.parse(form.plate, **distances)
    objects = printing.choose(datasets, form.base_mm, **filters)
    if form.calibration_plate:
        _export_calibration_plate(sink, objects, form.file_format or "3mf", str(out), job)
    elif spec is not None:
        # Plates in MJCF are bodies that lie on a floor; 3MF has neither density nor friction.
        on_floor = {"mjcf": bodies}.get(form.file_format or "")
        _export_plates(sink, objects, spec, form.scale, on_floor, str(out), job)
    else:
        _export_files(sink, objects, form.file_format or "stl", form.scale, bodies, str(out), job)


def _refuse_without_effect(form: ExportOptions, distances: Iterable[str], material: Iterable[str]) -> None:
    """Refuse options that would have no effect, before any work."""
    if form.file_format == "flat":
        given = [*distances, *material]
        given += [name for name in ("scale", "base_mm") if getattr(form, name) != _UNCHANGED[name]]
        _refuse(given, "applies to mesh files, not to flat tables of the stored meshes", "leave it out")
    elif form.file_format not in printing.MODELS:
        _refuse(material, "applies to bodies for simulators only", "add --format mjcf, urdf or usd")
    if form.plate is None:
        _refuse(distances, "applies to build plates only", "add --plate 256x256")
    elif form.file_format not in (None, "3mf", "mjcf"):
        _refuse(["plate"], "applies to 3mf and mjcf only, which hold named objects", "add --format 3mf")
    if form.calibration_plate:
        _refuse_for_plate(form)


def _refuse(given: Iterable[str], why: str, instead: str) -> None:
    """Raise InputError for the first of the options, if there is one."""
    for name in given:
        raise InputError(f"--{name.replace('_', '-')} {why}", next=instead)


def _refuse_for_plate(form: ExportOptions) -> None:
    """Refuse options that the plate for calibration does not have."""
    if form.file_format == "flat" or form.file_format in printing.MODELS:
        raise InputError(
            f"--format is {form.file_format!r}; expected 3mf, stl, ply, obj or glb for the plate for "
            "calibration, which is printed"
        )
    if form.plate is not None or form.scale != 1 or form.base_mm is not None:
        raise InputError(
            "the plate for calibration has a size of its own", next="leave out --plate, --scale and --base-mm"
        )


def _export_calibration_plate(
    sink: output.Sink, objects: list[printing.PrintObject], ending: str, out: str, job: options.Job
) -> None:
    made = printing.export_calibration_plate(
        objects, out, ending, overwrite=job.overwrite, dry_run=job.dry_run
    )
    sink.document({"out": out, **asdict(made)})
    for plate in made.files:
        size = " x ".join(f"{side:g}" for side in plate.size_mm)
        sink.line(
            f"{plate.state}: {', '.join(plate.files)} in {out}; {size} mm, with {', '.join(plate.features)}"
        )
    _report_failures(sink, made.failed)


def _export_files(
    sink: output.Sink,
    objects: list[printing.PrintObject],
    ending: str,
    scale: float,
    physics: printing.Physics,
    out: str,
    job: options.Job,
) -> None:
    with sink.progress("checking" if job.dry_run else "writing", "files") as update:
        made = printing.export_files(
            objects,
            out,
            ending,
            scale=scale,
            physics=physics,
            overwrite=job.overwrite,
            dry_run=job.dry_run,
            workers=options.process_count(job.workers),
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
    size = wording.bytes_text(sum(file.bytes for file in made.files))
    if job.dry_run:
        count = with_count(len(made.files), f"{ending} files")
        sink.line(f"would write {count} to {out} ({size}){kept}; nothing was written")
    else:
        sink.line(
            f"{with_count(len(made.files), 'files')} in {out} ({size}), each read back as a solid{kept}"
        )
    _report_failures(sink, made.failed)


def _export_flat(
    sink: output.Sink, kind: DatasetKind, plan: store.BuildPlan, out: str, job: options.Job
) -> None:
    if job.dry_run:
        if not job.overwrite:
            store.inspect_job(store.open_folder(out), plan)
        rows = sum(task.size for task in plan.tasks)
        sink.document({"folder": out, "rows": rows})
        sink.line(f"would write {with_count(rows, kind.nouns)} to {out}; nothing was written")
        return
    make = partial(store.build, store.open_folder(out), plan, write_card=kind.write_card)
    work = options.Work(job.workers, overwrite=job.overwrite)
    runs.make_with_progress(sink, "writing", kind, make, work, out, runs.print_set)


def _export_plates(
    sink: output.Sink,
    objects: list[printing.PrintObject],
    spec: printing.PlateSpec,
    scale: float,
    bodies: printing.Physics | None,
    out: str,
    job: options.Job,
) -> None:
    with sink.progress("measuring", "objects") as update:
        layout = printing.arrange(objects, spec, scale, bodies, update)
    wrote = "wrote"
    removed = "removed"
    ending = "plates.csv lists where each object lies"
    if job.dry_run:
        wrote = "would write"
        removed = "would remove"
        ending = "nothing was written"
    with sink.progress("checking" if job.dry_run else "writing", "plates") as update:
        made = printing.write_plates(
            layout, out, overwrite=job.overwrite, dry_run=job.dry_run, on_progress=update
        )
    document = asdict(made)
    sink.document({"out": out, "plates": document.pop("files"), **document})
    if made.removed:
        sink.info(f"{removed} plates of an earlier export: {', '.join(made.removed)}")
    rows = [
        (plate.file, plate.objects, f"{plate.share:.0%}", wording.bytes_text(plate.bytes))
        for plate in made.files
    ]
    sink.table(("plate", "objects", "share of the plate", "size"), rows)
    kept = _kept(sum(plate.state == "kept" for plate in made.files))
    placed = with_count(len(made.objects), "objects")
    plates = with_count(len(made.files), "plates")
    sink.line(f"{wrote} {placed} on {plates} of {spec.text} to {out}{kept}; {ending}")
    _report_failures(sink, made.failed)


def _report_failures(sink: output.Sink, failures: Sequence[printing.FailedExport]) -> None:
    """Name the objects that could not be written; if there are any, exit as after a failed validation."""
    for failure in failures:
        sink.warn(f"failed: {failure.name}: {failure.detail}")
    if failures:
        raise typer.Exit(application.EXIT_FAILED)


def _kept(count: int) -> str:
    if not count:
        return ""
    return f"; {count:,} unchanged"
