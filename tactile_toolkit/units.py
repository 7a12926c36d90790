"""Units of length and angle, as numbers and as names of columns state them: ``x_mm`` is in millimetres."""

from __future__ import annotations

import math

from tactile_toolkit.errors import InputError

MM_PER_UNIT = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4, "ft": 304.8, "um": 1e-3}

PER_METRE = {unit: MM_PER_UNIT["m"] / MM_PER_UNIT[unit] for unit in ("mm", "cm", "m")}
"""Number of units in a metre, for units of columns."""

PER_RADIAN = {"deg": math.degrees(1.0), "rad": 1.0}
"""Number of units in a radian."""

PER_SECOND = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
"""Number of units in a second."""


def stated_unit(name: str) -> str | None:
    """Return the unit that the name of a column ends with, such as ``mm`` or ``deg``; None without one."""
    _, _, ending = name.rpartition("_")
    unit = ending.lower()
    return unit if "_" in name and (unit in PER_METRE or unit in PER_RADIAN) else None


def length_per_metre(name: str, given: str | None = None) -> float:
    """Return the number of units of a column in a metre.

    The name of the column states the unit, or ``given`` does; the default is metres. InputError: both state
    one and differ, or the column states an angle.
    """
    stated = stated_unit(name)
    if stated in PER_RADIAN or (stated and given and stated != given):
        expected = f"{given}, as --length-unit states" if given else "a length"
        raise InputError(
            f"the column {name!r} states {stated} in its name; expected {expected}",
            next="rename the column, or name another one",
        )
    return PER_METRE[stated or given or "m"]
