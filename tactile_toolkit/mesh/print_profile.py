"""What a printer and its material allow."""

from __future__ import annotations

from dataclasses import dataclass

from tactile_toolkit.checked_fields import check_fields, real


@dataclass(frozen=True, slots=True)
class PrintProfile:
    """What the printer and the material allow.

    Attributes
    ----------
    nozzle_mm : float
        Width of the thread of material; a wall needs two of them.
    layer_height_mm : float
        Thickness of a printed layer.
    plate_mm : tuple of float
        Width and depth of the plate.
    max_height_mm : float
        Tallest print.
    min_wall_mm : float
        Thinner walls give a warning.
    overhang_deg : float
        Slopes that lean out further than this from the vertical need support.
    max_overhang_share : float
        Overhanging area over the area of the middle section above which it is warned of. The round
        undersides of the digits overhang by design, by 0.47 to 0.71 of it (99 % of 119 real ones, every
        fourth, below 0.70).
    min_contact_mm2 : float
        Smaller first layers give a warning. Digits with ink 28 px wide have 10 mm^2, with 35 px 100 mm^2 or
        more.
    density_g_cm3 : float
        Of the material; 1.24 is PLA.
    """

    nozzle_mm: float = real(0.4, above=0)
    layer_height_mm: float = real(0.2, above=0)
    plate_mm: tuple[float, float] = real((256.0, 256.0), above=0, many=2)
    max_height_mm: float = real(256.0, above=0)
    min_wall_mm: float = real(0.8, above=0)
    overhang_deg: float = real(45.0, above=0, below=90)
    max_overhang_share: float = real(0.72, above=0)
    min_contact_mm2: float = real(10.0, above=0)
    density_g_cm3: float = real(1.24, above=0)

    def __post_init__(self) -> None:
        """Refuse numbers that no printer has."""
        check_fields(self, "the print profile")
