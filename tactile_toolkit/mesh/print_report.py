"""Reports about meshes: whether each is a solid, and how it prints."""

from __future__ import annotations

import math

import pyarrow as pa

from tactile_toolkit.json_types import JsonDict
from tactile_toolkit.rows import column, columns, row

WARNINGS = ("thin-wall", "separate-bodies", "overhang", "small-contact", "larger-than-plate", "too-tall")
"""Print warnings; the limits behind them are those of :class:`~mnist3d.PrintProfile`."""

UNREADABLE = "unreadable"
"""Problem of a file without a readable mesh; the others are those of ``solid_check.PROBLEMS``."""

NO_WARNING = "none"
"""Shown in place of warnings where there are none."""

_REAL, _COUNT, _WORD, _WORDS = pa.float64(), pa.int64(), pa.string(), pa.list_(pa.string())


@row
class PrintReport:
    """Report about one mesh; lengths in mm.

    Attributes
    ----------
    is_solid : bool
        The mesh bounds a solid of positive volume.
    status : str
        Status of the mesh in manifold3d, ``"NoError"`` or a reason.
    problem : str or None
        Why the mesh is not a solid, a short stable word of
        :data:`tactile_toolkit.mesh.PROBLEMS`, or :data:`UNREADABLE`.
    detail : str or None
        The problem in a sentence.
    vertices, faces : int
        Counts of the mesh as given.
    bodies, genus : int
        Number of separate pieces, and of holes through them in total.
    volume_mm3, mass_g : float
        Volume and mass of the filled solid.
    size_mm : tuple of float
        Bounding box along x, y, z.
    thinnest_wall_mm : float
        Thinnest wall. Walls up to 2.5 mm are searched for in the entire solid: the smallest ball that touches
        the surface from inside on two sides whose directions differ by at most 36 degrees, and 0 at a sharper
        outer edge or tip. It does not depend on how faces are divided; rods, balls and tori of few flat sides
        are some percent thinner than the round shape (32 sides: 3 to 8 %). Without such a wall, it is the
        narrowest wall of the section at half height, at most the height; thicker walls elsewhere are not
        searched for. NaN for a mesh that is not a solid, as the next two.
    overhang_mm2 : float
        Area that overhangs and does not rest on the bed.
    contact_mm2 : float
        Area of the first layer, cut at its top.
    warnings : tuple of str
        Words of :data:`WARNINGS`.
    notes : tuple of str
        What reading the file changed or left out (``Mesh.notes``).
    """

    is_solid: bool = column(pa.bool_())
    status: str = column(_WORD)
    problem: str | None = column(_WORD, role="hidden")
    detail: str | None = column(_WORD, role="hidden")
    vertices: int = column(_COUNT, role="measure", title="Vertices")
    faces: int = column(_COUNT, role="measure", title="Triangles")
    bodies: int = column(_COUNT, default=0, role="facet", title="Separate bodies")
    genus: int = column(_COUNT, default=0)
    volume_mm3: float = column(_REAL, "mm³", default=math.nan, role="measure", title="Volume")
    mass_g: float = column(_REAL, "g", default=math.nan, role="measure", title="Mass in PLA", decimals=1)
    size_x_mm: float = column(_REAL, "mm", default=math.nan)
    size_y_mm: float = column(_REAL, "mm", default=math.nan)
    size_z_mm: float = column(_REAL, "mm", default=math.nan, role="measure", title="Height", decimals=2)
    thinnest_wall_mm: float = column(
        _REAL, "mm", default=math.nan, role="measure", title="Thinnest wall", decimals=2
    )
    overhang_mm2: float = column(_REAL, "mm²", default=math.nan, role="measure", title="Overhang")
    contact_mm2: float = column(_REAL, "mm²", default=math.nan, role="measure", title="First layer")
    warnings: tuple[str, ...] = column(
        _WORDS, default=(), role="facet", title="Print warnings", values=(NO_WARNING, *WARNINGS)
    )
    notes: tuple[str, ...] = column(_WORDS, default=(), role="hidden")

    @property
    def size_mm(self) -> tuple[float, float, float]:
        """Bounding box along x, y, z."""
        return self.size_x_mm, self.size_y_mm, self.size_z_mm

    def to_row(self) -> JsonDict:
        """Return the values of the report by column, as Python objects; lists for ``warnings`` and ``notes``.

        Returns
        -------
        dict
        """
        values = {name: getattr(self, name) for name in columns(type(self))}
        return {name: list(each) if isinstance(each, tuple) else each for name, each in values.items()}


def unreadable(detail: str) -> PrintReport:
    """Return the report for a file without a readable mesh."""
    return PrintReport(False, "NotTried", UNREADABLE, detail, 0, 0)
