"""``starstruck``: make, check and look into data sets of scenes of stars among other objects."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from cli.application import EXIT_FAILED, command, new_app, run
from cli.copies import manifest_or_copy
from cli.export_commands import add_export
from cli.folders import add_verify, least_to_most, print_made, print_spec
from cli.gallery_commands import add_mesh_gallery
from cli.hub_upload import add_hub_commands
from cli.making import make_with_progress, print_conclusion, print_forecast
from cli.options import Folder, Json, Limit, Making, Out, Seed, Workers, place_of_data, process_count
from cli.output import Sink, bytes_text, counted
from cli.preview_commands import preview_scenes
from cli.scene_options import SceneOptions, split_sizes
from cli.touch_tables import print_converted
from starstruck_gen.kind import KIND
from tactile_toolkit.kind import is_export

if TYPE_CHECKING:
    from tactile_toolkit.store.manifest import Manifest

__all__ = ["app", "main"]

_TRIAL_INTERVAL_S = 2.0

app = new_app(
    "starstruck", "Starstruck: scenes of stars among other objects, as validated data sets of meshes."
)

SceneSplit = Literal["train", "test", "all"]


@command(app)
def generate(
    *,
    split: Annotated[SceneSplit, typer.Option(help="Split to make.")] = "all",
    out: Out = "starstruck-data",
    scenes: Annotated[
        str | None,
        typer.Option(
            metavar="N|train=N,test=N", help="Scenes of each split instead of the published 3,000 and 300."
        ),
    ] = None,
    scene: SceneOptions,
    seed: Seed = 0,
    limit: Limit = None,
    making: Making,
    sink: Sink,
) -> None:
    """Make a data set of scenes.

    Example: starstruck generate --stars 1-5 --scenes 10000 --out scenes

    A run that was stopped goes on when the same command is given again; finished shards are never made twice.
    """
    from starstruck_gen.generation import PUBLISHED_SIZES, GenerateSpec, forecast
    from starstruck_gen.generation import generate as make
    from starstruck_gen.streams import SPLITS
    from tactile_toolkit.run.limits import limit_threads

    sizes = PUBLISHED_SIZES if scenes is None else split_sizes(scenes)
    spec = GenerateSpec(scene.spec(), sizes, seed, limit)
    splits = SPLITS if split == "all" else (split,)
    # A forecast tries the fullest scene, too.
    on_failure = trial_reporter(sink)
    if making.dry_run:
        view = forecast(
            spec, out, splits, making.chosen_runner(), overwrite=making.overwrite, on_failure=on_failure
        )
        print_forecast(sink, KIND, view, out, making)
        return
    if scene.collision == "exact":
        # Outlines are measured by manifold3d: 5.9 s of processor time with one thread, 7.1 s with its own
        # ones. Circles do without it, and would only pay for the 0.1 s that the setting costs.
        limit_threads()
    make_scenes = partial(make, spec, out, splits, on_failure=on_failure)
    made = make_with_progress(sink, "making scenes", KIND.nouns, make_scenes, making, out)
    if made is not None:
        _print_made(sink, made.manifest, out, made.elapsed_s)
        print_conclusion(sink, KIND, made, out, splits)


@command(app)
def validate(
    *,
    paths: Annotated[
        list[str],
        typer.Argument(
            parser=place_of_data, metavar="DIR|FILE...", help="Data set folders, or Parquet files of scenes."
        ),
    ],
    split: Annotated[SceneSplit, typer.Option(help="Split of a data set folder.")] = "all",
    limit: Limit = None,
    workers: Workers = 1,
    sink: Sink,
) -> None:
    """Prove scenes as read back from disk: solids that never overlap, and as many stars as the label says.

    Example: starstruck validate scenes --workers 0

    Exit code 1 when a scene breaks a promise.
    """
    from starstruck_gen.validate import validate_folder

    chosen = None if split == "all" else split
    count = process_count(workers)
    with sink.progress("checking", "scenes") as update:
        results = [validate_folder(path, chosen, limit, count, on_progress=update) for path in paths]
    sink.document([result.to_dict() for result in results])
    # The table has the scenes that failed, so of a set that is fine it would be its title alone.
    for result in results:
        if result.failed:
            sink.table(*result.table())
    failed = sum(result.failed for result in results)
    checked = sum(result.checked for result in results)
    bodies = sum(result.bodies for result in results)
    stars = sum(result.stars for result in results)
    declared = any(result.declared for result in results)
    are = "scene is" if checked == 1 else "scenes are"
    which = f", {stars:,} of them stars" if declared else "; which of them are stars is not declared"
    sink.line(f"{checked - failed:,} of {checked:,} {are} valid: {counted(bodies, 'solids')}{which}")
    if failed:
        raise typer.Exit(EXIT_FAILED)


@command(app)
def info(folder: Folder, as_json: Json = False) -> None:
    """Show what a data set folder holds, how it was made, and how hard it was to place objects."""
    from starstruck_gen.summary import summarise

    sink = Sink(as_json)
    manifest = manifest_or_copy(sink, KIND, folder)
    if manifest is None:
        return
    if is_export(manifest):
        print_converted(sink, manifest, folder, KIND.nouns)
        return
    _print_made(sink, manifest, folder)
    for summary in summarise(manifest):
        counts = summary.acceptance
        rows = [
            (number, placed, tried, f"{tried / placed:.3f}")
            for number, (placed, tried) in enumerate(
                zip(counts.objects, counts.attempts, strict=True), start=1
            )
            if placed
        ]
        header = ("object", "placed", "positions drawn", "per object")
        sink.table(header, rows, f"{summary.split}: positions drawn by object of a scene")
    print_spec(sink, manifest, "spec")


def _print_made(sink: Sink, manifest: Manifest, out: str, elapsed_s: float | None = None) -> None:
    from starstruck_gen.summary import summarise

    summaries = summarise(manifest)
    rows = [
        (
            summary.split,
            summary.rows,
            least_to_most(summary.acceptance.classes),
            bytes_text(summary.bytes),
            round(summary.bytes_per_scene),
            f"{100 * summary.acceptance.accepted:.1f} %",
            summary.acceptance.restarts,
        )
        for summary in summaries
    ]
    header = ("split", "scenes", "per class", "Parquet", "bytes per scene", "accepted", "started over")
    splits = [summary.to_dict() for summary in summaries]
    print_made(sink, KIND, manifest, out, splits, elapsed_s, (header, rows))


def trial_reporter(sink: Sink) -> Callable[[int, int], None]:
    """Return a function that takes each layout that failed, and says so every few seconds.

    It is tried whether the fullest scene has room before anything is made, which may take minutes.
    """
    last_s = time.monotonic()

    def report(failed: int, allowed: int) -> None:
        nonlocal last_s
        now_s = time.monotonic()
        if now_s - last_s >= _TRIAL_INTERVAL_S:
            last_s = now_s
            sink.talk(f"trying whether the fullest scene has room: {failed:,} of {allowed:,} layouts failed")

    return report


add_verify(app, KIND, "a data set folder")
command(app, "preview")(preview_scenes)
add_hub_commands(app, KIND)
add_mesh_gallery(app, KIND)
add_export(app, KIND)


def main() -> None:
    """Run the command line."""
    run(app)
