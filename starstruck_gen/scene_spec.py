"""The specification of scenes."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from itertools import pairwise

from starstruck_gen import prisms, shape_kinds
from starstruck_gen.shapes import Shape
from tactile_toolkit import checked_fields, touch
from tactile_toolkit.errors import InputError
from tactile_toolkit.json_types import JsonDict, JsonObject

COLLISION_RULES = ("circles", "exact")
"""``circles``: circumscribed circles must not meet (published); ``exact``: outlines must not touch."""

# 3 mm, half the outer size of the sensor and half the border of the grid (package tactile-mnist 0.13.0).
_PADDING_M = (0.003 + 0.032 / 2 + 0.005 / 2, 0.003 + 0.028 / 2 + 0.005 / 2)
_PUBLISHED_STAR = Shape(shape_kinds.STAR)
_PUBLISHED_DISTRACTORS = (Shape("box"), Shape("disc"))
# Coordinates stay below 1 m, where float32 storage moves them by 0.03 um, a third of STORAGE_MARGIN_M.
_LARGEST_CELL_M = 2.0
# Each is compared with all others of its scene, so the work grows with the square.
_MAX_OBJECTS = 1_000


@dataclass(frozen=True)
class SceneSpec:
    """Parameters of scenes. The defaults are those of the published data set.

    Parameters
    ----------
    cell_m : tuple of float
        Size of the cell along x and y, metres (package tactile-mnist 0.13.0).
    padding_m : tuple of float
        Margin of the cell along x and y, metres: 3 mm, half the outer size of the sensor and half the border
        of the grid (package tactile-mnist 0.13.0).
    stars : tuple of int
        Number of stars of each class (Tactile MNIST paper, section Starstruck: 1 to 3).
    distractors : tuple of int
        Minimum and maximum number of distractors of a scene (Tactile MNIST paper, section Starstruck: 0 to
        5).
    star : Shape
        Shape that is counted; its name is ``"star"``. Size and proportions are part of a shape.
    distractor_shapes : tuple of Shape
        Shapes of distractors, each with equal chance (Tactile MNIST paper, section Starstruck).
    heights_m : tuple of float
        Heights of objects, each with equal chance, metres (package tactile-mnist 0.13.0: 5 mm).
    rotation_rad : float
        Largest rotation of an object about z, radians; rotations are uniform from 0 to it.
    collision : str
        One of :data:`COLLISION_RULES`.
    clearance_m : float
        Least distance between circles (or outlines) of two objects, metres.
    attempts : int
        Failed positions of an object after which a scene starts over (Tactile MNIST paper: 100).
    restarts : int
        Number of times that a scene starts over before sampling gives up.

    Raises
    ------
    InputError
        A value cannot be used; the message names the field, what was found and what was expected.
    """

    cell_m: tuple[float, float] = checked_fields.real(touch.CELL_M, 0, _LARGEST_CELL_M, many=2)
    padding_m: tuple[float, float] = checked_fields.real(_PADDING_M, 0, _LARGEST_CELL_M, many=2)
    stars: tuple[int, ...] = (1, 2, 3)
    distractors: tuple[int, int] = (0, 5)
    star: Shape = _PUBLISHED_STAR
    distractor_shapes: tuple[Shape, ...] = _PUBLISHED_DISTRACTORS
    heights_m: tuple[float, ...] = (0.005,)
    rotation_rad: float = checked_fields.real(math.tau, 0, math.tau)
    collision: str = checked_fields.choice("circles", COLLISION_RULES)
    clearance_m: float = checked_fields.real(0.0, 0, _LARGEST_CELL_M)
    attempts: int = checked_fields.integer(100, 1)
    restarts: int = checked_fields.integer(1_000)

    def __post_init__(self) -> None:
        checked_fields.check_fields(self, "the scene specification")
        # One type for each value, so that equal specifications have equal JSON.
        for name, kind in (
            ("stars", int),
            ("distractors", int),
            ("distractor_shapes", int),
            ("heights_m", float),
        ):
            value = checked_fields.to_builtin(getattr(self, name), kind)
            object.__setattr__(self, name, value if isinstance(value, tuple) else (value,))
        stars, shapes, heights = self.stars, self.distractor_shapes, self.heights_m
        fits = (
            bool(stars)
            and checked_fields.is_integer(*stars)
            and stars[0] >= 0
            and all(a < b for a, b in pairwise(stars))
        )
        self._require("stars", fits, "integers from 0, each larger than the one before")
        fits = len(self.distractors) == 2 and checked_fields.is_integer(*self.distractors)
        fits = fits and 0 <= self.distractors[0] <= self.distractors[1]
        self._require("distractors", fits, "the minimum and the maximum, integers from 0")
        fits = stars[0] + self.distractors[0] > 0 and self.most_objects <= _MAX_OBJECTS
        self._require("stars", fits, f"1 to {_MAX_OBJECTS} objects in a scene, distractors included")
        fits = isinstance(self.star, Shape) and self.star.name == shape_kinds.STAR
        self._require(
            "star",
            fits,
            f"a Shape named {shape_kinds.STAR!r}, such as Shape({shape_kinds.STAR!r}, radius_m=0.01)",
        )
        fits = all(isinstance(shape, Shape) and shape.name != shape_kinds.STAR for shape in shapes)
        fits = fits and (bool(shapes) or self.distractors[1] == 0)
        self._require("distractor_shapes", fits, "Shape objects that are not stars, such as (Shape('box'),)")
        fits = bool(heights) and all(isinstance(each, float) and 1e-4 <= each <= 1.0 for each in heights)
        self._require("heights_m", fits, "one or more heights from 0.0001 to 1 m")
        self._require(
            "cell_m", min(self.half_area_m) >= 0, "room for the padding and one object side by side"
        )
        prisms.require_fine_steps((self.star, *self.distractor_shapes), self.half_area_m, self.cell_m)

    def _require(self, name: str, fits: bool, expected: str) -> None:
        if not fits:
            raise InputError(
                f"{name} of the scene specification is {getattr(self, name)!r}; expected {expected}"
            )

    @cached_property
    def half_area_m(self) -> tuple[float, float]:
        """Largest distance of a centre from the middle along x and y, metres.

        Objects in any rotation then stay inside the padded cell.
        """
        widest_m = 2 * max(shape.radius_m for shape in (self.star, *self.distractor_shapes))
        return (
            (self.cell_m[0] - self.padding_m[0] - widest_m) / 2,
            (self.cell_m[1] - self.padding_m[1] - widest_m) / 2,
        )

    @property
    def class_names(self) -> tuple[str, ...]:
        """Name of each class: its number of stars."""
        return tuple(str(count) for count in self.stars)

    @property
    def most_objects(self) -> int:
        """Number of objects in the fullest scene."""
        return max(self.stars) + self.distractors[1]

    def to_dict(self) -> JsonDict:
        """Return JSON values; equal specifications give equal values and, with equal seeds, equal scenes."""
        values = {name: list(v) if isinstance(v, tuple) else v for name, v in asdict(self).items()}
        distractor_shapes = [shape.to_dict() for shape in self.distractor_shapes]
        return {**values, "star": self.star.to_dict(), "distractor_shapes": distractor_shapes}

    @classmethod
    def from_dict(cls, values: JsonObject) -> SceneSpec:
        """Rebuild a specification from :meth:`to_dict`.

        Raises
        ------
        InputError
            When a field is unknown or its value cannot be used.
        """
        unknown = sorted(set(values) - {entry.name for entry in fields(cls)})
        if unknown:
            raise InputError(
                f"unknown field {unknown[0]!r} in a scene specification",
                next="see the fields of starstruck_gen.SceneSpec",
            )
        try:
            arguments: JsonDict = {name: tuple(v) if isinstance(v, list) else v for name, v in values.items()}
            if "star" in values:
                arguments["star"] = Shape.from_dict(values["star"])
            if "distractor_shapes" in values:
                shapes = values["distractor_shapes"]
                arguments["distractor_shapes"] = tuple(Shape.from_dict(entry) for entry in shapes)
            return cls(**arguments)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"a value of the scene specification has a wrong type: {error}",
                next="see the types of the fields in starstruck_gen.SceneSpec",
            ) from error
