"""Kinds of shapes: their proportions, and the outlines that follow from them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

import numpy as np

from tactile_toolkit.arithmetic import cosine_sine
from tactile_toolkit.array_types import Float64
from tactile_toolkit.checked_fields import to_builtin_number
from tactile_toolkit.errors import InputError
from tactile_toolkit.json_types import JsonDict, JsonObject

Outline = tuple[Float64, ...]
"""Rings of corners, each of shape (n, 2): the outer one counter-clockwise, holes clockwise."""

_LARGEST = 1e6  # for numbers without a declared range

STAR = "star"
"""The shape that is counted."""

_PUBLISHED_SEGMENTS = 32  # of the published disc (package tactile-mnist 0.13.0)
_DEEPEST_NOTCH_SHARE = 0.99


def _within(published: float, least: float, most: float) -> Any:
    """Declare a number with its default and its range."""
    return field(default=published, metadata={"least": least, "most": most})


# The default of all fields of this name: `dataclasses` notes the name in it.
_SEGMENTS = _within(_PUBLISHED_SEGMENTS, 8, 256)


@dataclass(frozen=True, slots=True)
class Proportions:
    """Proportions of a kind of shape, without its size. The defaults are those of the kind.

    Raises
    ------
    InputError
        A number is outside its range; the message names the shape, the field and the range.
    """

    name: ClassVar[str] = ""

    def __post_init__(self) -> None:
        for entry in fields(self):
            kind: Any = type(entry.default)
            least, most = entry.metadata.get("least", -_LARGEST), entry.metadata.get("most", _LARGEST)
            value = to_builtin_number(getattr(self, entry.name), float)
            if not (isinstance(value, float) and least <= value <= most and kind(value) == value):
                raise InputError(
                    f"{entry.name} of shape {self.name!r} is {getattr(self, entry.name)!r}; expected "
                    f"{'an integer from ' if kind is int else ''}{least:g} to {most:g}"
                )
            # One type for each number, so that equal proportions have equal JSON and keys.
            object.__setattr__(self, entry.name, kind(value))

    def rings(self) -> Outline:
        """Return the rings of the outline, read-only; unit: the circumscribed radius."""
        raise NotImplementedError

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle with the class, so that unpickling registers the kind in a new process."""
        return (_unpickled, (type(self), self.to_dict()))

    def to_dict(self) -> JsonDict:
        """Return JSON values."""
        return {entry.name: getattr(self, entry.name) for entry in fields(self)}

    @classmethod
    def from_dict(cls, values: JsonObject) -> Proportions:
        """Rebuild proportions from :meth:`to_dict`; missing fields take their defaults.

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


def _unpickled(kind: type[Proportions], values: JsonDict) -> Proportions:
    # The kind was checked when it was registered in the process that pickled it.
    if kind.name:
        KINDS.setdefault(kind.name, kind)
    return kind(**values)


def _arc(
    radius: float, start_rad: float, sweep_rad: float, corners: int, centre_x: float = 0.0
) -> list[tuple[float, float]]:
    """Return corners at equal steps of an arc, without its end."""
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
        # super() without arguments fails in a dataclass with slots.
        Proportions.__post_init__(self)
        # At a share of 1, a notch lies on the line between its two tips.
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
    segments: int = _SEGMENTS

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
    segments: int = _SEGMENTS

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
    segments: int = _SEGMENTS

    def rings(self) -> Outline:
        """Return one ring: the rim from horn to horn, then the bite back."""
        horn_x, horn_y = cosine_sine(self.horn_rad)
        # Rounded, as processors differ in the last digits.
        bite_rad = round(math.atan2(horn_y, horn_x - self.bite_ratio), 12)
        bite_radius = math.hypot(horn_x - self.bite_ratio, horn_y)
        back = _arc(1.0, self.horn_rad, math.tau - 2 * self.horn_rad, self.segments)
        bite = _arc(bite_radius, -bite_rad, 2 * bite_rad - math.tau, self.segments // 2, self.bite_ratio)
        return (np.array(back + bite),)


TOOLKIT_KINDS = (Star, Box, Disc, Triangle, Hexagon, Ring, Cross, Crescent)
"""Kinds that come with the toolkit; star, box and disc are published (package tactile-mnist 0.13.0)."""

KINDS: dict[str, type[Proportions]] = {kind.name: kind for kind in TOOLKIT_KINDS}
"""Kinds of shapes by name: those of the toolkit, and those that users register."""


def kind_named(name: str) -> type[Proportions]:
    """Return a kind of shape by its name; InputError if it is unknown."""
    if name not in KINDS:
        raise InputError(
            f"unknown shape {name!r}; expected one of {', '.join(KINDS)}, or one registered with "
            "starstruck_gen.register_shape"
        )
    return KINDS[name]
