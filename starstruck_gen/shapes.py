"""Shapes: kinds with their proportions, the outline that follows, and the key that names it in a placement.

A further kind is one class: everything else (collision, solids, drawing, the specification, the command line)
follows from it. Those of the toolkit are here, in :data:`KINDS`; others come to it by
:func:`starstruck_gen.register_shape`. Lengths are in units of the circumscribed radius, so that every outline
reaches distance 1 from the origin and not beyond.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from tactile_toolkit.arithmetic import cosine_sine
from tactile_toolkit.array_types import Float64
from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import plain_number

Outline = tuple[Float64, ...]
"""Rings of corners, each of shape (n, 2): the outer one counter-clockwise, holes clockwise."""

STAR = "star"
"""The shape that is counted."""

PUBLISHED_RADIUS_M = 0.010
"""Circumscribed radius of every published object (package tactile-mnist 0.13.0)."""

_PUBLISHED_SEGMENTS = 32  # of the published disc (package tactile-mnist 0.13.0)
_DEEPEST_NOTCH_SHARE = 0.99
_LARGEST = 1e6  # where a kind declares no range
_LEAST_RADIUS_M = 1e-4
_MOST_RADIUS_M = 1.0
_KEY = re.compile(r"(?P<name>\w+)(\((?P<numbers>[^()]*)\))?")


def _within(published: float, least: float, most: float) -> Any:
    """Declare a number with its default and the range it must keep to."""
    return field(default=published, metadata={"least": least, "most": most})


def _segments() -> Any:
    return _within(_PUBLISHED_SEGMENTS, 8, 256)


@dataclass(frozen=True, slots=True)
class Proportions:
    """Proportions of a kind of shape, without its size. The defaults are those of the kind.

    Raises
    ------
    InputError
        When a number is outside its range; the message names shape, field, what was found and expected.
    """

    name: ClassVar[str] = ""

    def __post_init__(self) -> None:
        for entry in fields(self):
            kind: Any = type(entry.default)
            least, most = entry.metadata.get("least", -_LARGEST), entry.metadata.get("most", _LARGEST)
            value = plain_number(getattr(self, entry.name), float)
            if not (isinstance(value, float) and least <= value <= most and kind(value) == value):
                raise InputError(
                    f"{entry.name} of shape {self.name!r} is {getattr(self, entry.name)!r}; expected "
                    f"{'an integer from ' if kind is int else ''}{least:g} to {most:g}"
                )
            # Whole and plain numbers have one spelling, so that equal proportions have equal JSON and keys.
            object.__setattr__(self, entry.name, kind(value))

    def rings(self) -> Outline:
        """Return the rings of the outline, read-only; unit: the circumscribed radius."""
        raise NotImplementedError

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle with the class, so that a worker that never heard of the kind knows it from then on."""
        return (_unpickled, (type(self), self.to_dict()))

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {entry.name: getattr(self, entry.name) for entry in fields(self)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Proportions:
        """Rebuild proportions from :meth:`to_dict`; what is missing takes its default.

        Raises
        ------
        InputError
            Unknown field, or a value that cannot be used.
        """
        known = [entry.name for entry in fields(cls)]
        unknown = [name for name in values if name not in known]
        if unknown:
            expected = f"one of {', '.join(known)}" if known else "none"
            raise InputError(f"unknown proportion {unknown[0]!r} of shape {cls.name!r}; expected {expected}")
        return cls(**values)


def _unpickled(kind: type[Proportions], values: dict[str, Any]) -> Proportions:
    # Unchecked: the process that pickled it has registered, and so checked, the kind.
    if kind.name and kind.name not in KINDS:
        add_kind(kind)
    return kind(**values)


def _arc(
    radius: float, start_rad: float, sweep_rad: float, corners: int, centre_x: float = 0.0
) -> list[tuple[float, float]]:
    """Return corners at equal steps of an arc, its end left out."""
    turns = [cosine_sine(start_rad + sweep_rad * step / corners) for step in range(corners)]
    return [(centre_x + radius * cosine, radius * sine) for cosine, sine in turns]


def _regular(corners: int, start_rad: float = 0.0) -> Outline:
    return (np.array(_arc(1.0, start_rad, math.tau, corners)),)


@dataclass(frozen=True, slots=True)
class Star(Proportions):
    """A star, its first tip on +x.

    Attributes
    ----------
    points : int
        Number of tips (package tactile-mnist 0.13.0: 5).
    inner_ratio : float
        Radius of the notches over that of the tips (package tactile-mnist 0.13.0: 5 mm and 10 mm).
    """

    name: ClassVar[str] = STAR
    points: int = _within(5, 3, 64)
    inner_ratio: float = _within(0.5, 0.05, 0.95)

    def __post_init__(self) -> None:
        # super() without arguments knows the class before it got its slots.
        Proportions.__post_init__(self)
        # At a share of 1 a notch lies on the line between its two tips, and the star is a polygon.
        deepest = _DEEPEST_NOTCH_SHARE * math.cos(math.pi / self.points)
        if self.inner_ratio > deepest:
            raise InputError(
                f"inner_ratio of shape {STAR!r} is {self.inner_ratio!r}; expected at most {deepest:.4g} with "
                f"{self.points} points, so that notches lie between the tips",
                next="lower inner_ratio (--star-inner-mm)",
            )

    def rings(self) -> Outline:
        """Return one ring: tip, notch, tip, ..."""
        tips = _arc(1.0, 0.0, math.tau, self.points)
        notches = _arc(self.inner_ratio, math.pi / self.points, math.tau, self.points)
        return (np.array([corner for pair in zip(tips, notches, strict=True) for corner in pair]),)


@dataclass(frozen=True, slots=True)
class Box(Proportions):
    """A square, its sides along x and y."""

    name: ClassVar[str] = "box"

    def rings(self) -> Outline:
        """Return one ring of four corners."""
        return _regular(4, math.pi / 4)


@dataclass(frozen=True, slots=True)
class Disc(Proportions):
    """A disc.

    Attributes
    ----------
    segments : int
        Corners of its rim.
    """

    name: ClassVar[str] = "disc"
    segments: int = _segments()

    def rings(self) -> Outline:
        """Return one ring."""
        return _regular(self.segments)


@dataclass(frozen=True, slots=True)
class Triangle(Proportions):
    """An equilateral triangle, one corner on +x."""

    name: ClassVar[str] = "triangle"

    def rings(self) -> Outline:
        """Return one ring of three corners."""
        return _regular(3)


@dataclass(frozen=True, slots=True)
class Hexagon(Proportions):
    """A regular hexagon, one corner on +x."""

    name: ClassVar[str] = "hexagon"

    def rings(self) -> Outline:
        """Return one ring of six corners."""
        return _regular(6)


@dataclass(frozen=True, slots=True)
class Ring(Proportions):
    """A disc with a round hole.

    Attributes
    ----------
    hole_ratio : float
        Radius of the hole.
    segments : int
        Corners of the rim and of the hole.
    """

    name: ClassVar[str] = "ring"
    hole_ratio: float = _within(0.5, 0.05, 0.95)
    segments: int = _segments()

    def rings(self) -> Outline:
        """Return the rim, then the hole."""
        hole = np.array(_arc(self.hole_ratio, 0.0, -math.tau, self.segments))
        return (*_regular(self.segments), hole)


@dataclass(frozen=True, slots=True)
class Cross(Proportions):
    """Two bars across each other, along x and y.

    Attributes
    ----------
    arm_ratio : float
        Half the width of a bar.
    """

    name: ClassVar[str] = "cross"
    arm_ratio: float = _within(0.3, 0.05, 0.65)

    def rings(self) -> Outline:
        """Return one ring of twelve corners."""
        side = self.arm_ratio
        # The corners of the arms lie on the circumscribed circle.
        far = math.sqrt(1.0 - side**2)
        arm = [(far, -side), (far, side), (side, side)]
        turned = [arm, [(-y, x) for x, y in arm], [(-x, -y) for x, y in arm], [(y, -x) for x, y in arm]]
        return (np.array([corner for quarter in turned for corner in quarter]),)


@dataclass(frozen=True, slots=True)
class Crescent(Proportions):
    """A disc with a round bite from +x.

    Attributes
    ----------
    horn_rad : float
        Angle of the two horns, where rim and bite meet, from +x.
    bite_ratio : float
        Distance of the bite's centre from that of the disc.
    segments : int
        Corners of the rim; the bite has half as many.
    """

    name: ClassVar[str] = "crescent"
    horn_rad: float = _within(math.pi / 3, 0.25, 1.5)
    bite_ratio: float = _within(0.6, 0.2, 0.9)
    segments: int = _segments()

    def rings(self) -> Outline:
        """Return one ring: the rim from horn to horn, then the bite back."""
        horn_x, horn_y = cosine_sine(self.horn_rad)
        # Rounded to where all processors agree.
        bite_rad = round(math.atan2(horn_y, horn_x - self.bite_ratio), 12)
        bite_radius = math.hypot(horn_x - self.bite_ratio, horn_y)
        back = _arc(1.0, self.horn_rad, math.tau - 2 * self.horn_rad, self.segments)
        bite = _arc(bite_radius, -bite_rad, 2 * bite_rad - math.tau, self.segments // 2, self.bite_ratio)
        return (np.array(back + bite),)


KINDS: dict[str, type[Proportions]] = {}
"""Kinds of shapes by name, those of :func:`starstruck_gen.register_shape` too.

The published scenes have star, box and disc (package tactile-mnist 0.13.0).
"""

OUTLINES: dict[str, Callable[[], Outline]] = {}
"""Outline of each kind of shape in its default proportions."""


def add_kind(kind: type[Proportions]) -> None:
    """Add a kind to the registry, unchecked."""
    KINDS[kind.name], OUTLINES[kind.name] = kind, kind().rings


for _ours in (Star, Box, Disc, Triangle, Hexagon, Ring, Cross, Crescent):
    add_kind(_ours)


def shape_key(proportions: Proportions) -> str:
    """Return what names an outline in a placement: ``star``, or ``star(points=6)`` for one of its own.

    Only numbers that differ from those of the kind are written, exactly; equal proportions have equal keys.
    """
    given = ((entry, getattr(proportions, entry.name)) for entry in fields(proportions))
    numbers = ",".join(f"{entry.name}={value!r}" for entry, value in given if value != entry.default)
    return f"{proportions.name}({numbers})" if numbers else proportions.name


@lru_cache(1_024)
def outline(key: str) -> Outline:
    """Return the rings that a :func:`shape_key` names, read-only; unit: the circumscribed radius.

    Frame: origin at the centre of the circumscribed circle, first corner of a star on +x. Raises InputError
    when the shape is unknown, or its proportions cannot be used.
    """
    return read_only(_parse_key(key).rings())


def read_only(rings: Outline) -> Outline:
    """Return rings that cannot be changed: the class of a user may hand out its own arrays."""
    rings = tuple(np.asarray(ring, dtype=np.float64) for ring in rings)
    for ring in rings:
        ring.setflags(write=False)
    return rings


# Stands for those of the kind, which is known only when its name is looked up.
_OF_THE_KIND = Proportions()


@dataclass(frozen=True, slots=True)
class Shape:
    """A shape, its proportions and its size.

    Parameters
    ----------
    name : str
        One of :data:`OUTLINES`.
    radius_m : float
        Circumscribed radius, metres.
    proportions : Proportions
        What it looks like, such as ``Star(points=6)``; those of the kind when not given.

    Attributes
    ----------
    key : str
        What names its outline in a placement, such as ``star`` or ``star(points=6)``.

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
        kind = _kind(self.name)
        if self.proportions is _OF_THE_KIND:
            object.__setattr__(self, "proportions", kind())
        if type(self.proportions) is not kind:
            raise InputError(
                f"proportions of shape {self.name!r} are {self.proportions!r}; expected {kind.__name__}(...)"
            )
        radius_m = plain_number(self.radius_m, float)
        if not isinstance(radius_m, float) or not _LEAST_RADIUS_M <= radius_m <= _MOST_RADIUS_M:
            raise InputError(
                f"radius_m of shape {self.name!r} is {self.radius_m!r}; expected {_LEAST_RADIUS_M} to "
                f"{_MOST_RADIUS_M:g} (metres)"
            )
        object.__setattr__(self, "radius_m", radius_m)
        object.__setattr__(self, "key", shape_key(self.proportions))

    @classmethod
    def parse(cls, text: str, radius_m: float = PUBLISHED_RADIUS_M) -> Shape:
        """Read a shape written as its key, such as ``ring`` or ``ring(hole_ratio=0.3)``.

        Raises
        ------
        InputError
            When the text is not such a key.
        """
        proportions = _parse_key(text)
        return cls(proportions.name, radius_m, proportions)

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        numbers = self.proportions.to_dict()
        size = {"name": self.name, "radius_m": self.radius_m}
        return {**size, "proportions": numbers} if numbers else size

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Shape:
        """Rebuild a shape from :meth:`to_dict`; proportions that are not given are those of the kind.

        Raises
        ------
        InputError
            When a value cannot be used.
        TypeError
            When a field is missing or unknown.
        """
        plain = dict(values)
        numbers = plain.pop("proportions", {})
        shape = cls(**plain)
        return cls(shape.name, shape.radius_m, type(shape.proportions).from_dict(dict(numbers)))


def _kind(name: str) -> type[Proportions]:
    if name not in KINDS:
        raise InputError(
            f"unknown shape {name!r}; expected one of {', '.join(KINDS)}, or one made known by "
            "starstruck_gen.register_shape"
        )
    return KINDS[name]


def _parse_key(key: str) -> Proportions:
    """Read what :func:`shape_key` writes; people write it too, so spaces and repeated numbers are met."""
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
    return _kind(match["name"]).from_dict(numbers)
