"""Units as numbers and as names of columns state them: ``x_mm`` is in mm, ``time_ms`` in milliseconds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from tactile_toolkit.errors import InputError

MM_PER_UNIT = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4, "ft": 304.8, "um": 1e-3}

_PER_METRE = {unit: MM_PER_UNIT["m"] / MM_PER_UNIT[unit] for unit in ("mm", "cm", "m")}
_PER_RADIAN = {"deg": math.degrees(1.0), "rad": 1.0}
_PER_SECOND = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}


def conversion_factor(column: str, target: str) -> float | None:
    """Return the factor from the unit of a column to that of one with the same name in another unit.

    None for other names: ``slide_mm`` becomes ``slide_m`` by 0.001.
    """
    stem, _, unit = column.rpartition("_")
    target_stem, _, target_unit = target.rpartition("_")
    for per_unit in (_PER_METRE, _PER_RADIAN, _PER_SECOND):
        if stem and stem == target_stem and {unit, target_unit} <= per_unit.keys():
            return per_unit[target_unit] / per_unit[unit]
    return None


@dataclass(frozen=True, slots=True)
class Quantity:
    """A quantity: its name in messages, its option, and how many of each unit make one SI unit."""

    LENGTH: ClassVar[Quantity]
    ANGLE: ClassVar[Quantity]
    TIME: ClassVar[Quantity]

    name: str
    option: str
    per_unit: dict[str, float]

    @staticmethod
    def stated_unit(name: str) -> str | None:
        """Return the unit that the name of a column ends with, such as ``mm``; None without one."""
        _, _, ending = name.rpartition("_")
        unit = ending.lower()
        is_known = unit in _PER_METRE or unit in _PER_RADIAN or unit in _PER_SECOND
        return unit if "_" in name and is_known else None

    def divisor(self, column: str, unit: str | None = None) -> float:
        """Return the number of units of a column in a metre, radian or second.

        The name of the column states the unit, or ``unit`` does; else it is metre, radian or second.
        InputError: both state one and differ, or the column states the unit of another quantity.
        """
        stated = self.stated_unit(column)
        if stated and (stated not in self.per_unit or (unit and stated != unit)):
            expected = f"{unit}, as {self.option} states" if unit else self.name
            raise InputError(
                f"the column {column!r} states {stated} in its name; expected {expected}",
                next="rename the column, or name another one",
            )
        return self.per_unit.get(stated or unit or "", 1.0)


Quantity.LENGTH = Quantity("a length", "--length-unit", _PER_METRE)
Quantity.ANGLE = Quantity("an angle", "--angle-unit", _PER_RADIAN)
Quantity.TIME = Quantity("a time", "--time-unit", _PER_SECOND)
