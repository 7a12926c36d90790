"""``starstruck``: make, check and look into data sets of scenes of stars among other objects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from cli.application import command, new_app, run
from cli.folders import Geometry, check_objects
from cli.making import generate_set, least_to_most, print_set
from cli.options import FOLDERS, LIMIT, SPLIT, WORKERS, Making, out_folder
from cli.output import Sink, bytes_text
from cli.products import preview_scenes
from cli.shared import add_shared
from starstruck_gen.kind import KIND
from starstruck_gen.options import SceneOptions, scene_counts
from tactile_toolkit.checked_fields import choice, integer, text
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.wording import counted

if TYPE_CHECKING:
    from starstruck_gen.validate import Checked
    from tactile_toolkit.store.manifest import Manifest


app = new_app(
    "starstruck", "Starstruck: scenes of stars among other objects, as validated data sets of meshes."
)


@command(app)
def generate(
    *,
    split: str = choice("all", ("train", "test", "all"), help="Split to make."),
    out: str = out_folder("starstruck-data"),
    scenes: Any = text(
        metavar="N|train=N,test=N",
        read=scene_counts,
        help="Scenes of each split instead of the published 3,000 and 300.",
    ),
    scene: SceneOptions,
    seed: int = integer(0, help="Random seed."),
    limit: int | None = LIMIT,
    making: Making,
    sink: Sink,
) -> None:
    """Make a data set of scenes.

    Example: starstruck generate --stars 1-5 --scenes 10000 --out scenes

    After an interruption, the same command continues; finished shards are kept.
    """
    from starstruck_gen.make import PUBLISHED_SIZES, GenerateSpec, SceneMaking
    from starstruck_gen.sampling import SPLITS, require_feasible
    from tactile_toolkit.run.threads import limit_threads

    spec = GenerateSpec(scene.spec(), scenes or PUBLISHED_SIZES, seed, limit)
    splits = SPLITS if split == "all" else (split,)
    if scene.collision == "exact" and not making.dry_run:
        # Outlines are measured by manifold3d: 5.9 s of processor time with one thread, 7.1 s with its own
        # ones. Circles do without it, and would only pay for the 0.1 s that the setting costs.
        limit_threads()
    # Before anything is made or forecast, which may take minutes.
    with sink.progress("trying whether the fullest scene has room", "failed layouts") as on_failure:
        require = partial(require_feasible, spec.scene, spec.seed, on_failure)
        rows = SceneMaking(spec)
        generate_set(sink, "making scenes", rows, out, splits, making, _print_made, require)


def _print_made(sink: Sink, kind: DatasetKind, manifest: Manifest, out: str, elapsed_s: float | None) -> None:
    from starstruck_gen.card import summarise

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
    print_set(sink, kind, manifest, out, elapsed_s, header, rows, splits=splits)
    for summary in summaries if elapsed_s is None else ():
        counts = zip(summary.acceptance.objects, summary.acceptance.attempts, strict=True)
        sink.table(
            ("object", "placed", "positions drawn", "per object"),
            [
                (number, placed, tried, f"{tried / placed:.3f}")
                for number, (placed, tried) in enumerate(counts, start=1)
                if placed
            ],
            f"{summary.split}: positions drawn by object of a scene",
        )


def _check(paths: Sequence[str], *options: Any, on_progress: Callable[[int, int], None]) -> list[Checked]:
    from starstruck_gen.validate import validate_folder

    return [validate_folder(path, *options, on_progress=on_progress) for path in paths]


def _print_checked(sink: Sink, results: Sequence[Checked]) -> None:
    # The table has the scenes that failed, so of a set that is fine it would be its title alone.
    for result in results:
        if result.failed:
            sink.table(*result.table())
    checked = sum(result.checked for result in results)
    valid = checked - sum(result.failed for result in results)
    stars = sum(result.stars for result in results)
    declared = any(result.declared for result in results)
    which = f", {stars:,} of them stars" if declared else "; which of them are stars is not declared"
    solids = counted(sum(result.bodies for result in results), "solids")
    sink.line(
        f"{valid:,} of {checked:,} {'scene is' if checked == 1 else 'scenes are'} valid: {solids}{which}"
    )


_CHECKS = Geometry("scenes", _check, _print_checked)


def _validate(
    *,
    paths: list[str] = FOLDERS,
    split: str | None = SPLIT,
    limit: int | None = LIMIT,
    workers: int = WORKERS,
    sink: Sink,
) -> None:
    """Check scenes as read back from disk: solids that do not overlap, and as many stars as the label states.

    Example: starstruck validate scenes

    Exit code 1 when a scene is invalid. For a folder, `verify --geometry` checks its files as well.
    """
    check_objects(sink, _CHECKS, paths, split, limit, workers)


add_shared(
    app, KIND, {"preview": preview_scenes, "validate": _validate}, print_made=_print_made, checks=_CHECKS
)

main = partial(run, app)
