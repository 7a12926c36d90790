"""Units that names of columns state: ``x_mm`` is in millimetres, ``turn_deg`` in degrees."""

from __future__ import annotations

import math
from typing import Literal

from tactile_toolkit.errors import InputError

LengthUnit = Literal["mm", "cm", "m"]

PER_METRE: dict[str, float] = {"mm": 1000.0, "cm": 100.0, "m": 1.0}
"""How many of each unit make a metre."""

PER_RADIAN = {"deg": math.degrees(1.0), "rad": 1.0}
"""How many of each unit make a radian."""


def stated_unit(name: str) -> str | None:
    """Return the unit in which the name of a column ends, such as ``mm`` or ``deg``; None if in none."""
    _, _, ending = name.rpartition("_")
    unit = ending.lower()
    return unit if "_" in name and (unit in PER_METRE or unit in PER_RADIAN) else None


def length_per_metre(name: str, given: str | None = None) -> float:
    """Return by what the lengths of a column are divided to be metres.

    The name of the column states the unit, or ``given`` does; metres where none does. InputError where both
    do and differ, and for an angle.
    """
    stated = stated_unit(name)
    if stated in PER_RADIAN or (stated and given and stated != given):
        expected = f"{given}, as --length-unit states" if given else "a length"
        raise InputError(
            f"the column {name!r} states {stated} in its name; expected {expected}",
            next="rename the column, or name another one",
        )
    return PER_METRE[stated or given or "m"]
