"""``export``: files for printers, simulators and other libraries, of every kind that holds meshes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cli.application import EXIT_FAILED, OptionsOf, command
from cli.making import print_converted
from cli.options import JOB, AnySet, Chosen, LocalOut, Workers, process_count
from cli.output import Sink, bytes_text
from tactile_toolkit.checked_fields import choice, real, switch, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.printing.spec import MODELS, Physics, PlateSpec
from tactile_toolkit.wording import counted

if TYPE_CHECKING:
    from tactile_toolkit.printing.objects import Failure, PrintObject


_ROWS_SHOWN = 20


@dataclass(frozen=True, slots=True)
class Job:
    """Where files go, and how they are made."""

    out: LocalOut = Path("prints")
    workers: Workers = 0
    overwrite: bool = switch(False, panel=JOB, help="Replace files of an earlier export that differ.")
    dry_run: bool = switch(
        False, panel=JOB, help="Print which files would be made and their size; write nothing."
    )


def add_export(app: typer.Typer, kind: DatasetKind) -> None:
    """Add the command for a kind of data set of meshes to its command line."""

    @command(app)
    def export(
        *,
        name: AnySet,
        file_format: str | None = choice(
            None,
            ("stl", "3mf", "ply", "obj", "glb", *MODELS, "flat"),
            optional=True,
            name="--format",
            shown="stl, plates 3mf",
            help="Format of the files, in mm (glb, mjcf, urdf, usd: in m); plates are 3mf or mjcf. flat: "
            "Parquet tables with a row for each object, its mesh as GLB.",
        ),
        chosen: Chosen,
        scale: float = real(1.0, help="Factor for all lengths."),
        plate: str | None = text(
            metavar="256x256|prusa-mk4",
            help="Pack the objects on build plates of this size, in mm, or of this printer.",
        ),
        distances: Annotated[dict[str, Any], OptionsOf(PlateSpec)],
        material: Annotated[dict[str, Any], OptionsOf(Physics)],
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
        from tactile_toolkit.catalog.choose import choose_rows, open_splits
        from tactile_toolkit.printing.objects import choose

        some = chosen.given()
        datasets = open_splits(name, some.pop("split"), kind.load, kind.nouns).items()
        # What cannot be used is reported before any work.
        if file_format == "flat":
            given = {**distances, **material, "plate": plate, "scale": None if scale == 1 else scale}
            why = "about files, not about tables of meshes as they are stored"
            _refuse([name for name, value in given.items() if value is not None], why, "leave it out")
            _export_flat(sink, kind, name, choose_rows(datasets, **some), some, job)
            return
        if file_format not in MODELS:
            _refuse(material, "about bodies for simulators", "add --format mjcf, urdf or usd")
        if plate is None:
            _refuse(distances, "about build plates", "add --plate 256x256")
            objects = choose(datasets, **some)
            failures = _export_files(sink, objects, file_format or "stl", scale, Physics(**material), job)
        else:
            spec = PlateSpec.parse(plate, **distances)
            if file_format not in (None, "3mf", "mjcf"):
                _refuse(["plate"], "about 3mf and mjcf, which hold named objects", "one of these")
            # Plates in MJCF are bodies that lie on a floor; 3MF knows neither density nor friction.
            bodies = Physics(**material) if file_format == "mjcf" else None
            failures = _export_plates(sink, choose(datasets, **some), spec, scale, bodies, job)
        for failure in failures:
            sink.warn(f"failed: {failure.name}: {failure.detail}")
        if failures:
            raise typer.Exit(EXIT_FAILED)


def _refuse(given: Iterable[str], why: str, instead: str) -> None:
    """Refuse options that would have no effect."""
    for name in given:
        raise InputError(f"--{name.replace('_', '-')} is {why}", next=instead)


def _export_files(
    sink: Sink, objects: list[PrintObject], ending: str, scale: float, physics: Physics, job: Job
) -> tuple[Failure, ...]:
    from tactile_toolkit.printing.objects import export_files, forecast_files

    out = str(job.out)
    if job.dry_run:
        view = forecast_files(objects, out, ending, scale=scale, physics=physics, overwrite=job.overwrite)
        sink.document({"out": out, **asdict(view)})
        sink.line(
            f"would write {counted(view.files, f'{ending} files')} to {out}, about {bytes_text(view.bytes)} "
            f"(measured on {view.sampled}); nothing was written"
        )
        return view.failed
    with sink.progress("writing", "files") as update:
        made = export_files(
            *(objects, out, ending),
            scale=scale,
            physics=physics,
            overwrite=job.overwrite,
            workers=process_count(job.workers),
            on_progress=update,
        )
    sink.document({"out": out, **asdict(made)})
    if len(made.files) <= _ROWS_SHOWN:
        sizes = [" x ".join(f"{side:.1f}" for side in file.size_mm) for file in made.files]
        rows = [
            (file.file, size, f"{file.volume_mm3:,.0f}", file.bytes, file.state)
            for file, size in zip(made.files, sizes, strict=True)
        ]
        sink.table(("file", "size mm", "volume mm³", "bytes", ""), rows)
    kept = _kept(sum(file.state == "kept" for file in made.files))
    size = bytes_text(sum(file.bytes for file in made.files))
    sink.line(f"{counted(len(made.files), 'files')} in {out} ({size}), each read back as a solid{kept}")
    return made.failed


def _export_flat(
    sink: Sink, kind: DatasetKind, name: str, choices: Any, some: Mapping[str, Any], job: Job
) -> None:
    from tactile_toolkit.exchange.tables import forecast_tables, plan_tables
    from tactile_toolkit.run.processes import runner_for
    from tactile_toolkit.store.build import build
    from tactile_toolkit.store.folder import DataFolder

    ids, labels = some["ids"], some["labels"]
    chosen_by = {
        "ids": ids
        and ",".join("-".join(map(str, each)) if isinstance(each, tuple) else str(each) for each in ids),
        "labels": labels and ",".join(labels),
        "limit": some["limit"],
        **({} if some["per_class"] is None else {"per_class": some["per_class"]}),
    }
    out = str(job.out)
    plan = plan_tables(kind, name, choices, chosen_by, out)
    if job.dry_run:
        rows, size = forecast_tables(plan, out, overwrite=job.overwrite)
        sink.document({"folder": out, "rows": rows, "bytes": size})
        made = f"{counted(rows, kind.nouns)} to {out}, about {bytes_text(size)}"
        sink.line(f"would write {made}; nothing was written")
        return
    with sink.progress("writing", kind.nouns) as update:
        manifest = build(
            DataFolder(out),
            plan,
            runner_for(process_count(job.workers)),
            overwrite=job.overwrite,
            on_progress=lambda progress: update(progress.done, progress.total),
            write_card=kind.write_card,
        )
    print_converted(sink, manifest, out, nouns=kind.nouns)
    sink.line(f"the data set is in {out}")


def _export_plates(
    sink: Sink, objects: list[PrintObject], spec: PlateSpec, scale: float, bodies: Physics | None, job: Job
) -> tuple[Failure, ...]:
    from tactile_toolkit.printing.packing import arrange, measure
    from tactile_toolkit.printing.plates import TABLE_FILE, forecast_plates, write_plates

    out = str(job.out)
    with sink.progress("measuring", "objects") as update:
        measured = measure(objects, spec, scale, update)
    with sink.progress("packing", "objects") as update:
        layout = replace(arrange(measured, update), physics=bodies)
    verb, ending = "wrote", f"maps next to them, and {TABLE_FILE} lists which object lies where"
    if job.dry_run:
        verb, ending = "would write", "nothing was written"
        made = forecast_plates(layout, out, overwrite=job.overwrite)
    else:
        with sink.progress("writing", "plates") as update:
            made = write_plates(layout, out, overwrite=job.overwrite, on_progress=update)
    sink.document({"out": out, **asdict(made)})
    if made.removed:
        removed = "would remove" if job.dry_run else "removed"
        sink.info(f"{removed} plates of the export that was there before: {', '.join(made.removed)}")
    rows = [
        (plate.file, plate.objects, f"{plate.share:.0%}", bytes_text(plate.bytes)) for plate in made.plates
    ]
    sink.table(("plate", "objects", "needed of the plate", "size"), rows)
    kept = _kept(sum(plate.state == "kept" for plate in made.plates))
    placed, plates = counted(len(made.objects), "objects"), counted(len(made.plates), "plates")
    sink.line(
        f"{verb} {placed} on {plates} of {spec.text} to {out} (no packing needs fewer than "
        f"{made.least_plates}){kept}; {ending}"
    )
    return made.failed


def _kept(count: int) -> str:
    return f"; {count:,} {'was' if count == 1 else 'were'} there already" if count else ""
