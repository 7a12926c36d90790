"""Shapes with their size, and the key that names an outline in a placement.

Lengths of outlines are in units of the circumscribed radius: each outline reaches distance 1 from the origin
and not beyond. A further kind of shape is one class (:func:`starstruck_gen.register_shape`); collision,
solids, drawing and the specification follow from it.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, fields
from functools import lru_cache

import numpy as np

from starstruck_gen.shape_kinds import Outline, Proportions, kind_named
from tactile_toolkit.checked_fields import to_builtin_number
from tactile_toolkit.errors import InputError
from tactile_toolkit.json_types import JsonDict, JsonObject

PUBLISHED_RADIUS_M = 0.010
"""Circumscribed radius of every published object (package tactile-mnist 0.13.0)."""

_MIN_RADIUS_M = 1e-4
_MAX_RADIUS_M = 1.0
_KEY = re.compile(r"(?P<name>\w+)(\((?P<numbers>[^()]*)\))?")
# Placeholder for the default proportions of the kind, which is known once its name is looked up.
_OF_THE_KIND = Proportions()


@dataclass(frozen=True, slots=True)
class Shape:
    """A shape, its proportions and its size.

    Parameters
    ----------
    name : str
        Name of a kind: star, box, disc, triangle, hexagon, ring, cross, crescent, or one that was registered.
    radius_m : float
        Circumscribed radius, metres.
    proportions : Proportions
        Proportions such as ``Star(points=6)``; by default those of the kind.

    Attributes
    ----------
    key : str
        Name of its outline in a placement, such as ``star`` or ``star(points=6)``.

    Raises
    ------
    InputError
        Unknown name, proportions of another kind, or a radius outside 0.1 mm to 1 m.

    Examples
    --------
    >>> from starstruck_gen import Star
    >>> Shape("star", 0.010, Star(points=6)).key
    'star(points=6)'
    """

    name: str
    radius_m: float = PUBLISHED_RADIUS_M
    proportions: Proportions = _OF_THE_KIND
    key: str = field(init=False, repr=False, compare=False, default="")

    def __post_init__(self) -> None:
        kind = kind_named(self.name)
        if self.proportions is _OF_THE_KIND:
            object.__setattr__(self, "proportions", kind())
        if type(self.proportions) is not kind:
            raise InputError(
                f"proportions of shape {self.name!r} are {self.proportions!r}; expected {kind.__name__}(...)"
            )
        radius_m = to_builtin_number(self.radius_m, float)
        if not isinstance(radius_m, float) or not _MIN_RADIUS_M <= radius_m <= _MAX_RADIUS_M:
            raise InputError(
                f"radius_m of shape {self.name!r} is {self.radius_m!r}; expected {_MIN_RADIUS_M} to "
                f"{_MAX_RADIUS_M:g} (metres)"
            )
        object.__setattr__(self, "radius_m", radius_m)
        object.__setattr__(self, "key", shape_key(self.proportions))

    @classmethod
    def parse(cls, text: str, radius_m: float = PUBLISHED_RADIUS_M) -> Shape:
        """Read a shape written as its key, such as ``ring`` or ``ring(hole_ratio=0.3)``.

        Raises
        ------
        InputError
            The text is not such a key.
        """
        proportions = _parse_key(text)
        return cls(proportions.name, radius_m, proportions)

    def to_dict(self) -> JsonDict:
        """Return JSON values."""
        numbers = self.proportions.to_dict()
        size = {"name": self.name, "radius_m": self.radius_m}
        return {**size, "proportions": numbers} if numbers else size

    @classmethod
    def from_dict(cls, values: JsonObject) -> Shape:
        """Rebuild a shape from :meth:`to_dict`; missing proportions are those of the kind.

        Raises
        ------
        InputError
            A value cannot be used.
        TypeError
            A field is missing or unknown.
        """
        plain = dict(values)
        numbers = plain.pop("proportions", {})
        shape = cls(**plain)
        return cls(shape.name, shape.radius_m, type(shape.proportions).from_dict(dict(numbers)))


def shape_key(proportions: Proportions) -> str:
    """Return the name of an outline in a placement, such as ``star`` or ``star(points=6)``.

    It holds the numbers that differ from those of the kind, exactly. Equal proportions have equal keys.
    """
    given = ((entry, getattr(proportions, entry.name)) for entry in fields(proportions))
    numbers = ",".join(f"{entry.name}={value!r}" for entry, value in given if value != entry.default)
    if not numbers:
        return proportions.name
    return f"{proportions.name}({numbers})"


@lru_cache(1_024)
def outline(key: str) -> Outline:
    """Return the rings that a :func:`shape_key` names, read-only, in circumscribed radii.

    Frame: origin at the centre of the circumscribed circle, first corner of a star on +x. Raises InputError
    if the shape is unknown or its proportions cannot be used.
    """
    return read_only(_parse_key(key).rings())


def read_only(rings: Outline) -> Outline:
    """Return rings as read-only arrays of float64."""
    rings = tuple(np.asarray(ring, dtype=np.float64) for ring in rings)
    for ring in rings:
        ring.setflags(write=False)
    return rings


def _parse_key(key: str) -> Proportions:
    """Read a :func:`shape_key`; InputError for a key that a person wrote wrongly."""
    match = _KEY.fullmatch(key.strip())
    if match is None:
        raise InputError(f"{key!r} is not a shape; expected a name such as ring, or ring(hole_ratio=0.3)")
    numbers: dict[str, float] = {}
    for part in filter(str.strip, (match["numbers"] or "").split(",")):
        name, _, number = (piece.strip() for piece in part.partition("="))
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if math.isnan(value) or name in numbers:
            raise InputError(
                f"{part!r} in shape {key!r} is not a proportion; expected each once as NAME=NUMBER, such as "
                "hole_ratio=0.3"
            )
        numbers[name] = value
    return kind_named(match["name"]).from_dict(numbers)
