"""``starstruck``: make, check and inspect data sets of scenes of stars among other objects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import starstruck_gen
from cli import checks, options, output, pictures, runs, shared
from cli.application import command, new_app, run as run_app
from starstruck_gen.kind import KIND
from starstruck_gen.scene_options import SceneOptions, ScenePreviewSpec, scene_counts
from tactile_toolkit import catalog, checked_fields, mesh, places, run, store
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind

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
    limit: int | None = catalog.LIMIT,
    making: options.Making,
    sink: output.Sink,
) -> None:
    """Make a data set of scenes.

    Example: starstruck generate --stars 1-5 --scenes 10000 --out scenes

    After an interruption, the same command continues; finished shards are kept.
    """
    spec = starstruck_gen.SceneSetSpec(scene.spec(), scenes or starstruck_gen.PUBLISHED_SIZES, seed, limit)
    splits = {"all": starstruck_gen.SPLITS}.get(split, (split,))
    if scene.collision == "exact" and not making.dry_run:
        # Outlines are measured by manifold3d: 5.9 s of processor time with one thread, 7.1 s with its own
        # ones. Circles do without it, and would only pay for the 0.1 s that the setting costs.
        run.prepare_batch_process()
    # Tried before anything is made or forecast, as it may take minutes.
    with sink.progress("trying the fullest scene", "failed layouts") as on_failure:
        require = partial(starstruck_gen.require_feasible, spec.scene, spec.seed, on_failure)
        rows = starstruck_gen.SceneGenerator(spec)
        runs.generate_set(sink, "making scenes", rows, out, splits, making, _print_made, require)


def _print_made(
    sink: output.Sink, kind: DatasetKind, manifest: store.Manifest, out: str, elapsed_s: float | None
) -> None:
    splits = [{"split": split, **counts} for split, counts in manifest.split_table().items()]
    runs.print_set(sink, kind, manifest, out, elapsed_s, splits=splits)


def _check(
    paths: Sequence[str],
    split: str | None,
    limit: int | None,
    workers: int,
    *,
    opened: Callable[[str], places.Place],
    unit: str | None = None,
    profile: mesh.PrintProfile | None = None,
    on_progress: Callable[[int, int], None],
) -> list[starstruck_gen.CheckedScenes]:
    mesh.refuse_unit(unit, paths[0])
    if profile is not None:
        raise InputError(
            "applies to objects that are printed, not to scenes", next="leave it out", field="nozzle_mm"
        )
    return [
        starstruck_gen.validate_folder(opened(path), split, limit, workers, on_progress=on_progress)
        for path in paths
    ]


_CHECKS = checks.Geometry("scenes", _check)


def _preview(
    *,
    path: str = options.argument("DIR|FILE", "Data set folder, or Parquet file of scenes."),
    opening: options.Opening,
    spec: ScenePreviewSpec,
    pictures: pictures.Pictures,
    sink: output.Sink,
) -> None:
    """Write pictures of scenes as PNG, without a screen: a sheet of each split.

    Examples: starstruck preview scenes;  starstruck preview scenes --ids 17 --out scene.png
    """
    pictures.write(sink, KIND.plan_previews(opening.open(sink, path), spec))


shared.add_shared(app, KIND, {"preview": _preview}, print_made=_print_made, checks=_CHECKS)

main = partial(run_app, app)
