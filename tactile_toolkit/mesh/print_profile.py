"""Limits of a printer and its material."""

from __future__ import annotations

from dataclasses import dataclass

from tactile_toolkit.checked_fields import check_fields, real

# Slicers fill a wall with one line on each side.
_LINES_OF_WALL = 2


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
        given: float | None = self.min_wall_mm
        if given is None:
            object.__setattr__(self, "min_wall_mm", _LINES_OF_WALL * self.nozzle_mm)
