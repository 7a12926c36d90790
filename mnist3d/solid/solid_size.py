"""The size of the solid of a picture."""

from __future__ import annotations

from dataclasses import dataclass, fields

from tactile_toolkit.checked_fields import check_fields, real
from tactile_toolkit.errors import InputError


@dataclass(frozen=True, slots=True)
class SolidSize:
    """Size of the solid of a picture; at most one of the lengths is given.

    Without a length, the longer side of the picture is 100 mm, as for the digits of a data set.

    Attributes
    ----------
    height_mm, width_mm : float, optional
        Size of the solid along y or x, as the picture is seen.
    pixel_mm : float, optional
        Side of a pixel of the picture.
    """

    height_mm: float | None = real(
        None, above=0, optional=True, help="Height of the solid, as the picture is seen, without its plate."
    )
    width_mm: float | None = real(
        None, above=0, optional=True, help="Width of the solid, as the picture is seen, without its plate."
    )
    pixel_mm: float | None = real(None, above=0, optional=True, help="Side of a pixel of the picture.")

    def __post_init__(self) -> None:
        check_fields(self, "the size of the solid")
        given = [each.name for each in fields(self) if getattr(self, each.name) is not None]
        if len(given) > 1:
            raise InputError(
                f"two sizes are given, {given[0]} and {given[1]}; expected one: pictures keep their shape",
                next=f"leave out {given[1]}",
            )
