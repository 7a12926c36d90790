"""Options for meshes: the unit of files, and the limits of a printer; light, because --help imports it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tactile_toolkit.checked_fields import check_fields, choice, real
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
# Smaller objects are usual in inches only.
_MIN_USUAL_MM, _MIN_USUAL_MM3 = 5.0, 9.0

# Slicers fill a wall with one line on each side.
_LINES_OF_WALL = 2


def require_unit(unit: str | None) -> None:
    """Raise InputError unless a unit is one of :data:`UNITS`, or None."""
    if unit is not None and unit not in UNITS:
        raise InputError(f"is {unit!r}; expected one of {', '.join(UNITS)}", field="unit")


def refuse_unit(unit: str | None, name: str) -> None:
    """Raise InputError if a unit is given for something that is not a mesh file."""
    if unit is not None:
        problem = f"is for mesh files, and {name!r} is not one; data sets are in metres"
        raise InputError(problem, next="leave it out", field="unit")


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
    problem = (
        f"the object, read in {read_as}, is {size_mm:.3g} mm long; expected {_MIN_MM:g} to {_MAX_MM:g} mm"
    )
    meant = f"--unit {read_as} if it is meant to be so"
    if likely == read_as:
        raise InputError(problem, next=f"scale it, or give {meant}")
    problem += f"; it is probably in {likely}"
    if stated is not None:
        raise InputError(f"{problem}, but the file states {stated}", next=f"export it again, or give {meant}")
    raise InputError(problem, next=f"give --unit {likely} (in Python, unit={likely!r}), or {meant}")


def size_notes(size_mm: float, volume_mm3: float) -> tuple[str, ...]:
    """Return a note about an object so small that its file may be in inches; empty for others.

    ``size_mm`` is its longest side. The limit of the volume is that of PrusaSlicer.
    """
    if not (size_mm < _MIN_USUAL_MM or 0 < volume_mm3 < _MIN_USUAL_MM3):
        return ()
    inches_mm = size_mm * MM_PER_UNIT["in"]
    return (f"it is {size_mm:.3g} mm long; if it should be {inches_mm:.3g} mm, add --unit in",)


@dataclass(frozen=True, slots=True)
class PrintProfile:
    """Limits of the printer and the material.

    Attributes
    ----------
    nozzle_mm : float
        Line width.
    layer_height_mm : float
        Thickness of a printed layer.
    plate_mm : tuple of float
        Width and depth of the plate.
    max_height_mm : float
        Largest height of a print.
    min_wall_mm : float
        Thinner walls give a warning; twice ``nozzle_mm`` by default.
    overhang_deg : float
        Slopes that lean out by more than this from the vertical need support.
    max_overhang_share : float
        Largest ratio of the overhanging area to the area of the middle section without a warning. The round
        undersides of digits overhang by design, with ratios of 0.47 to 0.71 (99 % of 119 real digits below
        0.70).
    min_contact_mm2 : float
        Smaller first layers give a warning. Digits with ink 28 px wide have 10 mm^2, those with 35 px 100
        mm^2 or more.
    density_g_cm3 : float
        Density of the material; 1.24 is PLA.
    """

    nozzle_mm: float = real(0.4, above=0)
    layer_height_mm: float = real(0.2, above=0)
    plate_mm: tuple[float, float] = real((256.0, 256.0), above=0, many=2)
    max_height_mm: float = real(256.0, above=0)
    min_wall_mm: float = real(None, above=0, optional=True)
    overhang_deg: float = real(45.0, above=0, below=90)
    max_overhang_share: float = real(0.72, above=0)
    min_contact_mm2: float = real(10.0, above=0)
    density_g_cm3: float = real(1.24, above=0)

    def __post_init__(self) -> None:
        """Raise InputError for impossible values."""
        check_fields(self, "the print profile")
        min_wall_mm: float | None = self.min_wall_mm
        if min_wall_mm is None:
            object.__setattr__(self, "min_wall_mm", _LINES_OF_WALL * self.nozzle_mm)

    @property
    def floating_mm(self) -> float:
        """Height above which a part floats: slicers cut the first layer at its middle."""
        return self.layer_height_mm / 2
