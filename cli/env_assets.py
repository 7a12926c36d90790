"""``env-assets``: the wrench, folders of assets, and the list of environments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from functools import partial
from pathlib import Path

import env_assets
from cli import application, checks, contents, exports, options, output, sets
from env_assets import WrenchSpec
from env_assets.wrench.kind import KIND
from tactile_toolkit import checked_fields, kind, mesh
from tactile_toolkit.wording import with_count

# Imported when it is called: it registers the environments, and imports numpy.
_environment_ids = kind.lazy("tactile_envs:ids")

app = application.new_app("env-assets", "Assets of environments: the wrench, and the list of environments.")


@application.command(app)
def wrench(
    *,
    spec: WrenchSpec,
    out: Path = options.local_out_folder("wrench-data"),
    stl: Path | None = checked_fields.text(
        metavar="FILE",
        read=options.local_place,
        help="Also write the mesh for a printer: .stl, .3mf, .ply, .obj, .glb.",
    ),
    overwrite: bool = options.OVERWRITE,
    dry_run: bool = options.DRY_RUN,
    sink: output.Sink,
) -> None:
    """Make a printable open-end wrench, as a data set of one row.

    Example: env-assets wrench --opening-mm 13 --out assets/wrench --stl wrench.stl
    """
    if stl is not None:
        _ = mesh.MeshFile(stl).ending  # refused before anything is written
        stl.is_file()  # raises OSError for a name that the system refuses, before anything is made
    report = mesh.inspect(env_assets.wrench_mesh(spec))
    if not dry_run:
        env_assets.write_wrench(spec, str(out), mesh_file=stl, overwrite=overwrite)
    mesh_file = None
    if stl is not None:
        mesh_file = str(stl)
    places = {"folder": str(out), "mesh_file": mesh_file, "written": not dry_run}
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
    sink.line(f"would be written to {files}; nothing was written" if dry_run else f"written to {files}")


@application.command(app, name="list")
def list_environments(
    *,
    words: list[str] | None = options.argument(
        "WORD...", "Only ids with all of these words, such as ABCVolume DR.", several=True, default=None
    ),
    sink: output.Sink,
) -> None:
    """List the ids of environments, with a description of each.

    Example: env-assets list Minecraft
    """
    found = _environment_ids(*words or ())
    sink.document([asdict(each) for each in found])
    names = [field.name for field in fields(found[0])]
    sink.table(names, [[_shown(getattr(each, name)) for name in names] for each in found])
    sink.line(f"{with_count(len(found), 'environments')}; the name for gymnasium.make is `tactile_envs/ID`")
    for assets in dict.fromkeys(each.assets for each in found):
        if assets in env_assets.THIRD_PARTY_ASSETS:
            sink.line(f"{assets}: give `assets`, a folder of meshes; {env_assets.THIRD_PARTY_ASSETS[assets]}")


def _shown(value: object) -> object:
    """Return parts of an observation or an action with their shapes as text, other values as they are."""
    if not isinstance(value, Mapping):
        return value
    return " ".join(f"{name}{list(shape)}" for name, shape in value.items())


for _shared in (
    exports.export,
    checks.verify,
    sets.merge,
    sets.split,
    contents.show,
    sets.cache,
):
    application.command(app, kind=KIND, checks=None, objects=checks.Objects())(_shared)

main = partial(application.run, app)
