"""``env-assets``: the wrench, folders of assets, and the published environments."""

from __future__ import annotations

from functools import partial
from importlib.metadata import version
from pathlib import Path

import env_assets
from cli.application import command, new_app, run
from cli.checks import Objects, verify
from cli.contents import show
from cli.exports import export
from cli.merge_and_split import merge, split
from cli.options import DRY_RUN, OVERWRITE, argument, local_out_folder, local_place
from cli.output import Sink
from cli.upkeep import cache
from env_assets import WrenchSpec
from env_assets.wrench.kind import KIND
from tactile_toolkit import mesh
from tactile_toolkit.checked_fields import text
from tactile_toolkit.wording import with_count

_WRITTEN = {False: "written to {}", True: "would be written to {}; nothing was written"}

app = new_app("env-assets", "Assets of environments: the wrench, and the published environments.")


@command(app)
def wrench(
    *,
    spec: WrenchSpec,
    out: Path = local_out_folder("wrench-data"),
    stl: Path | None = text(
        metavar="FILE",
        read=local_place,
        help="Also write the mesh for a printer: .stl, .3mf, .ply, .obj, .glb.",
    ),
    overwrite: bool = OVERWRITE,
    dry_run: bool = DRY_RUN,
    sink: Sink,
) -> None:
    """Make a printable open-end wrench, as a data set of one row.

    Example: env-assets wrench --opening-mm 13 --out assets/wrench --stl wrench.stl
    """
    if stl is not None:
        mesh.file_ending(stl)
        stl.is_file()  # raises OSError for a name that the system refuses, before anything is made
    report = mesh.inspect(env_assets.wrench_mesh(spec))
    if not dry_run:
        env_assets.write_wrench(spec, str(out), mesh_file=stl, overwrite=overwrite)
    places = {"folder": str(out), "mesh_file": stl and str(stl), "written": not dry_run}
    sink.document({**places, **env_assets.wrench_facts(spec, report)})
    openings = f"{spec.opening_mm:g} and {spec.second_opening_mm:g}"
    sides = " x ".join(f"{side:.1f}" for side in report.size_mm)
    sink.line(
        f"wrench for {openings} mm across flats: {sides} mm, {report.mass_g:.1f} g of PLA, "
        f"thinnest wall {report.thinnest_wall_mm:.1f} mm, {report.faces:,} triangles"
    )
    for warning in report.warnings:
        sink.line(f"warning: {warning}")
    files = " and ".join(map(str, filter(None, (out, stl))))
    sink.line(_WRITTEN[dry_run].format(files))


@command(app, name="list")
def list_environments(
    *,
    words: list[str] | None = argument(
        "WORD...", "Only ids with all of these words, such as ABCVolume DR.", several=True, default=None
    ),
    sink: Sink,
) -> None:
    """List the published environments, and what each needs to run here.

    Example: env-assets list Minecraft
    """
    # Imported here: it registers the environments, and imports numpy.
    import tactile_envs

    found = [{**each, "native": each["id"] in tactile_envs.IDS} for each in env_assets.overview(words or ())]
    sink.document(found)
    columns = ("task", "split", "sensor", "assets", "state", "native")
    sink.table(("environment", *columns), [[each[name] for name in ("id", *columns)] for each in found])
    sink.line(f"{with_count(len(found), 'environments')} of tactile-mnist {version('tactile-mnist')}")
    for note in dict.fromkeys(each["note"] for each in found if each["note"]):
        sink.line(note)
    if any(each["native"] for each in found):
        sink.line("native: `tactile_envs:ID` runs the same episodes without OpenGL, many times faster")


for _shared in (export, verify, merge, split, show, cache):
    command(app, kind=KIND, checks=None, objects=Objects())(_shared)

main = partial(run, app)
