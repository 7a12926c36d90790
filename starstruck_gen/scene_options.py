"""Options of commands for scenes: lists of numbers as text, lengths in millimetres."""

from __future__ import annotations

import re
from dataclasses import dataclass

import starstruck_gen
from starstruck_gen.kind import KIND
from tactile_toolkit import catalog, checked_fields, wording
from tactile_toolkit.errors import InputError

_BETWEEN_SHAPES = re.compile(r",(?![^(]*\))")  # a comma within brackets belongs to a shape
# With 3 tips, the published inner ratio of 0.5 gives straight sides: a triangle, not a star.
_MIN_POINTS = 3
_RATIO_OF_FEWEST = 0.25


def _counts(name: str, words: str) -> tuple[int, ...]:
    """Read a range such as ``1-3``, or numbers such as ``1,2,5``."""
    ends = wording.counts(words, "-")
    # The range is bounded before it becomes a tuple; `SceneSpec` checks the rest.
    if len(ends) == 2 and ends[0] <= ends[1] < 10_000:
        return tuple(range(ends[0], ends[1] + 1))
    numbers = wording.counts(words)
    if not numbers:
        raise InputError(f"is {words!r}; expected a range such as 1-3, or numbers such as 1,2,5", field=name)
    return numbers


def _lengths_m(name: str, words: str, most: int) -> tuple[float, ...]:
    """Read lengths in millimetres, separated by commas or by an x."""
    try:
        lengths_m = tuple(float(part) / 1e3 for part in words.replace("x", ",").split(","))
    except ValueError:
        lengths_m = ()
    if not 0 < len(lengths_m) <= most:
        raise InputError(
            f"is {words!r}; expected 1 to {most} lengths in millimetres, such as 120", field=name
        )
    return lengths_m


def scene_counts(words: str) -> tuple[tuple[str, int], ...]:
    """Read ``5000`` or ``train=5000,test=500``."""
    total = wording.counts(words)
    if len(total) == 1:
        return tuple((split, total[0]) for split in KIND.splits)
    return checked_fields.split_counts(words, "scenes", KIND.splits)


@dataclass(frozen=True, slots=True)
class SceneOptions:
    """Objects of a scene, and how close they are; :class:`SceneSpec` has lengths in metres."""

    stars: str = checked_fields.text(
        "1-3",
        metavar="1-3|1,2,5",
        panel="Scenes",
        help="Numbers of stars in a scene; each number is a class.",
    )
    distractors: str = checked_fields.text(
        "0-5",
        metavar="0-5",
        panel="Scenes",
        help="Minimum and maximum number of distractors: objects that are not stars.",
    )
    star_points: int | None = checked_fields.integer(
        None, panel="Scenes", help="Number of tips of a star.", optional=True, shown="5"
    )
    star_inner_mm: float | None = checked_fields.real(
        None,
        optional=True,
        panel="Scenes",
        help="Inner radius of a star; by default half of --radius-mm as published, a quarter with 3 points.",
    )
    shapes: str = checked_fields.text(
        "box,disc",
        metavar="box,disc",
        panel="Scenes",
        help="Shapes of distractors: box, disc, triangle, hexagon, ring, cross, crescent; with proportions "
        "of their own such as ring(hole_ratio=0.3).",
    )
    radius_mm: float = checked_fields.real(
        10.0, panel="Scenes", help="Radius of the circle around every object."
    )
    heights_mm: str = checked_fields.text(
        "5", metavar="5|4,6", panel="Scenes", help="Heights of objects, drawn with equal probability."
    )
    cell_mm: str = checked_fields.text(
        "120", metavar="120|120x120", panel="Scenes", help="Size of the cell along x and y."
    )
    collision: str = checked_fields.choice(
        "circles",
        ("circles", "exact"),
        panel="Scenes",
        help="What must not overlap: circles around objects (circles), or their outlines (exact).",
    )
    clearance_mm: float = checked_fields.real(
        0.0, panel="Scenes", help="Minimum distance between these circles or outlines."
    )

    def spec(self) -> starstruck_gen.SceneSpec:
        """Return the specification of scenes; InputError for options that cannot be read or satisfied."""
        others = _counts("distractors", self.distractors)
        if len(wording.counts(self.distractors)) > 2:
            raise InputError(
                f"is {self.distractors!r}; expected the minimum and the maximum, such as 0-5",
                field="distractors",
            )
        sides_m = _lengths_m("cell_mm", self.cell_mm, 2)
        shapes = [name for name in _BETWEEN_SHAPES.split(self.shapes) if name.strip()]
        return starstruck_gen.SceneSpec(
            cell_m=(sides_m[0], sides_m[-1]),
            stars=_counts("stars", self.stars),
            distractors=(others[0], others[-1]),
            star=self._star(),
            distractor_shapes=tuple(
                starstruck_gen.Shape.parse(name, self.radius_mm / 1e3) for name in shapes
            ),
            heights_m=_lengths_m("heights_mm", self.heights_mm, 1000),
            collision=self.collision,
            clearance_m=self.clearance_mm / 1e3,
        )

    def _star(self) -> starstruck_gen.Shape:
        # An impossible radius is refused before the ratio that is computed from it.
        plain = starstruck_gen.Shape("star", self.radius_mm / 1e3)
        numbers: dict[str, float] = {}
        if self.star_points is not None:
            numbers["points"] = self.star_points
        if self.star_inner_mm is not None:
            numbers["inner_ratio"] = self.star_inner_mm / self.radius_mm
        elif self.star_points == _MIN_POINTS:
            numbers["inner_ratio"] = _RATIO_OF_FEWEST
        return starstruck_gen.Shape("star", plain.radius_m, starstruck_gen.Star.from_dict(numbers))


@dataclass(frozen=True, slots=True)
class ScenePreviewSpec(catalog.PreviewSpec):
    """Options of previews of scenes."""

    per_class: int = checked_fields.integer(8, 1)
    kinds: tuple[str, ...] = checked_fields.choice((), ("sheet", "all"))
