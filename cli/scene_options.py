"""How the options of ``starstruck generate`` describe scenes."""

from __future__ import annotations

import re
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from starstruck_gen.shapes import Shape
    from starstruck_gen.spec import SceneSpec

__all__ = ["CollisionName", "scene_spec", "split_sizes"]


# Notches at half the radius, as published, are no notches between 3 tips.
_FEWEST_POINTS, _RATIO_OF_FEWEST = 3, 0.25

_LONGEST_COUNT = 18

_BETWEEN_SHAPES = re.compile(r",(?![^(]*\))")  # a comma within brackets belongs to a shape


class CollisionName(StrEnum):
    """Collision rules on the command line."""

    circles = "circles"
    exact = "exact"


def scene_spec(
    stars: str,
    distractors: str,
    star_points: int | None,
    star_inner_mm: float | None,
    shapes: str,
    radius_mm: float,
    heights_mm: str,
    cell_mm: str,
    collision: CollisionName,
    clearance_mm: float,
) -> SceneSpec:
    """Make the specification that the options describe."""
    from starstruck_gen.shapes import Shape
    from starstruck_gen.spec import SceneSpec
    from tactile_toolkit.errors import InputError

    sides_m = _lengths_m("--cell-mm", cell_mm.replace("x", ","))
    if len(sides_m) > 2:
        message = f"--cell-mm is {cell_mm!r}; expected one length such as 120, or two such as 120x130"
        raise InputError(message)
    radius_m = radius_mm / 1e3
    return SceneSpec(
        cell_m=(sides_m[0], sides_m[-1]),
        stars=_counts("--stars", stars),
        distractors=_least_and_most("--distractors", distractors),
        star=_star(star_points, star_inner_mm, radius_mm),
        distractor_shapes=tuple(
            Shape.parse(text, radius_m) for text in _BETWEEN_SHAPES.split(shapes) if text.strip()
        ),
        heights_m=_lengths_m("--heights-mm", heights_mm),
        collision=collision.value,
        clearance_m=clearance_mm / 1e3,
    )


def _star(points: int | None, inner_mm: float | None, radius_mm: float) -> Shape:
    from starstruck_gen.shapes import STAR, Shape, Star

    plain = Shape(STAR, radius_mm / 1e3)  # a radius that cannot be is told first, not a ratio that follows
    numbers: dict[str, float] = {} if points is None else {"points": points}
    if inner_mm is not None:
        numbers["inner_ratio"] = inner_mm / radius_mm
    elif points == _FEWEST_POINTS:
        numbers["inner_ratio"] = _RATIO_OF_FEWEST
    return Shape(STAR, plain.radius_m, Star.from_dict(numbers))


def _counts(option: str, text: str) -> tuple[int, ...]:
    """Read ``1-3`` or ``1,2,5``."""
    from tactile_toolkit.errors import InputError

    least, dash, most = (part.strip() for part in text.partition("-"))
    if dash and _is_count(least) and _is_count(most) and int(least) <= int(most) < 10_000:
        return tuple(range(int(least), int(most) + 1))
    parts = [part.strip() for part in text.split(",")]
    if all(_is_count(part) for part in parts):
        return tuple(int(part) for part in parts)
    message = f"{option} is {text!r}; expected a range such as 1-3, or numbers such as 1,2,5"
    raise InputError(message)


def _least_and_most(option: str, text: str) -> tuple[int, int]:
    """Read ``0-5``, ``0,5`` or ``5``."""
    from tactile_toolkit.errors import InputError

    parts = [part.strip() for part in (text.split("-") if "-" in text else text.split(","))]
    if len(parts) > 2 or not all(_is_count(part) for part in parts):
        message = f"{option} is {text!r}; expected the least and the most such as 0-5, or one number"
        raise InputError(message)
    return int(parts[0]), int(parts[-1])


def _is_count(text: str) -> bool:
    """Tell whether a text is a whole number of sensible length; a superscript is a digit, but no number."""
    return text.isdecimal() and len(text) <= _LONGEST_COUNT


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

    if _is_count(text.strip()):
        return tuple((split, int(text)) for split in SPLITS)
    sizes = []
    for part in text.split(","):
        split, _, count = (piece.strip() for piece in part.partition("="))
        if not _is_count(count):
            message = f"--scenes has {part!r}; expected a number, or SPLIT=N such as train=3000,test=300"
            raise InputError(message)
        sizes.append((split, int(count)))
    return tuple(sizes)
