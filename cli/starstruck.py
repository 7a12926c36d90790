"""``starstruck``: make, check and inspect data sets of scenes of stars among other objects."""

from __future__ import annotations

from functools import partial

import typer

import starstruck_gen
from cli import contents, options, output, runs
from cli.application import EXIT_FAILED, command, new_app, run as run_app
from starstruck_gen.kind import KIND
from starstruck_gen.scene_options import SceneOptions, scene_counts
from tactile_toolkit import catalog, checked_fields, run

app = new_app(
    "starstruck", "Starstruck: scenes of stars among other objects, as validated data sets of meshes."
)


@command(app)
def generate(
    *,
    split: str = checked_fields.choice("all", ("train", "test", "all"), help="Split to make."),
    out: str = options.out_folder("starstruck-data"),
    scenes: tuple[tuple[str, int], ...] | None = checked_fields.text(
        metavar="N|train=N,test=N",
        read=scene_counts,
        help="Scenes of each split instead of the published 3,000 and 300.",
    ),
    scene: SceneOptions,
    seed: int = checked_fields.integer(0, help="Random seed."),
    limit: int | None = catalog.row_option("limit"),
    run_options: options.GenerateOptions,
    sink: output.Sink,
) -> None:
    """Make a data set of scenes.

    Example: starstruck generate --stars 1-5 --scenes 10000 --out scenes

    After an interruption, the same command continues; finished shards are kept.
    """
    from starstruck_gen import sampling, scene_dataset  # numpy and pyarrow

    spec = starstruck_gen.SceneSetSpec(scene.spec(), scenes or scene_dataset.PUBLISHED_SIZES, seed, limit)
    splits = KIND.splits if split == "all" else (split,)
    if scene.collision == "exact" and not run_options.dry_run:
        # Outlines are measured by manifold3d: 5.9 s of processor time with one thread, 7.1 s with its own
        # ones. Circles do without it, and would only pay for the 0.1 s that the setting costs.
        run.prepare_batch_process()
    # Tried before anything is made or forecast, as it may take minutes.
    with sink.progress("trying the fullest scene", "failed layouts") as on_failure:
        require = partial(sampling.require_feasible, spec.scene, spec.seed, on_failure)
        generator = starstruck_gen.SceneGenerator(spec)
        runs.generate_set(sink, "making scenes", generator, out, splits, run_options, require)


@command(app)
def validate(
    *,
    name: str = options.NAME,
    source_options: options.SourceOptions,
    split: str | None = catalog.row_option("split"),
    limit: int | None = catalog.row_option("limit"),
    workers: int = options.WORKERS,
    sink: output.Sink,
) -> None:
    """Check that the objects of each scene are solids that do not overlap, and count its stars.

    `tactile verify --content` checks the files of a data set as well.

    Example: starstruck validate scenes

    Exit code 1 if a scene is not valid.
    """
    source = source_options.open_source(sink, name)
    results = contents.print_content(sink, KIND, [source], split, limit, workers)
    sink.document(results)
    if any(result["failed"] for result in results):
        raise typer.Exit(EXIT_FAILED)


main = partial(run_app, app)
