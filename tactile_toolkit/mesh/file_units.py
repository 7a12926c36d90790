"""Units of mesh files: options, and plausibility by size; light, because --help imports it."""

from __future__ import annotations

import math

from tactile_toolkit.checked_fields import choice
from tactile_toolkit.columns.units import MM_PER_UNIT
from tactile_toolkit.errors import InputError

UNITS = ("mm", "cm", "m", "in")

UNIT = choice(
    None,
    UNITS,
    optional=True,
    name="--unit",
    help="Unit of STL, PLY and OBJ files, mm by default; 3MF and GLB files state their unit.",
)
"""Option of commands that take mesh files."""

_MIN_MM, _MAX_MM, _USUAL_MM = 1.0, 1000.0, 50.0


def require_unit(unit: str | None) -> None:
    """Raise InputError unless a unit is one of :data:`UNITS`, or None."""
    if unit is not None and unit not in UNITS:
        raise InputError(f"unit is {unit!r}; expected one of {', '.join(UNITS)}")


def refuse_unit(unit: str | None, name: str) -> None:
    """Raise InputError if a unit is given for something that is not a mesh file."""
    if unit is not None:
        raise InputError(f"--unit is for mesh files, and {name!r} is not one; data sets are in metres")


def require_likely_size(size_mm: float, unit: str | None, stated: str | None) -> None:
    """Refuse an object smaller than 1 mm or larger than 1 m, unless its unit was given.

    Parameters
    ----------
    size_mm : float
        Longest side of the object, mm; the check of the solid refuses 0 and values that are not finite.
    unit : str or None
        Unit that the user gave.
    stated : str or None
        Unit that the file states; None for formats that state none.

    Raises
    ------
    InputError
        The message names the unit in which the object would be nearest to 50 mm.
    """
    is_meant = unit is not None and stated in (None, unit)
    if is_meant or _MIN_MM <= size_mm <= _MAX_MM or not size_mm or not math.isfinite(size_mm):
        return
    read_as = stated or "mm"
    number = size_mm / MM_PER_UNIT[read_as]
    likely = min(UNITS, key=lambda name: abs(math.log(number * MM_PER_UNIT[name] / _USUAL_MM)))
    found = f"the object, read in {read_as}, is {size_mm:.3g} mm long; expected {_MIN_MM:g} to {_MAX_MM:g} mm"
    meant = f"--unit {read_as} if it is meant to be so"
    if likely == read_as:
        raise InputError(found, next=f"scale it, or give {meant}")
    found += f"; it is probably in {likely}"
    if stated is not None:
        raise InputError(f"{found}, but the file states {stated}", next=f"export it again, or give {meant}")
    raise InputError(found, next=f"give --unit {likely} (in Python, unit={likely!r}), or {meant}")
