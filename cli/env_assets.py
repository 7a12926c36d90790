"""``env-assets``: the wrench, an object of environments."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import env_assets
from cli import application, options, output
from env_assets import WrenchSpec
from tactile_toolkit import mesh
from tactile_toolkit.kind import lazy

_wrench_facts = lazy("env_assets.wrench.dataset:wrench_facts")
app = application.new_app("env-assets", "Assets of environments: the wrench.")


@application.command(app)
def wrench(
    *,
    spec: WrenchSpec,
    out: Path = options.local_out_folder("wrench-data"),
    overwrite: bool = options.OVERWRITE,
    dry_run: bool = options.DRY_RUN,
    sink: output.Sink,
) -> None:
    """Make a printable open-end wrench, as a data set of one row.

    Example: env-assets wrench --opening-mm 13 --out assets/wrench
    """
    report = mesh.PrintReport.of(env_assets.wrench_mesh(spec))
    if not dry_run:
        env_assets.write_wrench(spec, str(out), overwrite=overwrite)
    sink.document({"folder": str(out), "written": not dry_run, **_wrench_facts(spec, report)})
    openings = f"{spec.opening_mm:g} and {spec.second_opening_mm:g}"
    sides = " x ".join(f"{side:.1f}" for side in report.size_mm)
    sink.line(
        f"wrench for {openings} mm across flats: {sides} mm, {report.mass_g:.1f} g of PLA, "
        f"thinnest wall {report.thinnest_wall_mm:.1f} mm, {report.faces:,} triangles"
    )
    for warning in report.warnings:
        sink.line(f"warning: {warning}")
    sink.line(f"would be written to {out}; nothing was written" if dry_run else f"written to {out}")
    if not dry_run:
        sink.line(f"next: tactile export {out} --format 3mf")


main = partial(application.run, app)
