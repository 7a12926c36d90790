"""``starstruck``: make, check and look into data sets of scenes of stars among other objects."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from cli.application import command, new_app, run
from cli.export_commands import add_export
from cli.folders import Geometry, add_info, add_verify, least_to_most, print_made
from cli.gallery_commands import add_mesh_gallery
from cli.hub_upload import add_hub_commands
from cli.making import generate_set
from cli.options import Limit, Making, Out
from cli.output import Sink, bytes_text, counted
from cli.preview_commands import preview_scenes
from starstruck_gen.kind import KIND
from tactile_toolkit.checked_fields import choice, integer, real, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import is_count, listed

if TYPE_CHECKING:
    from starstruck_gen.shapes import Shape
    from starstruck_gen.spec import SceneSpec
    from starstruck_gen.validate import Checked
    from tactile_toolkit.store.manifest import Manifest

__all__ = ["app", "main"]

_TRIAL_INTERVAL_S = 2.0
_BETWEEN_SHAPES = re.compile(r",(?![^(]*\))")  # a comma within brackets belongs to a shape
# Notches at half the radius, as published, are not notches any more between 3 tips.
_FEWEST_POINTS, _RATIO_OF_FEWEST = 3, 0.25

app = new_app(
    "starstruck", "Starstruck: scenes of stars among other objects, as validated data sets of meshes."
)


def _counts(words: str) -> tuple[int, ...]:
    """Read ``1-3`` or ``1,2,5``."""
    least, _, most = (part.strip() for part in words.partition("-"))
    # Bounded here, before a tuple of the range is made; what a cell has room for `SceneSpec` checks.
    if is_count(least) and is_count(most) and int(least) <= int(most) < 10_000:
        return tuple(range(int(least), int(most) + 1))
    if not all(map(is_count, listed(words))) or not listed(words):
        message = f"--stars is {words!r}; expected a range such as 1-3, or numbers such as 1,2,5"
        raise InputError(message)
    return tuple(map(int, listed(words)))


def _least_and_most(words: str) -> tuple[int, int]:
    """Read ``0-5``, ``0,5`` or ``5``."""
    parts = [part.strip() for part in words.replace("-", ",").split(",")]
    if len(parts) > 2 or not all(map(is_count, parts)):
        message = f"--distractors is {words!r}; expected the least and the most such as 0-5, or one number"
        raise InputError(message)
    return int(parts[0]), int(parts[-1])


def _lengths_m(option: str, words: str, most: int) -> tuple[float, ...]:
    """Read lengths in millimetres, separated by commas or by an x."""
    try:
        lengths_m = tuple(float(part) / 1e3 for part in words.replace("x", ",").split(","))
    except ValueError:
        lengths_m = ()
    if not 0 < len(lengths_m) <= most:
        message = f"{option} is {words!r}; expected millimetres such as 120, or up to {most} of them"
        raise InputError(message)
    return lengths_m


def _scenes(words: str) -> tuple[tuple[str, int], ...]:
    """Read ``5000`` or ``train=5000,test=500``."""
    from starstruck_gen.streams import SPLITS

    if is_count(words.strip()):
        return tuple((split, int(words)) for split in SPLITS)
    pairs = [tuple(piece.strip() for piece in part.partition("=")) for part in words.split(",")]
    for split, equals, count in pairs:
        if not is_count(count):
            message = (
                f"--scenes has {split + equals + count!r}; expected a number, or SPLIT=N such as "
                "train=3000,test=300"
            )
            raise InputError(message)
    return tuple((split, int(count)) for split, _, count in pairs)


@dataclass(frozen=True, slots=True)
class SceneOptions:
    """What stands in a scene, and how close; lengths are of metres in :class:`SceneSpec`."""

    stars: str = text(
        "1-3", metavar="1-3|1,2,5", help="Number of stars of each class; a class for each number."
    )
    distractors: str = text(
        "0-5", metavar="0-5", help="Least and most objects of a scene that are not stars."
    )
    star_points: int | None = integer(None, help="Tips of a star.", optional=True, shown="5")
    star_inner_mm: float | None = real(
        None,
        optional=True,
        help="Radius of a star's notches; half of --radius-mm as published, a quarter with 3 points.",
    )
    shapes: str = text(
        "box,disc",
        metavar="box,disc",
        help="Shapes of distractors: box, disc, triangle, hexagon, ring, cross, crescent; with proportions "
        "of their own such as ring(hole_ratio=0.3).",
    )
    radius_mm: float = real(10.0, help="Radius of the circle around every object.")
    heights_mm: str = text("5", metavar="5|4,6", help="Heights of objects, each with equal chance.")
    cell_mm: str = text("120", metavar="120|120x120", help="Size of the cell along x and y.")
    collision: str = choice(
        "circles",
        ("circles", "exact"),
        help="What must not meet: circles around objects, or their exact outlines.",
    )
    clearance_mm: float = real(0.0, help="Least distance kept between those.")

    def spec(self) -> SceneSpec:
        """Return the specification of scenes. Raises InputError for what cannot be read or made."""
        from starstruck_gen.shapes import Shape
        from starstruck_gen.spec import SceneSpec

        sides_m = _lengths_m("--cell-mm", self.cell_mm, 2)
        shapes = [each for each in _BETWEEN_SHAPES.split(self.shapes) if each.strip()]
        return SceneSpec(
            cell_m=(sides_m[0], sides_m[-1]),
            stars=_counts(self.stars),
            distractors=_least_and_most(self.distractors),
            star=self._star(),
            distractor_shapes=tuple(Shape.parse(each, self.radius_mm / 1e3) for each in shapes),
            heights_m=_lengths_m("--heights-mm", self.heights_mm, 1000),
            collision=self.collision,
            clearance_m=self.clearance_mm / 1e3,
        )

    def _star(self) -> Shape:
        from starstruck_gen.shapes import STAR, Shape, Star

        # A radius that cannot be is refused first, not a ratio that follows from it.
        plain = Shape(STAR, self.radius_mm / 1e3)
        numbers: dict[str, float] = {} if self.star_points is None else {"points": self.star_points}
        if self.star_inner_mm is not None:
            numbers["inner_ratio"] = self.star_inner_mm / self.radius_mm
        elif self.star_points == _FEWEST_POINTS:
            numbers["inner_ratio"] = _RATIO_OF_FEWEST
        return Shape(STAR, plain.radius_m, Star.from_dict(numbers))


@command(app)
def generate(
    *,
    split: str = choice("all", ("train", "test", "all"), help="Split to make."),
    out: Out = "starstruck-data",
    scenes: Any = text(
        metavar="N|train=N,test=N",
        read=_scenes,
        help="Scenes of each split instead of the published 3,000 and 300.",
    ),
    scene: SceneOptions,
    seed: int = integer(0, help="Seed of everything that is drawn at random."),
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

    spec = GenerateSpec(scene.spec(), scenes or PUBLISHED_SIZES, seed, limit)
    splits = SPLITS if split == "all" else (split,)
    if scene.collision == "exact" and not making.dry_run:
        # Outlines are measured by manifold3d: 5.9 s of processor time with one thread, 7.1 s with its own
        # ones. Circles do without it, and would only pay for the 0.1 s that the setting costs.
        limit_threads()
    # A forecast tries the fullest scene, too.
    on_failure = trial_reporter(sink)
    generate_set(
        sink,
        KIND,
        making,
        out,
        splits,
        what="making scenes",
        forecast=partial(forecast, spec, out, splits, on_failure=on_failure),
        make=partial(make, spec, out, splits, on_failure=on_failure),
        print_made=_print_made,
    )


def trial_reporter(sink: Sink) -> Callable[[int, int], None]:
    """Return a function that takes each layout that failed, and reports it every few seconds.

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


def _print_made(sink: Sink, manifest: Manifest, out: str, elapsed_s: float | None) -> None:
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


_GEOMETRY = Geometry(
    "scenes",
    """Prove scenes as read back from disk: solids that never overlap, and as many stars as the label states.

    Example: starstruck validate scenes

    Exit code 1 when a scene is invalid. For a folder, `verify --geometry` checks its files as well.
    """,
    _check,
    _print_checked,
)


add_info(app, KIND, _print_made)
add_verify(app, KIND, _GEOMETRY)
command(app, "preview")(preview_scenes)
add_hub_commands(app, KIND)
add_mesh_gallery(app, KIND)
add_export(app, KIND)


def main() -> None:
    """Run the command line."""
    run(app)
