"""Materials of bodies for simulators, as commands take them; light, for --help needs it."""

from __future__ import annotations

from dataclasses import dataclass

from tactile_toolkit.checked_fields import check_fields, real

MODELS = {"mjcf": ".xml", "urdf": ".urdf", "usd": ".usda"}
"""Formats of bodies for simulators, and how their files end."""


@dataclass(frozen=True, slots=True)
class Physics:
    """What the material of a body is like.

    ``density_kg_m3`` is that of the solid body, by default of PLA as printers take it; a print that is not
    filled is lighter. ``friction`` is the coefficient of sliding, our own default.
    """

    density_kg_m3: float = real(
        1240.0, above=0, most=1e5, help="Density of bodies for simulators; that of PLA."
    )
    friction: float = real(0.5, above=0, most=100, help="Sliding friction of bodies for simulators.")

    def __post_init__(self) -> None:
        check_fields(self, "the material")
