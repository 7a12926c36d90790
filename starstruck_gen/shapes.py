"""Shapes: their proportions, outlines and solids."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import lru_cache
from itertools import pairwise
from typing import Any, ClassVar

import manifold3d
import numpy as np

from tactile_toolkit import mesh
from tactile_toolkit.arithmetic import cosine_sine
from tactile_toolkit.checked_fields import to_builtin
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import Float64, Int32, Int64, JsonDict, JsonObject

Outline = tuple[Float64, ...]
"""Rings of corners, each of shape (n, 2): the outer one counter-clockwise, holes clockwise."""
_LARGEST = 1e6  # for numbers without a declared range
STAR = "star"
"""The shape that is counted."""
_PUBLISHED_SEGMENTS = 32  # of the published disc (package tactile-mnist 0.13.0)
_SHALLOWEST_NOTCH_SHARE = 0.99

PUBLISHED_RADIUS_M = 0.010
"""Circumscribed radius of every published object (package tactile-mnist 0.13.0)."""

_MIN_RADIUS_M = 1e-4
_MAX_RADIUS_M = 1.0
_KEY = re.compile(r"(?P<name>\w+)(\((?P<numbers>[^()]*)\))?")

MAX_KEPT = 1_024
"""Largest number of outlines and solids of shapes in memory, each."""


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
            least = entry.metadata.get("least", -_LARGEST)
            most = entry.metadata.get("most", _LARGEST)
            value = to_builtin(getattr(self, entry.name), float)
            if not (isinstance(value, float) and least <= value <= most and kind(value) == value):
                raise InputError(
                    f"of shape {self.name!r} is {getattr(self, entry.name)!r}; expected "
                    f"{'an integer from ' if kind is int else ''}{least:g} to {most:g}",
                    field=entry.name,
                )
            # One type for each number, so that equal proportions have equal JSON and keys.
            object.__setattr__(self, entry.name, kind(value))

    def rings(self) -> Outline:
        """Return the rings of the outline, read-only; unit: the circumscribed radius."""
        raise NotImplementedError

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
        most = _SHALLOWEST_NOTCH_SHARE * math.cos(math.pi / self.points)
        if self.inner_ratio > most:
            raise InputError(
                f"inner_ratio of shape {STAR!r} is {self.inner_ratio!r}; expected at most {most:.4g} with "
                f"{self.points} points, so that notches lie inside the lines between tips",
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


# Star, box and disc are published (package tactile-mnist 0.13.0).
KINDS: dict[str, type[Proportions]] = {
    kind.name: kind for kind in (Star, Box, Disc, Triangle, Hexagon, Ring, Cross, Crescent)
}


def kind_named(name: str) -> type[Proportions]:
    """Return a kind of shape by its name; InputError if it is unknown."""
    if name not in KINDS:
        raise InputError(f"unknown shape {name!r}; expected one of {', '.join(KINDS)}")
    return KINDS[name]


# Stands for the default proportions of a kind, which is known once its name is looked up.
_DEFAULT_PROPORTIONS = Proportions()


@dataclass(frozen=True, slots=True)
class Shape:
    """A shape, its proportions and its size.

    Parameters
    ----------
    name : str
        Name of a kind: star, box, disc, triangle, hexagon, ring, cross or crescent.
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
    proportions: Proportions = _DEFAULT_PROPORTIONS
    key: str = field(init=False, repr=False, compare=False, default="")

    def __post_init__(self) -> None:
        kind = kind_named(self.name)
        if self.proportions is _DEFAULT_PROPORTIONS:
            object.__setattr__(self, "proportions", kind())
        if type(self.proportions) is not kind:
            raise InputError(
                f"proportions of shape {self.name!r} are {self.proportions!r}; expected {kind.__name__}(...)"
            )
        radius_m = to_builtin(self.radius_m, float)
        if not isinstance(radius_m, float) or not _MIN_RADIUS_M <= radius_m <= _MAX_RADIUS_M:
            raise InputError(
                f"of shape {self.name!r} is {self.radius_m!r}; expected {_MIN_RADIUS_M} to "
                f"{_MAX_RADIUS_M:g} (metres)",
                field="radius_m",
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
    numbers = ((entry, getattr(proportions, entry.name)) for entry in fields(proportions))
    stated = ",".join(f"{entry.name}={value!r}" for entry, value in numbers if value != entry.default)
    if not stated:
        return proportions.name
    return f"{proportions.name}({stated})"


@lru_cache(MAX_KEPT)
def outline(key: str) -> Outline:
    """Return the rings that a :func:`shape_key` names, read-only, in circumscribed radii.

    Frame: origin at the centre of the circumscribed circle, first corner of a star on +x. Raises InputError
    if the shape is unknown or its proportions cannot be used.
    """
    rings = tuple(np.asarray(ring, dtype=np.float64) for ring in _parse_key(key).rings())
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


@dataclass(frozen=True, slots=True, eq=False)
class Prism:
    """The solid of a shape without its size; lengths in units of the circumscribed radius.

    Vertex 2i of the solid is corner i on the plate, vertex 2i + 1 the one above it. Arrays are read-only.
    """

    corners: Float64  # (n, 2): all rings of the outline one after another
    cap: Int32  # (T, 3): triangles over all corners, counter-clockwise, none on another's edge
    faces: Int32  # (F, 3): triangles of the solid, outward
    area: float  # of the outline
    thinnest: float  # least height of a triangle of the cap; moves below half of it invert no triangle

    def vertices(self, height: float) -> Float64:
        """Return the vertices of an unturned prism of radius 1, shape (V, 3)."""
        standing = np.zeros((2 * len(self.corners), 3))
        standing[:, :2] = np.repeat(self.corners, 2, axis=0)
        standing[1::2, 2] = height
        return standing


@lru_cache(MAX_KEPT)
def prism(key: str) -> Prism:
    """Return the solid of the shape that a key names, made and checked on first use.

    Raises InputError for an unknown shape, and for proportions whose outline bounds no area.
    """
    rings = outline(key)
    corners = np.concatenate(rings)
    cap = np.asarray(manifold3d.triangulate(list(rings)), dtype=np.int32)
    a, b, c = (corners[cap[:, index]] for index in range(3))
    doubled_areas = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    # The least height of a triangle is twice its area over its longest side.
    sides = np.linalg.norm(corners[cap] - corners[np.roll(cap, 1, axis=1)], axis=2)
    made = Prism(
        corners,
        cap,
        _faces([len(ring) for ring in rings], cap),
        area=float(doubled_areas.sum() / 2),
        thinnest=float((doubled_areas / sides.max(axis=1)).min()),
    )
    for array in (made.corners, made.cap, made.faces):
        array.setflags(write=False)
    verdict = mesh.check_manifold(mesh.Mesh(made.vertices(0.5) * PUBLISHED_RADIUS_M, made.faces))
    problem = verdict.problem
    if problem is None and verdict.bodies != 1:
        problem = "in pieces"
    # A figure of eight can pass for a solid, but triangles of its cap are inverted.
    if problem is None and (doubled_areas <= 0).any():
        problem = "crossing itself"
    if problem is not None:
        raise InputError(
            f"the outline of shape {key!r} bounds no area ({problem}); expected one outer ring "
            "counter-clockwise, then holes clockwise, none touching another"
        )
    return made


@dataclass(frozen=True, slots=True, eq=False)
class Prisms:
    """The solids of several shapes one after another, before they are placed; read-only arrays."""

    corners: Float64  # (n, 2), of all prisms
    corner_counts: Int64  # of each prism
    faces: Int32  # (F, 3), numbered through all prisms


@lru_cache(MAX_KEPT)
def prisms(keys: tuple[str, ...]) -> Prisms:
    """Return the solids of the shapes that keys name, in their order.

    Results are cached, as scenes have few shapes in few orders; the published specification has 189 orders.
    """
    solids = [prism(key) for key in keys]
    counts = np.array([len(solid.corners) for solid in solids], dtype=np.int64)
    first_vertices = 2 * (np.cumsum(counts) - counts)
    numbered = (solid.faces + np.int32(first) for solid, first in zip(solids, first_vertices, strict=True))
    # Begins with empty arrays, since a layout may be empty.
    corners = np.concatenate([np.zeros((0, 2)), *(solid.corners for solid in solids)])
    made = Prisms(corners, counts, np.concatenate([np.zeros((0, 3), np.int32), *numbered]))
    for array in (made.corners, made.corner_counts, made.faces):
        array.setflags(write=False)
    return made


def _faces(ring_sizes: list[int], cap: Int32) -> Int32:
    """Join the two caps by walls along each ring; holes are clockwise, so their walls face inwards."""
    starts = np.cumsum([0, *ring_sizes])
    here = np.arange(starts[-1])
    following = np.concatenate([np.roll(here[a:b], -1) for a, b in pairwise(starts)])
    walls = [
        np.stack([2 * here, 2 * following, 2 * following + 1], axis=1),
        np.stack([2 * here, 2 * following + 1, 2 * here + 1], axis=1),
    ]
    return np.concatenate([2 * cap + 1, 2 * cap[:, ::-1], *walls]).astype(np.int32)


def require_fine_steps(
    shapes: Sequence[Shape], half_area_m: tuple[float, float], cell_m: tuple[float, float]
) -> None:
    """Refuse shapes so small, in a cell so large, that float32 coordinates could invert a triangle.

    Three corners that each move by up to e keep their orientation if the triangle is thicker than 2 e.
    """
    for shape in shapes:
        thinnest_m = prism(shape.key).thinnest * shape.radius_m
        farthest_m = np.array(half_area_m) + shape.radius_m
        # Rounding moves a corner by half a step along x and half a step along y.
        moved_m = math.hypot(*np.spacing(farthest_m.astype(np.float32)).tolist()) / 2
        if thinnest_m <= 2 * moved_m:
            raise InputError(
                f"of the scene specification is {cell_m!r}; expected a smaller cell for shape "
                f"{shape.key!r} of radius_m {shape.radius_m!r}: the thinnest triangle of the shape is "
                f"{thinnest_m:.2g} m high, and float32 moves its corners by up to {moved_m:.2g} m",
                next="lower cell_m (--cell-mm) or the corners of the shape (segments, points), or raise "
                "radius_m (--radius-mm)",
                field="cell_m",
            )
