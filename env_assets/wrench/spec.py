"""Every number of a wrench, and the widths across flats of nuts and screws by thread."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, Self

from tactile_toolkit.checked_fields import check_fields, real
from tactile_toolkit.errors import InputError

WIDTHS_ACROSS_FLATS_MM: dict[str, float] = {
    "M3": 5.5,
    "M4": 7.0,
    "M5": 8.0,
    "M6": 10.0,
    "M8": 13.0,
    "M10": 16.0,
    "M12": 18.0,
    "M14": 21.0,
    "M16": 24.0,
    "M20": 30.0,
    "M24": 36.0,
}
"""Thread to width across flats (ISO 272:1982, hexagon products; ISO 4014 and ISO 4017 use them)."""

SMALLEST_MM, LARGEST_MM = 5.0, 60.0
"""Widths that wrenches are made for: smaller jaws do not print, larger wrenches fit no printer."""

# Three threads of a 0.4 mm nozzle: thinner jaws break.
_LEAST_WALL_MM = 1.2


@dataclass(frozen=True, slots=True)
class WrenchSpec:
    """The lengths of a wrench. Two jaws by default; ``second_opening_mm=0`` gives a plain, rounded end.

    The widths across flats of the standard sizes are those of ISO 272 (:data:`WIDTHS_ACROSS_FLATS_MM`), and
    15 degrees is the usual angle of open-end jaws. All other proportions are the toolkit's own, drawn for
    printing; they follow no standard.

    Parameters
    ----------
    opening_mm : float
        Width across flats of the nut that the first jaw takes.
    second_opening_mm : float
        The same of the second jaw; 0 for none.
    length_mm : float
        Between the outermost points of the circles of both ends.
    head_mm, second_head_mm : float
        Diameter of the circles of both ends.
    handle_mm : float
        Width of the handle.
    thickness_mm : float
        Thickness of the wrench.
    jaw_angle_deg : float
        Between handle and jaws; both jaws are turned the same way round.
    clearance_mm : float
        By how much a jaw is wider than its nut.
    fillet_mm : float
        Radius where the handle meets the ends.
    chamfer_mm : float
        Slope of 45 degrees around top and bottom; 0 for sharp edges.

    Raises
    ------
    InputError
        Lengths that give no wrench; the message names the one to change.

    Examples
    --------
    >>> spec = WrenchSpec.for_size("M8")
    >>> spec.opening_mm, spec.second_opening_mm, spec.length_mm
    (13.0, 10.0, 157.5)
    """

    opening_mm: float = real(above=0)
    second_opening_mm: float = real(least=0)
    length_mm: float = real(
        above=0,
        help="Length between the outermost points of the circles of both ends; jaws cut into these, so "
        "the solid is a little shorter. By default in the usual proportion, as the next two.",
    )
    head_mm: float = real(above=0)
    second_head_mm: float = real(above=0)
    handle_mm: float = real(above=0, help="Width of the handle.")
    thickness_mm: float = real(above=0, help="Thickness of the wrench.")
    jaw_angle_deg: float = real(15.0, 0, 90, help="Angle between the handle and the jaws.")
    clearance_mm: float = real(0.2, 0, help="By how much a jaw is wider than its nut.")
    fillet_mm: float = real(10.0, 0)
    chamfer_mm: float = real(0.6, 0, help="Size of the chamfer around top and bottom.")

    def __post_init__(self) -> None:
        check_fields(self, "the wrench")
        _require_proportions(self)

    @classmethod
    def for_size(
        cls,
        size: str | float = 13.0,
        second: str | float | None = None,
        *,
        single: bool = False,
        **lengths: float,
    ) -> Self:
        """Return a wrench for a nut.

        Parameters
        ----------
        size : str or float
            Thread (``"M8"``) or width across flats in millimetres of the first jaw.
        second : str or float, optional
            The same of the second jaw; the next smaller size of the table by default.
        single : bool
            Make only one jaw.
        **lengths
            Any other field, in place of its proportion.

        Raises
        ------
        InputError
            Unknown sizes, or lengths that give no wrench.
        """
        opening_mm = width_across_flats_mm(size)
        if single and second is not None:
            raise InputError(
                f"a second size ({second}) was given for a wrench with a single jaw", next="give one of both"
            )
        second_mm = next_smaller_mm(opening_mm) if second is None else width_across_flats_mm(second)
        second_mm = 0.0 if single else second_mm
        largest_mm = max(opening_mm, second_mm)
        proportions = {
            "length_mm": 60.0 + 7.5 * largest_mm,
            "head_mm": 2.2 * opening_mm,
            "second_head_mm": 2.2 * second_mm or opening_mm + 2.0,
            "handle_mm": 0.85 * min(opening_mm, second_mm or opening_mm) + 2.0,
            "thickness_mm": max(4.0, 0.3 * largest_mm + 2.0),
            "fillet_mm": 0.8 * largest_mm,
        }
        rounded = {name: round(length_mm, 3) for name, length_mm in proportions.items()}
        return cls(opening_mm, second_mm, **(rounded | lengths))

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values; equal values give equal wrenches."""
        return asdict(self)


def _require_proportions(spec: WrenchSpec) -> None:
    def require(name: str, fits: bool, expected: str) -> None:
        if not fits:
            raise InputError(f"{name} of the wrench is {getattr(spec, name):g}; expected {expected}")

    heads = (("head_mm", spec.opening_mm), ("second_head_mm", spec.second_opening_mm))
    for name, opening_mm in heads:
        head_mm = getattr(spec, name)
        # The far corner of the nut needs the most room: its distance from the middle is the width / sqrt(3).
        least_mm = 2 * ((opening_mm + spec.clearance_mm) / math.sqrt(3) + _LEAST_WALL_MM + spec.chamfer_mm)
        fits = not opening_mm or head_mm >= least_mm
        require(name, fits, f"{least_mm:.1f} or more for a jaw of {opening_mm:g}")
        # A wider handle would swallow the circle of the head, and the jaw would be cut into the handle.
        require("handle_mm", spec.handle_mm <= head_mm, f"at most {name} ({head_mm:g})")
    if (spec.opening_mm, spec.head_mm) == (spec.second_opening_mm, spec.second_head_mm):
        raise InputError(
            f"both ends of the wrench are alike ({spec.opening_mm:g} mm): turned about it would look the "
            "same, so that its pose could not be found",
            next="choose another second size",
        )
    ends_mm = spec.head_mm + spec.second_head_mm
    require("length_mm", spec.length_mm >= ends_mm, f"{ends_mm:g} or more, which its ends take")
    most_mm = 0.4 * spec.thickness_mm
    require("chamfer_mm", spec.chamfer_mm <= most_mm, f"at most {most_mm:g}, 0.4 of thickness_mm")
    # The rounding of the corners takes away what is narrower than twice its radius.
    least_mm = max(2.0, 4 * spec.chamfer_mm)
    require("handle_mm", spec.handle_mm > least_mm, f"more than {least_mm:g}, by chamfer_mm")


def width_across_flats_mm(size: str | float) -> float:
    """Return the width across flats that a size means: a thread (``"M8"``) or millimetres (``13``, ``"13"``).

    >>> width_across_flats_mm("M8"), width_across_flats_mm("13")
    (13.0, 13.0)
    """
    text = str(size).strip().upper()
    if text in WIDTHS_ACROSS_FLATS_MM:
        return WIDTHS_ACROSS_FLATS_MM[text]
    try:
        width_mm = float(text)
    except ValueError:
        width_mm = float("nan")
    if not SMALLEST_MM <= width_mm <= LARGEST_MM:
        known = ", ".join(f"{thread} ({width:g} mm)" for thread, width in WIDTHS_ACROSS_FLATS_MM.items())
        raise InputError(
            f"no wrench of size {str(size)!r} is made; expected a width across flats of {SMALLEST_MM:g} to "
            f"{LARGEST_MM:g} mm or a thread: {known}"
        )
    return width_mm


def next_smaller_mm(width_mm: float) -> float:
    """Return the next smaller width of the table; of the smallest, the next larger one.

    The ends of a wrench differ, so that either end shows its pose.
    """
    smaller = [width for width in WIDTHS_ACROSS_FLATS_MM.values() if width < width_mm]
    larger = [width for width in WIDTHS_ACROSS_FLATS_MM.values() if width > width_mm]
    return smaller[-1] if smaller else larger[0]
