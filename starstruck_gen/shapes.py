"""Shapes: a kind, its proportions and its size, and the key by which placements name the outline."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starstruck_gen.proportions import DEFAULT_OUTLINES, KINDS, STAR, Outline, Proportions
from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import plain_number

__all__ = [
    "DEFAULT_OUTLINES",
    "OUTLINES",
    "PUBLISHED_RADIUS_M",
    "STAR",
    "Outline",
    "Shape",
    "outline",
    "shape_key",
]

PUBLISHED_RADIUS_M = 0.010
"""Circumscribed radius of every published object (package tactile-mnist 0.13.0)."""

OUTLINES: Mapping[str, Callable[[], Outline]] = MappingProxyType(DEFAULT_OUTLINES)
"""Outline of each kind of shape in its default proportions."""

_KEY = re.compile(r"(?P<name>\w+)(\((?P<numbers>[^()]*)\))?")
_OF_THE_KIND = Proportions()
_MOST_KEPT = 1_024
_LEAST_RADIUS_M = 1e-4
_MOST_RADIUS_M = 1.0


def shape_key(proportions: Proportions) -> str:
    """Return what names an outline in a placement: ``star``, or ``star(points=6)`` for one of its own.

    Only numbers that differ from those of the kind are written, exactly; equal proportions have equal keys.
    """
    numbers = ",".join(f"{name}={value!r}" for name, value in proportions.changed().items())
    return f"{proportions.name}({numbers})" if numbers else proportions.name


@lru_cache(_MOST_KEPT)
def outline(key: str) -> Outline:
    """Return the rings of a shape, each of shape (n, 2), read-only; unit: the circumscribed radius.

    Frame: origin at the centre of the circumscribed circle, first corner of a star on +x.

    Parameters
    ----------
    key : str
        Name of the kind, with the proportions that differ from its own in brackets; see :func:`shape_key`.

    Raises
    ------
    InputError
        When there is no such shape, or its proportions cannot be used.
    """
    return tuple(_read_only(ring) for ring in _read_key(key).rings())


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
        What names its outline in a placement; see :func:`shape_key`.

    Raises
    ------
    InputError
        Unknown name, proportions of another kind, or a radius outside 0.1 mm to 1 m.

    Examples
    --------
    >>> from starstruck_gen.proportions import Star
    >>> Shape("star", 0.010, Star(points=6)).key
    'star(points=6)'
    """

    name: str
    radius_m: float = PUBLISHED_RADIUS_M
    proportions: Proportions = _OF_THE_KIND
    key: str = field(init=False, repr=False, compare=False, default="")

    def __post_init__(self) -> None:
        if self.proportions is _OF_THE_KIND:
            object.__setattr__(self, "proportions", _kind(self.name)())
        if type(self.proportions) is not _kind(self.name):
            message = (
                f"proportions of shape {self.name!r} are {self.proportions!r}; "
                f"expected {_kind(self.name).__name__}(...)"
            )
            raise InputError(message)
        radius_m = plain_number(self.radius_m, float)
        if not isinstance(radius_m, float) or not _LEAST_RADIUS_M <= radius_m <= _MOST_RADIUS_M:
            message = (
                f"radius_m of shape {self.name!r} is {self.radius_m!r}; expected {_LEAST_RADIUS_M} to "
                f"{_MOST_RADIUS_M:g} (metres)"
            )
            raise InputError(message)
        object.__setattr__(self, "radius_m", radius_m)
        object.__setattr__(self, "key", shape_key(self.proportions))

    @classmethod
    def parse(cls, text: str, radius_m: float = PUBLISHED_RADIUS_M) -> Shape:
        """Read a shape written as its key, such as ``ring`` or ``ring(hole_ratio=0.3)``.

        Raises
        ------
        InputError
            When the text is no such key.
        """
        proportions = _read_key(text)
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


def _read_only(ring: NDArray[np.float64]) -> NDArray[np.float64]:
    kept = np.asarray(ring, dtype=np.float64)
    kept.setflags(write=False)
    return kept


def _kind(name: str) -> type[Proportions]:
    if name not in KINDS:
        message = (
            f"unknown shape {name!r}; expected one of {', '.join(KINDS)}, or one made known by "
            "starstruck_gen.register_shape"
        )
        raise InputError(message)
    return KINDS[name]


def _read_key(key: str) -> Proportions:
    match = _KEY.fullmatch(key.strip())
    if match is None:
        message = f"{key!r} is no shape; expected a name such as ring, or ring(hole_ratio=0.3)"
        raise InputError(message)
    numbers = [part for part in (match["numbers"] or "").split(",") if part.strip()]
    given = [_read_number(key, part) for part in numbers]
    names = [name for name, _ in given]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        message = f"shape {key!r} gives {twice[0]!r} {names.count(twice[0])} times; expected each number once"
        raise InputError(message)
    return _kind(match["name"]).from_dict(dict(given))


def _read_number(key: str, text: str) -> tuple[str, float]:
    name, _, value = (part.strip() for part in text.partition("="))
    try:
        return name, float(value)
    except ValueError:
        message = f"{text!r} in shape {key!r} is no proportion; expected NAME=NUMBER such as hole_ratio=0.3"
        raise InputError(message) from None
