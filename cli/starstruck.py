"""``starstruck``: make, check and look into data sets of scenes of stars among other objects."""

from __future__ import annotations

import os
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.application import new_app, run
from cli.card_commands import add_card
from cli.copies import print_copy
from cli.export_commands import add_export
from cli.failures import EXIT_FAILED, reports_errors
from cli.gallery_commands import add_mesh_gallery
from cli.hub_download import add_download
from cli.hub_upload import add_upload
from cli.making import make_with_progress, print_forecast
from cli.options import DryRun, Folder, Json, Limit, Out, Overwrite, Quiet, Seed, Workers
from cli.output import Sink, flat_lines
from cli.preview_commands import preview_scenes
from cli.scene_options import CollisionName, scene_spec, split_sizes
from cli.scene_room import tells_of_failures
from cli.scene_tables import print_acceptance, print_made
from cli.verification import verify_folder
from starstruck_gen.kind import KIND

if TYPE_CHECKING:
    from starstruck_gen.generation import GenerateSpec

__all__ = ["app", "main"]

app = new_app(
    "starstruck", "Starstruck: scenes of stars among other objects, as validated data sets of meshes."
)


class SplitName(StrEnum):
    """Splits of Starstruck on the command line."""

    train = "train"
    test = "test"
    all = "all"


@app.command()
@reports_errors
def generate(
    split: Annotated[SplitName, typer.Option(help="Split to make.")] = SplitName.all,
    out: Out = Path("starstruck-data"),
    scenes: Annotated[
        str | None,
        typer.Option(
            metavar="N|train=N,test=N", help="Scenes of each split instead of the published 3,000 and 300."
        ),
    ] = None,
    stars: Annotated[
        str, typer.Option(metavar="1-3|1,2,5", help="Number of stars of each class; a class for each number.")
    ] = "1-3",
    distractors: Annotated[
        str, typer.Option(metavar="0-5", help="Least and most objects of a scene that are no stars.")
    ] = "0-5",
    star_points: Annotated[
        int | None, typer.Option(metavar="N", help="Tips of a star; 5 as published.")
    ] = None,
    star_inner_mm: Annotated[
        float | None,
        typer.Option(
            metavar="MM",
            help="Radius of a star's notches; half of --radius-mm as published, a quarter with 3 points.",
        ),
    ] = None,
    shapes: Annotated[
        str,
        typer.Option(
            metavar="box,disc",
            help="Shapes of distractors: box, disc, triangle, hexagon, ring, cross, crescent; with "
            "proportions of their own such as ring(hole_ratio=0.3).",
        ),
    ] = "box,disc",
    radius_mm: Annotated[
        float, typer.Option(metavar="MM", help="Radius of the circle around every object.")
    ] = 10.0,
    heights_mm: Annotated[
        str, typer.Option(metavar="5|4,6", help="Heights of objects, each with equal chance.")
    ] = "5",
    cell_mm: Annotated[
        str, typer.Option(metavar="120|120x120", help="Size of the cell along x and y.")
    ] = "120",
    collision: Annotated[
        CollisionName,
        typer.Option(help="What must not meet: circles around objects, or their exact outlines."),
    ] = CollisionName.circles,
    clearance_mm: Annotated[
        float, typer.Option(metavar="MM", help="Least distance kept between those.")
    ] = 0.0,
    seed: Seed = 0,
    limit: Limit = None,
    workers: Workers = 0,
    overwrite: Overwrite = False,
    dry_run: DryRun = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make a data set of scenes.

    Example: starstruck generate --stars 1-5 --scenes 10000 --out scenes

    A run that was stopped goes on when the same command is given again; finished shards are never made twice.
    """
    from starstruck_gen.generation import PUBLISHED_SIZES, GenerateSpec
    from starstruck_gen.streams import SPLITS

    scene = scene_spec(
        stars,
        distractors,
        star_points,
        star_inner_mm,
        shapes,
        radius_mm,
        heights_mm,
        cell_mm,
        collision,
        clearance_mm,
    )
    sizes = PUBLISHED_SIZES if scenes is None else split_sizes(scenes)
    spec = GenerateSpec(scene, sizes, seed, limit)
    splits = SPLITS if split is SplitName.all else (split.value,)
    sink = Sink(as_json, quiet)
    count = workers or os.cpu_count() or 1
    if dry_run:
        from starstruck_gen.generation import forecast

        view = forecast(
            spec, str(out), splits, count, overwrite=overwrite, on_failure=tells_of_failures(sink)
        )
        print_forecast(sink, view, "scenes", out, count)
    else:
        _run_generate(sink, spec, out, splits, count, overwrite)


@app.command()
@reports_errors
def validate(
    paths: Annotated[
        list[Path],
        typer.Argument(metavar="DIR|FILE...", help="Data set folders, or Parquet files of scenes."),
    ],
    split: Annotated[SplitName, typer.Option(help="Split of a data set folder.")] = SplitName.all,
    limit: Limit = None,
    workers: Workers = 1,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Prove scenes as read back from disk: solids that never overlap, and as many stars as the label says.

    Example: starstruck validate scenes --workers 0

    Exit code 1 when a scene breaks a promise.
    """
    from starstruck_gen.validate import validate_folder

    sink = Sink(as_json, quiet)
    chosen = None if split is SplitName.all else split.value
    count = workers or os.cpu_count() or 1
    with sink.progress("checking", "scenes") as update:
        results = [validate_folder(str(path), chosen, limit, count, on_progress=update) for path in paths]
    sink.document([result.to_dict() for result in results])
    for result in results:
        if result.failed:
            sink.table(*result.table())
    failed = sum(result.failed for result in results)
    checked = sum(result.checked for result in results)
    bodies = sum(result.bodies for result in results)
    stars = sum(result.stars for result in results)
    declared = any(result.declared for result in results)
    which = f", {stars:,} of them stars" if declared else "; which of them are stars is not declared"
    sink.line(f"{checked - failed:,} of {checked:,} scenes are valid: {bodies:,} solids{which}")
    if failed:
        raise typer.Exit(EXIT_FAILED)


@app.command()
@reports_errors
def info(folder: Folder, as_json: Json = False) -> None:
    """Show what a data set folder holds, how it was made, and how hard it was to place objects."""
    from tactile_toolkit.store.folder import DataFolder
    from tactile_toolkit.store.manifest import manifest_so_far

    manifest = manifest_so_far(DataFolder(str(folder)))
    sink = Sink(as_json)
    if manifest is None:
        print_copy(sink, folder, KIND)
        return
    KIND.refuse_other(manifest, str(folder))
    print_made(sink, manifest, folder)
    print_acceptance(sink, manifest)
    sink.line(f"made by tactile-toolkit {manifest.toolkit_version}; spec:")
    for line in flat_lines(manifest.spec):
        sink.line(f"  {line}")


@app.command()
@reports_errors
def verify(folder: Folder, as_json: Json = False, quiet: Quiet = False) -> None:
    """Check every checksum, row count, schema and id of a data set folder.

    Exit code 3 when something is damaged; each damaged file is named.
    """
    verify_folder(Sink(as_json, quiet), str(folder), KIND)


app.command("preview")(preview_scenes)
add_card(app, KIND)
add_upload(app, KIND)
add_download(app, KIND)
add_mesh_gallery(app, KIND)
add_export(app, KIND)


def main() -> None:
    """Run the command line."""
    run(app)


def _run_generate(
    sink: Sink, spec: GenerateSpec, out: Path, splits: tuple[str, ...], workers: int, overwrite: bool
) -> None:
    from starstruck_gen.generation import generate as make
    from tactile_toolkit.run.worker import stay_on_one_core
    from tactile_toolkit.store.folder import DataFolder
    from tactile_toolkit.store.manifest import manifest_so_far

    if spec.scene.collision == CollisionName.exact:
        # Outlines are measured by manifold3d: 5.9 s of processor time with one thread, 7.1 s with its own
        # ones. Circles do without it, and would only pay for the 0.1 s that the setting costs.
        stay_on_one_core()
    made = make_with_progress(
        sink,
        "making scenes",
        "scenes",
        lambda tell: make(
            spec,
            str(out),
            splits,
            workers=workers,
            overwrite=overwrite,
            on_progress=tell,
            on_failure=tells_of_failures(sink),
        ),
    )
    # Another split may be unfinished: what is finished of it stays and is told, as `info` tells it.
    print_made(sink, manifest_so_far(DataFolder(str(out))) or made.manifest, out, made.elapsed_s)
    sink.line(made.sentence("scenes", out))
    sink.line(
        f"next: starstruck validate {out}   or in Python: "
        f"starstruck_gen.load({str(out)!r}, split={made.manifest.splits[0]!r})"
    )
