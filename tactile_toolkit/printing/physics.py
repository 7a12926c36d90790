"""Materials of bodies for simulators, as options; light, because --help imports it."""

from __future__ import annotations

from dataclasses import dataclass

from tactile_toolkit.checked_fields import check_fields, real

MODELS = {"mjcf": ".xml", "urdf": ".urdf", "usd": ".usda"}
"""Formats of bodies for simulators, and the endings of their files."""


@dataclass(frozen=True, slots=True)
class Physics:
    """Material of a body.

    ``density_kg_m3`` is that of the filled body, by default of PLA; a print with infill is lighter.
    ``friction`` is the coefficient of sliding friction; its default is not measured.
    """

    density_kg_m3: float = real(
        1240.0, above=0, most=1e5, help="Density of bodies for simulators; PLA by default."
    )
    friction: float = real(0.5, above=0, most=100, help="Sliding friction of bodies for simulators.")

    def __post_init__(self) -> None:
        check_fields(self, "the material")
