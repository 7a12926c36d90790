"""The command that writes files for printers, simulators and other libraries."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from cli import application, options, output, runs
from tactile_toolkit import catalog, exchange, printing, store
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.wording import with_count


def export(
    *,
    kind: DatasetKind,
    name: str = options.ANY_SET,
    opening: options.Opening,
    form: printing.ExportOptions,
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
    place = opening.open(sink, name).require(kind, "export")
    if form.file_format == "flat":
        _export_flat(sink, kind, exchange.plan_tables(kind, place, chosen, str(out)), str(out), job)
        return
    filters = chosen.given()
    report = printing.export(
        catalog.open_splits(place, filters.pop("split"), kind.load, kind.nouns).items(),
        filters,
        str(out),
        form,
        distances,
        material,
        sink.progress,
        overwrite=job.overwrite,
        dry_run=job.dry_run,
        workers=options.process_count(job.workers),
    )
    sink.document({"out": str(out), **report.document})
    if report.removed:
        removed = "would remove" if job.dry_run else "removed"
        sink.info(f"{removed} plates of an earlier export: {', '.join(report.removed)}")
    sink.table(report.header, report.rows)
    if report.line:
        sink.line(report.line)
    for failure in report.failed:
        sink.warn(f"failed: {failure.name}: {failure.detail}")
    if report.failed:
        raise typer.Exit(application.EXIT_FAILED)


def _export_flat(
    sink: output.Sink, kind: DatasetKind, plan: store.BuildPlan, out: str, job: options.Job
) -> None:
    if job.dry_run:
        if not job.overwrite:
            plan.compared_with(store.open_folder(out))
        rows = sum(task.size for task in plan.tasks)
        sink.document({"folder": out, "rows": rows})
        sink.line(f"would write {with_count(rows, kind.nouns)} to {out}; nothing was written")
        return
    make = partial(store.build, store.open_folder(out), plan, write_card=kind.write_card)
    work = options.Work(job.workers, overwrite=job.overwrite)
    runs.make_with_progress(sink, "writing", kind, make, work, out, runs.print_set)
