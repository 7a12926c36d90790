"""The size of the solid of a picture."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from tactile_toolkit.checked_fields import check_fields, real
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import MM_PER_M, Mesh


@dataclass(frozen=True, slots=True)
class SolidSize:
    """How large the solid of a picture is; at most one of the lengths is given.

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

    def fitted(self, solid: Mesh) -> Mesh:
        """Scale a solid along x and y to the height or width that is asked for; the thickness stays.

        Pixels alone do not give it: the outline lies between pixels, cleaning moves it, and the lattice cuts
        off tips, which adds up to half a millimetre. The middle of the solid becomes the origin of x and y.
        """
        asked = next(((axis, mm) for axis, mm in enumerate((self.width_mm, self.height_mm)) if mm), None)
        if asked is None:
            return solid
        axis, asked_mm = asked
        low, high = solid.vertices_m.min(axis=0)[:2], solid.vertices_m.max(axis=0)[:2]
        vertices_m = solid.vertices_m.astype(np.float64)
        vertices_m[:, :2] -= (low.astype(np.float64) + high) / 2
        vertices_m[:, :2] *= asked_mm / MM_PER_M / float(high[axis] - low[axis])
        return Mesh(vertices_m.astype(np.float32), solid.faces)
