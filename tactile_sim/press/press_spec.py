"""Specification of presses of an elastic gel.

This module is imported by commands for their options, and imports nothing heavy.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from tactile_toolkit import checked_fields, wording
from tactile_toolkit.checked_fields import check_fields, switch, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import lazy
from tactile_toolkit.value_types import JsonDict

if TYPE_CHECKING:
    from tactile_sim.elastic.contact import Gel


FORCE_N = 5.0
"""Normal force of a press unless one is given, newtons: at which the authors of Tactile MNIST stopped."""
Span: TypeAlias = tuple[float, float]
"""Least and greatest value; each touch draws its own."""
MAX_FORCE_N = 1000.0
MAX_SLIDE_M = 0.001
MAX_TWIST_RAD = math.radians(10.0)
"""Greatest slide, metres, and turn in either direction, radians: beyond them all contacts slip."""
_MAX_PRESS_M = 0.05
_MAX_MARKERS = 100  # along a side
# Panel of the help.
_PANEL = "Elastic gel"
_GELS = "none|elastic|FILE"

# Factor and unit with which messages show values in newtons, radians and metres.
_SHOWN_IN = {
    "force_n": (1.0, "N"),
    "friction": (1.0, ""),
    "mass_kg": (1e3, "g"),
    "twist_rad": (180 / math.pi, "degrees"),
}
_SHOWN_LENGTH = (1e3, "mm")
_gel = lazy("tactile_sim.elastic.contact:Gel")
_read_gel = lazy("tactile_sim.press.elastic_press:read_gel")


def gel_named(word: str) -> Gel | None:
    """Return the gel that an option names; None for a gel that is not elastic."""
    if word == "none":
        return None
    made: Gel
    if word == "elastic":
        made = _gel()
    elif word.endswith(".json"):
        made = _read_gel(word)
    else:
        raise InputError(f"is {word!r}; expected none, elastic, or a JSON file", field="gel")
    return made


def span_of(name: str, per_unit: float) -> Callable[[str], Span]:
    """Return a function that reads a span, ``A`` or ``A:B``; ``per_unit`` converts it to the SI unit."""

    def read(words: str) -> Span:
        ends = words.split(":")
        try:
            numbers = [float(end) * per_unit for end in ends]
        except ValueError:
            numbers = []
        if len(numbers) not in (1, 2) or not all(map(math.isfinite, numbers)):
            raise InputError(f"is {words!r}; expected a number, or two as in 1:10", field=name)
        return numbers[0], numbers[-1]

    return read


def markers_of(words: str) -> tuple[int, int]:
    """Return columns and rows of markers, as in ``7x9``; InputError for other words."""
    markers = wording.counts(words.lower(), "x")
    if len(markers) != 2:
        raise InputError(f"is {words!r}; expected COLUMNSxROWS, such as 7x9", field="markers")
    return markers


def checked_markers(markers: object) -> tuple[int, int]:
    """Return columns and rows of markers as Python's own integers; InputError for anything else."""
    grid = checked_fields.to_builtin(markers)
    is_pair = isinstance(grid, tuple) and len(grid) == 2 and checked_fields.is_integer(*grid)
    if not is_pair or not 1 <= min(grid) <= max(grid) <= _MAX_MARKERS:
        raise InputError(f"are {markers!r}; expected columns and rows, 1 to {_MAX_MARKERS}", field="markers")
    return grid[0], grid[1]


def checked_span(
    name: str,
    value: object,
    most: float,
    owner: str,
    *,
    least: float = 0.0,
    above: float = -math.inf,
) -> Span:
    """Return a number or a pair as a span; InputError unless it ascends and lies within bounds.

    ``name`` is the field, in the SI unit, and ``owner`` what it belongs to in messages.
    """
    ends = checked_fields.to_builtin(value, float)
    if isinstance(ends, float):
        ends = (ends, ends)
    is_pair = isinstance(ends, tuple) and len(ends) == 2 and all(isinstance(end, float) for end in ends)
    if not is_pair or not (least <= ends[0] <= ends[1] <= most and ends[0] > above):
        factor, unit = _SHOWN_IN.get(name, _SHOWN_LENGTH)
        span = f"from {factor * least:g} to {factor * most:g} {unit}".rstrip()
        if above == 0:
            span = f"above 0, to {factor * most:g} {unit}".rstrip()
        shown = repr(value)
        if is_pair:
            shown = f"{':'.join(f'{factor * end:g}' for end in dict.fromkeys(ends))} {unit}".rstrip()
        raise InputError(
            f"of {owner} is {shown}; expected a number {span}, or two in ascending order", field=name
        )
    return ends[0], ends[1]


def _list_or_none(values: tuple[float, ...] | None) -> list[float] | None:
    if values is None:
        return None
    return list(values)


@dataclass(frozen=True)
class ElasticPress:
    """Press of an elastic gel, the motion after it, and the data that are stored.

    A span is the least and the greatest value, between which each touch draws uniformly.

    Attributes
    ----------
    gel : Gel
        Material and friction of the gel.
    force_n : tuple of float, optional
        Normal force at which the sensor stops, newtons; 5 unless ``press_m`` is given. The
        sensor presses at most to half the thickness of the gel.
    press_m : tuple of float, optional
        How far the highest point under the gel is pressed in, metres; in place of a force.
    slide_m : tuple of float
        How far the object then slides under the gel, metres; each touch draws its direction.
    twist_rad : tuple of float
        How far it turns, radians, counter-clockwise in the image.
    markers : tuple of int, optional
        Columns and rows of markers on the gel, whose motion is stored.
    draw_markers : bool
        Whether images show the markers.
    contact_maps : bool
        Whether pressure and displacement of each pixel are stored.

    Raises
    ------
    InputError
        A value is out of range, or both a force and a depth are given.
    """

    gel: Gel | None = text(
        None,
        metavar=_GELS,
        panel=_PANEL,
        read=gel_named,
        shown="none",
        complete=("none", "elastic"),
        help="none: presses of one depth, as published; elastic: a gel that deforms, with forces; or its "
        "properties from a JSON file.",
    )
    force_n: Span | None = text(
        name="--force-n",
        metavar="A[:B]",
        needs="gel=elastic",
        panel=_PANEL,
        read=span_of("force_n", 1.0),
        shown=f"{FORCE_N:g}",
        help="Normal force of a press of an elastic gel, newtons; of A:B each touch draws one.",
    )
    press_m: Span | None = text(
        name="--press-mm",
        metavar="A[:B]",
        needs="gel=elastic",
        panel=_PANEL,
        read=span_of("press_m", 1e-3),
        help="Depth of a press of an elastic gel, instead of a force.",
    )
    slide_m: Span | None = text(
        name="--slide-mm",
        metavar="A[:B]",
        needs="gel=elastic",
        panel=_PANEL,
        read=span_of("slide_m", 1e-3),
        shown="0",
        help="How far the object slides after the press, in a random direction.",
    )
    twist_rad: Span | None = text(
        name="--twist-deg",
        metavar="A[:B]",
        needs="gel=elastic",
        panel=_PANEL,
        read=span_of("twist_rad", math.pi / 180),
        shown="0",
        help="How far the object turns after the press, about the axis of the sensor.",
    )
    markers: tuple[int, int] | None = text(
        None,
        metavar="COLUMNSxROWS",
        needs="gel=elastic",
        panel=_PANEL,
        read=markers_of,
        help="Markers on the gel, whose motion is stored.",
    )
    draw_markers: bool = switch(
        False, needs="markers", panel=_PANEL, help="Draw the markers into the images."
    )
    contact_maps: bool = switch(
        False, needs="gel=elastic", panel=_PANEL, help="Store pressure and displacement of each pixel."
    )

    def __post_init__(self) -> None:
        check_fields(self, "the press")
        if self.gel is None:
            object.__setattr__(self, "gel", _gel())
        if self.force_n is not None and self.press_m is not None:
            raise InputError(
                "a press has both a force and a depth; expected one of them",
                next="leave out press_m (--press-mm), or force_n (--force-n)",
            )
        if self.press_m is None:
            force_n = FORCE_N if self.force_n is None else self.force_n
            self._set_span("force_n", force_n, MAX_FORCE_N, above=0.0)
        else:
            self._set_span("press_m", self.press_m, _MAX_PRESS_M, above=0.0)
        self._set_span("slide_m", 0.0 if self.slide_m is None else self.slide_m, MAX_SLIDE_M)
        twist_rad = 0.0 if self.twist_rad is None else self.twist_rad
        self._set_span("twist_rad", twist_rad, MAX_TWIST_RAD, least=-MAX_TWIST_RAD)
        if self.markers is None and self.draw_markers:
            raise InputError(
                "are drawn, but there are none", next="give markers, such as --markers 7x9", field="markers"
            )
        if self.markers is not None:
            object.__setattr__(self, "markers", checked_markers(self.markers))

    def _set_span(
        self, name: str, value: object, most: float, *, least: float = 0.0, above: float = -math.inf
    ) -> None:
        span = checked_span(name, value, most, "the press", least=least, above=above)
        object.__setattr__(self, name, span)

    def to_dict(self) -> JsonDict:
        """Return JSON values that decide images and columns."""
        assert self.gel is not None
        return {
            "youngs_modulus_pa": self.gel.youngs_modulus_pa,
            "poisson_ratio": self.gel.poisson_ratio,
            "friction": self.gel.friction,
            "force_n": _list_or_none(self.force_n),
            "press_m": _list_or_none(self.press_m),
            "slide_m": list(self.slide_m or (0.0, 0.0)),
            "twist_rad": list(self.twist_rad or (0.0, 0.0)),
            "markers": _list_or_none(self.markers),
            "draw_markers": self.draw_markers,
            "contact_maps": self.contact_maps,
        }
