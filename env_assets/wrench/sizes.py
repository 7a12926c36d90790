"""Widths across flats of hexagon nuts and screws by thread."""

from __future__ import annotations

from tactile_toolkit.errors import InputError

__all__ = ["LARGEST_MM", "SMALLEST_MM", "WIDTHS_ACROSS_FLATS_MM", "next_smaller_mm", "width_across_flats_mm"]

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


def width_across_flats_mm(size: str | float) -> float:
    """Return the width across flats that a size means.

    Parameters
    ----------
    size : str or float
        A thread (``"M8"``) or a width in millimetres (``13``, ``"13"``), of the table or not.

    Raises
    ------
    InputError
        No such thread, no number, or one out of range.

    Examples
    --------
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
        message = (
            f"no wrench of size {str(size)!r} is made; expected a width across flats of {SMALLEST_MM:g} to "
            f"{LARGEST_MM:g} mm or a thread: {known}"
        )
        raise InputError(message)
    return width_mm


def next_smaller_mm(width_mm: float) -> float:
    """Return the next smaller width of the table; of the smallest, the next larger one.

    The ends of a wrench differ, so that its pose can be told from either.
    """
    smaller = [width for width in WIDTHS_ACROSS_FLATS_MM.values() if width < width_mm]
    larger = [width for width in WIDTHS_ACROSS_FLATS_MM.values() if width > width_mm]
    return smaller[-1] if smaller else larger[0]
