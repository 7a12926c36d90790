"""Text about the gel in the card of a data set of touches: pressed to one depth, or elastic."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from tactile_toolkit.json_types import JsonObject

_RIGID_LIMIT = (
    "No force, dynamics or tilt: the gel stops by geometry only, and nothing moves while it is touched."
)
_ELASTIC_LIMITS = (
    "No tilt. The gel is a linear elastic layer without side faces: no viscosity, no adhesion, no large "
    "strain; a press of half the thickness, where one by force stops, is indicative only.",
    "A slide and a twist are applied in one step after the press; real contact depends on its history.",
)


@dataclass(frozen=True)
class CardGel:
    """Texts of a card: stop of the sensor, surface that images show, further columns, table, limits."""

    stops: str
    shown: str
    more: str
    lines: Sequence[tuple[str, str]]
    limits: Sequence[str]

    @classmethod
    def of(cls, spec: JsonObject) -> CardGel:
        """Return the words for a specification, as its manifest states it."""
        press = spec.get("press")
        if press is None:
            return cls("", "depth", "", (), (_RIGID_LIMIT,))
        stops = f"the force is {_span(press['force_n'], 1.0)} N, or half of the gel is pressed in"
        if press["force_n"] is None:
            stops = f"the highest point under it is {_span(press['press_m'], 1e3)} mm deep in it"
        material = (
            f"elastic: Young's modulus {press['youngs_modulus_pa'] / 1e6:g} MPa, Poisson's ratio "
            f"{press['poisson_ratio']:g}, friction {press['friction']:g}"
        )
        lines = [("gel", material)]
        for what, name, factor, unit in (
            ("slide after the press", "slide_m", 1e3, "mm"),
            ("twist after the press", "twist_rad", 180 / math.pi, "degrees"),
        ):
            if any(press[name]):
                lines.append((what, f"{_span(press[name], factor)} {unit}"))
        if press["markers"] is not None:
            drawn = "not drawn" if not press["draw_markers"] else "drawn into the images"
            columns, rows = press["markers"]
            lines.append(("markers", f"{columns} columns, {rows} rows, {drawn}"))
        more = (
            "the pose of the object during the touch, `plate_z_m`, and what the gel feels, which "
            '`touch.extra["force_n"]` and so on read'
        )
        return cls(stops, "the surface of the gel", more, lines, _ELASTIC_LIMITS)


def _span(ends: Sequence[float], factor: float) -> str:
    low, high = (f"{factor * end:.4g}" for end in ends)
    return low if low == high else f"{low} to {high}"
