"""Groups of options of ``starstruck generate``, and what they describe."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from cli.options import is_count

if TYPE_CHECKING:
    from starstruck_gen.shapes import Shape
    from starstruck_gen.spec import SceneSpec

__all__ = ["SceneOptions", "split_sizes"]


# Notches at half the radius, as published, are not notches any more between 3 tips.
_FEWEST_POINTS, _RATIO_OF_FEWEST = 3, 0.25

_BETWEEN_SHAPES = re.compile(r",(?![^(]*\))")  # a comma within brackets belongs to a shape


@dataclass(frozen=True, slots=True)
class SceneOptions:
    """What stands in a scene, and how close."""

    stars: Annotated[
        str, typer.Option(metavar="1-3|1,2,5", help="Number of stars of each class; a class for each number.")
    ] = "1-3"
    distractors: Annotated[
        str, typer.Option(metavar="0-5", help="Least and most objects of a scene that are not stars.")
    ] = "0-5"
    star_points: Annotated[int | None, typer.Option(metavar="N", help="Tips of a star; 5 as published.")] = (
        None
    )
    star_inner_mm: Annotated[
        float | None,
        typer.Option(
            metavar="MM",
            help="Radius of a star's notches; half of --radius-mm as published, a quarter with 3 points.",
        ),
    ] = None
    shapes: Annotated[
        str,
        typer.Option(
            metavar="box,disc",
            help="Shapes of distractors: box, disc, triangle, hexagon, ring, cross, crescent; with "
            "proportions of their own such as ring(hole_ratio=0.3).",
        ),
    ] = "box,disc"
    radius_mm: Annotated[
        float, typer.Option(metavar="MM", help="Radius of the circle around every object.")
    ] = 10.0
    heights_mm: Annotated[
        str, typer.Option(metavar="5|4,6", help="Heights of objects, each with equal chance.")
    ] = "5"
    cell_mm: Annotated[str, typer.Option(metavar="120|120x120", help="Size of the cell along x and y.")] = (
        "120"
    )
    collision: Annotated[
        Literal["circles", "exact"],
        typer.Option(help="What must not meet: circles around objects, or their exact outlines."),
    ] = "circles"
    clearance_mm: Annotated[float, typer.Option(metavar="MM", help="Least distance kept between those.")] = (
        0.0
    )

    def spec(self) -> SceneSpec:
        """Return the specification of scenes. Raises InputError for what cannot be read or made."""
        from starstruck_gen.shapes import Shape
        from starstruck_gen.spec import SceneSpec
        from tactile_toolkit.errors import InputError

        sides_m = _lengths_m("--cell-mm", self.cell_mm.replace("x", ","))
        if len(sides_m) > 2:
            message = (
                f"--cell-mm is {self.cell_mm!r}; expected one length such as 120, or two such as 120x130"
            )
            raise InputError(message)
        radius_m = self.radius_mm / 1e3
        return SceneSpec(
            cell_m=(sides_m[0], sides_m[-1]),
            stars=_counts("--stars", self.stars),
            distractors=_least_and_most("--distractors", self.distractors),
            star=self._star(),
            distractor_shapes=tuple(
                Shape.parse(text, radius_m) for text in _BETWEEN_SHAPES.split(self.shapes) if text.strip()
            ),
            heights_m=_lengths_m("--heights-mm", self.heights_mm),
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


def _counts(option: str, text: str) -> tuple[int, ...]:
    """Read ``1-3`` or ``1,2,5``."""
    from tactile_toolkit.errors import InputError

    least, dash, most = (part.strip() for part in text.partition("-"))
    # Bounded here, before a tuple of the range is made; what a cell has room for `SceneSpec` checks.
    if dash and is_count(least) and is_count(most) and int(least) <= int(most) < 10_000:
        return tuple(range(int(least), int(most) + 1))
    parts = [part.strip() for part in text.split(",")]
    if all(is_count(part) for part in parts):
        return tuple(int(part) for part in parts)
    message = f"{option} is {text!r}; expected a range such as 1-3, or numbers such as 1,2,5"
    raise InputError(message)


def _least_and_most(option: str, text: str) -> tuple[int, int]:
    """Read ``0-5``, ``0,5`` or ``5``."""
    from tactile_toolkit.errors import InputError

    parts = [part.strip() for part in (text.split("-") if "-" in text else text.split(","))]
    if len(parts) > 2 or not all(is_count(part) for part in parts):
        message = f"{option} is {text!r}; expected the least and the most such as 0-5, or one number"
        raise InputError(message)
    return int(parts[0]), int(parts[-1])


def _lengths_m(option: str, text: str) -> tuple[float, ...]:
    """Read lengths in millimetres, separated by commas."""
    from tactile_toolkit.errors import InputError

    try:
        return tuple(float(part) / 1e3 for part in text.split(","))
    except ValueError:
        message = f"{option} is {text!r}; expected millimetres such as 120, or several of them"
        raise InputError(message) from None


def split_sizes(text: str) -> tuple[tuple[str, int], ...]:
    """Read ``5000`` or ``train=5000,test=500``."""
    from starstruck_gen.streams import SPLITS
    from tactile_toolkit.errors import InputError

    if is_count(text.strip()):
        return tuple((split, int(text)) for split in SPLITS)
    sizes = []
    for part in text.split(","):
        split, _, count = (piece.strip() for piece in part.partition("="))
        if not is_count(count):
            message = f"--scenes has {part!r}; expected a number, or SPLIT=N such as train=3000,test=300"
            raise InputError(message)
        sizes.append((split, int(count)))
    return tuple(sizes)
