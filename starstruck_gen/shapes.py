"""Shapes: outlines of circumscribed radius 1, by name.

A further shape is one function and one entry of :data:`OUTLINES`: everything else (collision, solids,
drawing, the command line) follows from the outline.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dataset_store.errors import InputError

__all__ = ["OUTLINES", "PUBLISHED_RADIUS_M", "STAR", "Outline", "Shape", "outline"]

Outline = tuple[NDArray[np.float64], ...]
"""Rings of corners, each of shape (n, 2): the outer one counter-clockwise, holes clockwise."""

STAR = "star"
"""The shape that is counted."""

PUBLISHED_RADIUS_M = 0.010
"""Circumscribed radius of every published object (package tactile-mnist 0.13.0)."""

_STAR_TIPS = 5
_STAR_INNER = 0.5  # inner over outer radius: 5 mm and 10 mm (package tactile-mnist 0.13.0)
_ROUND_SEGMENTS = 32  # of the published disc (package tactile-mnist 0.13.0)
_RING_HOLE = 0.5
_CROSS_ARM = 0.3
_CRESCENT_HORN_RAD = math.pi / 3
_CRESCENT_BITE_X = 0.6


def _arc(
    radius: float, start_rad: float, sweep_rad: float, corners: int, centre_x: float = 0.0
) -> list[tuple[float, float]]:
    """Return corners at equal steps of an arc, its end left out."""
    angles = [start_rad + sweep_rad * step / corners for step in range(corners)]
    return [(centre_x + radius * math.cos(angle), radius * math.sin(angle)) for angle in angles]


def _ring_of(corners: list[tuple[float, float]]) -> NDArray[np.float64]:
    ring = np.array(corners, dtype=np.float64)
    ring.setflags(write=False)
    return ring


def _regular(corners: int, start_rad: float = 0.0) -> Outline:
    return (_ring_of(_arc(1.0, start_rad, math.tau, corners)),)


def _star() -> Outline:
    tips = _arc(1.0, 0.0, math.tau, _STAR_TIPS)
    notches = _arc(_STAR_INNER, math.pi / _STAR_TIPS, math.tau, _STAR_TIPS)
    return (_ring_of([corner for pair in zip(tips, notches, strict=True) for corner in pair]),)


def _ring() -> Outline:
    hole = _ring_of(_arc(_RING_HOLE, 0.0, -math.tau, _ROUND_SEGMENTS))
    return (*_regular(_ROUND_SEGMENTS), hole)


def _cross() -> Outline:
    far = math.sqrt(1.0 - _CROSS_ARM**2)
    arm = [(far, -_CROSS_ARM), (far, _CROSS_ARM), (_CROSS_ARM, _CROSS_ARM)]
    turned = [arm, [(-y, x) for x, y in arm], [(-x, -y) for x, y in arm], [(y, -x) for x, y in arm]]
    return (_ring_of([corner for quarter in turned for corner in quarter]),)


def _crescent() -> Outline:
    horn_x, horn_y = math.cos(_CRESCENT_HORN_RAD), math.sin(_CRESCENT_HORN_RAD)
    bite_rad = math.atan2(horn_y, horn_x - _CRESCENT_BITE_X)
    bite_radius = math.hypot(horn_x - _CRESCENT_BITE_X, horn_y)
    back = _arc(1.0, _CRESCENT_HORN_RAD, math.tau - 2 * _CRESCENT_HORN_RAD, _ROUND_SEGMENTS)
    bite = _arc(bite_radius, -bite_rad, 2 * bite_rad - math.tau, _ROUND_SEGMENTS // 2, _CRESCENT_BITE_X)
    return (_ring_of(back + bite),)


OUTLINES: Mapping[str, Callable[[], Outline]] = MappingProxyType(
    {
        STAR: _star,
        "box": lambda: _regular(4, math.pi / 4),
        "disc": lambda: _regular(_ROUND_SEGMENTS),
        "triangle": lambda: _regular(3),
        "hexagon": lambda: _regular(6),
        "ring": _ring,
        "cross": _cross,
        "crescent": _crescent,
    }
)
"""Shapes by name. Star, box and disc are those of the published scenes (package tactile-mnist 0.13.0)."""


@cache
def outline(name: str) -> Outline:
    """Return the rings of a shape, each of shape (n, 2), read-only; unit: the circumscribed radius.

    Frame: origin at the centre of the circumscribed circle, first corner of a star on +x.

    Raises
    ------
    InputError
        When there is no such shape.
    """
    if name not in OUTLINES:
        message = f"unknown shape {name!r}; expected one of {', '.join(OUTLINES)}"
        raise InputError(message)
    return OUTLINES[name]()


@dataclass(frozen=True, slots=True)
class Shape:
    """A shape and its size.

    Parameters
    ----------
    name : str
        One of :data:`OUTLINES`.
    radius_m : float
        Circumscribed radius, metres.

    Raises
    ------
    InputError
        Unknown name, or a radius outside 0.1 mm to 1 m.
    """

    name: str
    radius_m: float = PUBLISHED_RADIUS_M

    def __post_init__(self) -> None:
        outline(self.name)
        if not 1e-4 <= self.radius_m <= 1.0:
            message = f"radius_m of shape {self.name!r} is {self.radius_m}; expected 0.0001 to 1 (metres)"
            raise InputError(message)

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {"name": self.name, "radius_m": self.radius_m}
