"""``env-assets``: what environments consume."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.application import command, new_app, run
from cli.folders import add_verify
from cli.options import DryRun, Json, Out, Overwrite
from cli.output import Sink
from env_assets.wrench.kind import KIND

if TYPE_CHECKING:
    from env_assets.wrench.card import WrenchFacts

__all__ = ["app", "main"]

app = new_app("env-assets", "Assets of environments: the wrench, and what a folder of assets holds.")

Length = Annotated[float | None, typer.Option(metavar="MM", help="Instead of the usual proportion.")]


@command(app)
def wrench(
    *,
    size: Annotated[
        str, typer.Option(metavar="MM|M8", help="Nut of the first jaw: width across flats, or its thread.")
    ] = "13",
    second_size: Annotated[
        str | None,
        typer.Option(metavar="MM|M6", help="Nut of the second jaw instead of the next smaller one."),
    ] = None,
    single: Annotated[bool, typer.Option("--single", help="Make no second jaw.")] = False,
    length_mm: Annotated[
        float | None,
        typer.Option(
            metavar="MM",
            help="Between the outermost points of the circles of both ends; jaws cut into those, so that the "
            "solid is a little shorter.",
        ),
    ] = None,
    thickness_mm: Length = None,
    handle_mm: Length = None,
    jaw_angle_deg: Annotated[
        float, typer.Option(metavar="DEGREES", help="Between the handle and the jaws.")
    ] = 15.0,
    clearance_mm: Annotated[
        float, typer.Option(metavar="MM", help="What a jaw is wider than its nut.")
    ] = 0.2,
    chamfer_mm: Annotated[float, typer.Option(metavar="MM", help="Slope around top and bottom.")] = 0.6,
    out: Out = Path("wrench-data"),
    stl: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the mesh for a printer, too: .stl, .3mf, .ply, .obj, .glb."),
    ] = None,
    overwrite: Overwrite = False,
    dry_run: DryRun = False,
    sink: Sink,
) -> None:
    """Make a printable open-end wrench, as a data set of one row.

    Example: env-assets wrench --size 13 --out assets/wrench --stl wrench.stl
    """
    from env_assets.wrench.card import wrench_facts
    from env_assets.wrench.generation import mesh_file_at, write_wrench
    from env_assets.wrench.spec import WrenchSpec

    stl = None if stl is None else mesh_file_at(stl)
    asked = {"length_mm": length_mm, "thickness_mm": thickness_mm, "handle_mm": handle_mm}
    lengths = {name: value for name, value in asked.items() if value is not None}
    spec = WrenchSpec.for_size(
        size,
        second_size,
        single=single,
        jaw_angle_deg=jaw_angle_deg,
        clearance_mm=clearance_mm,
        chamfer_mm=chamfer_mm,
        **lengths,
    )
    facts = wrench_facts(spec)
    if not dry_run:
        write_wrench(spec, str(out), mesh_file=stl, overwrite=overwrite)
    _print_wrench(sink, facts, out, stl, written=not dry_run)


@command(app)
def info(
    root: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of an AssetProvider.")] = Path(
        "tactile-assets"
    ),
    as_json: Json = False,
) -> None:
    """Show which data sets a folder of assets holds, and how large their meshes are.

    Example: env-assets info assets
    """
    from env_assets.inventory import inventory

    summaries = inventory(root)
    sink = Sink(as_json)
    sink.document([summary.to_dict() for summary in summaries])
    if not summaries:
        sink.line(f"{root} holds no data sets")
    header = ("name", "split", "kind", "rows", "classes", "largest mm", "volume mm^3")
    rows = [
        (
            summary.name,
            summary.split,
            summary.kind or "-",
            summary.rows,
            " ".join(summary.classes) or "-",
            " x ".join(f"{side:.1f}" for side in summary.largest_mm or ()) or "-",
            " to ".join(f"{volume:,.0f}" for volume in summary.volume_mm3 or ()) or "-",
        )
        for summary in summaries
        if summary.problem is None
    ]
    sink.table(header, rows)
    for summary in summaries:
        if summary.problem is not None:
            sink.line(f"{summary.name} {summary.split}: {summary.problem}")


add_verify(app, KIND, "the folder of a wrench")


def main() -> None:
    """Run the command line."""
    run(app)


def _print_wrench(sink: Sink, facts: WrenchFacts, out: Path, stl: Path | None, *, written: bool) -> None:
    spec, report = facts.spec, facts.report
    places = {"folder": str(out), "mesh_file": None if stl is None else str(stl), "written": written}
    sink.document({**places, **facts.to_dict()})
    second = f" and {spec.second_opening_mm:g}" if spec.second_opening_mm else ""
    size = " x ".join(f"{side:.1f}" for side in report.size_mm)
    sink.line(
        f"wrench for {spec.opening_mm:g}{second} mm across flats: {size} mm, {report.mass_g:.1f} g of PLA, "
        f"thinnest wall {report.thinnest_wall_mm:.1f} mm, {report.faces:,} triangles"
    )
    for warning in report.warnings:
        sink.line(f"warning: {warning}")
    files = f"{out}" if stl is None else f"{out} and {stl}"
    sink.line(f"written to {files}" if written else f"would be written to {files}; nothing was written")
