"""``starstruck``: make, check and look into data sets of scenes of stars among other objects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from cli.application import command, new_app, run
from cli.folders import Geometry
from cli.making import generate_set, least_to_most, print_set
from cli.options import Making, Opening, argument, out_folder
from cli.output import Sink
from cli.products import Pictures
from cli.shared import add_shared
from starstruck_gen.kind import KIND
from starstruck_gen.scene_options import SceneOptions, ScenePreviewSpec, scene_counts
from tactile_toolkit import catalog, mesh, places, store
from tactile_toolkit.checked_fields import choice, integer, text
from tactile_toolkit.kind import DatasetKind

if TYPE_CHECKING:
    from starstruck_gen.scene_checks import CheckedScenes


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
    limit: int | None = catalog.LIMIT,
    making: Making,
    sink: Sink,
) -> None:
    """Make a data set of scenes.

    Example: starstruck generate --stars 1-5 --scenes 10000 --out scenes

    After an interruption, the same command continues; finished shards are kept.
    """
    from starstruck_gen.rejection import require_feasible
    from starstruck_gen.scene_generation import PUBLISHED_SIZES, SceneMaking, SceneSetSpec
    from starstruck_gen.scene_seeds import SPLITS
    from tactile_toolkit.run import limit_threads

    spec = SceneSetSpec(scene.spec(), scenes or PUBLISHED_SIZES, seed, limit)
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


def _print_made(
    sink: Sink, kind: DatasetKind, manifest: store.Manifest, out: str, elapsed_s: float | None
) -> None:
    from starstruck_gen.scene_card import summarise

    found = summarise(manifest)
    rows = [
        (split, least_to_most(each.classes), f"{each.accepted:.1%}", each.restarts)
        for split, each in found.items()
    ]
    splits = [
        {"split": split, **counts, "acceptance": found[split].to_dict()}
        for split, counts in manifest.split_table().items()
    ]
    header = ("split", "per class", "accepted", "started over")
    print_set(sink, kind, manifest, out, elapsed_s, header, rows, splits=splits)


def _check(
    paths: Sequence[str],
    *options: Any,
    opened: Callable[[str], places.Place],
    unit: str | None = None,
    on_progress: Callable[[int, int], None],
) -> list[CheckedScenes]:
    from starstruck_gen.scene_checks import validate_folder

    mesh.refuse_unit(unit, paths[0])
    return [validate_folder(opened(path), *options, on_progress=on_progress) for path in paths]


_CHECKS = Geometry("scenes", _check)


def _preview(
    *,
    path: str = argument("DIR|FILE", "Data set folder, or Parquet file of scenes."),
    opening: Opening,
    spec: ScenePreviewSpec,
    pictures: Pictures,
    sink: Sink,
) -> None:
    """Write pictures of scenes as PNG, without a screen: a sheet of each split.

    Examples: starstruck preview scenes;  starstruck preview scenes --ids 17 --out scene.png
    """
    from starstruck_gen.scene_previews import plan_previews

    pictures.write(sink, plan_previews(opening.open(sink, path), spec))


add_shared(app, KIND, {"preview": _preview}, print_made=_print_made, checks=_CHECKS)

main = partial(run, app)
