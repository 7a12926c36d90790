"""Reports about meshes for printing: solid or not, walls, overhangs, first layer, and advice.

The narrowest wall of a plane section follows from its medial axis. Each point of an outline has one largest
disc that touches it from inside and crosses the outline nowhere; the centres of these discs form the axis.
Where such a disc also touches the far side of a stroke, its diameter is the width there. Where both contacts
lie close together, the disc only sits in a corner or behind a rough spot, and its diameter says nothing about
a wall.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import ClassVar

import numpy as np
import pyarrow as pa

from tactile_toolkit.errors import ItemError
from tactile_toolkit.mesh.mesh import Mesh, MeshLike
from tactile_toolkit.mesh.mesh_options import PrintProfile
from tactile_toolkit.mesh.solid_check import ManifoldCheck, check_manifold
from tactile_toolkit.rows import TypedRow, column
from tactile_toolkit.value_types import Float32, Float64, JsonDict
from tactile_toolkit.wording import with_count

WARNINGS = (
    *("thin-wall", "separate-bodies", "floating-part", "overhang"),
    *("small-contact", "larger-than-plate", "too-tall"),
)
"""Print warnings; the limits behind them are those of :class:`~mnist3d.PrintProfile`."""

NO_WARNING = "none"
"""Shown in place of warnings where there are none."""

_REAL = pa.float64()
_COUNT = pa.int64()
_WORD = pa.string()
_WORDS = pa.list_(pa.string())

WARNINGS_PAGE = "docs/warnings.md"
"""Page with a section on each warning."""

_ADVICE = {
    "thin-wall": "make it larger{larger}, draw with a thicker pen, or print it with a finer nozzle",
    "separate-bodies": "join the parts{join}, or print them one by one",
    "floating-part": "print with support, lay the parts down in the slicer, or add a base plate{plate}",
    "overhang": "print with support, or put it on a base plate{plate}",
    "small-contact": "put it on a base plate{plate}, or print it with a brim of 5 mm",
    "larger-than-plate": "make it smaller{larger}, or cut it in the slicer",
    "too-tall": "make it smaller{larger}, or lay it down in the slicer",
}

_NO_OPTIONS = {"larger": "", "join": "", "plate": ""}

SPACING_MM = 0.4
"""Distance of outline points; outlines of digits have corners every 0.4 to 0.8 mm."""

NORMAL_SPAN = 2
"""Number of neighbours on each side that define the direction of the outline at a point."""

MIN_CONTACT_SINE = 0.9
"""Sine of half the angle between two contacts, seen from the centre of the disc: 128 degrees."""

MAX_POINTS = 6000
"""Bounds the time, because each point is compared with many others."""

WALL_REACH_MM = 2.5
"""Walls up to this are searched for in the entire solid; three times the default limit of the warning."""

# The middle section is taken this fraction of the height above the vertices that lie in the mid-plane.
_OFF_VERTICES = 1e-7


class PrintReport(TypedRow):
    """Report about one mesh; lengths in mm.

    Attributes
    ----------
    is_solid : bool
        The mesh bounds a solid of positive volume.
    status : str
        Status of the mesh in manifold3d, ``"NoError"`` or a reason.
    problem : str or None
        Why the mesh is not a solid, a short stable word of
        :data:`tactile_toolkit.mesh.solid_check.PROBLEMS`, or :attr:`UNREADABLE`.
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
    lows_mm : tuple of float
        Height of the lowest point of each body above the plate, in increasing order; not stored.
    """

    UNREADABLE: ClassVar = "unreadable"
    """Problem of a file without a readable mesh."""
    DATASET_OPTIONS: ClassVar = {
        "larger": " (`tactile export --scale`)",
        "join": " (`tactile export --half-on-base-mm 2`)",
        "plate": " (`tactile export --half-on-base-mm 2`)",
    }
    """How the meshes of a data set are made larger, joined, and put on a base plate, for advice."""

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
    lows_mm: tuple[float, ...] = ()

    @classmethod
    def of(cls, mesh: MeshLike, profile: PrintProfile | None = None) -> PrintReport:
        """Check whether a mesh bounds a solid, and measure it for printing.

        A mesh that is not a solid gives a report, not an exception.

        Parameters
        ----------
        mesh : Mesh, record of a data set, or trimesh.Trimesh
            In metres, z pointing away from the plate.
        profile : PrintProfile, optional
            Printer and material.

        Returns
        -------
        PrintReport

        Raises
        ------
        InputError
            The mesh has no triangles.
        """
        mesh = Mesh.of(mesh)
        check = check_manifold(mesh)
        if check.problem is not None:
            counts = (len(mesh.vertices_m), len(mesh.faces), check.bodies, check.genus, check.volume_mm3)
            return cls(False, check.status, check.problem, check.detail, *counts, notes=mesh.notes)
        return _report_of_solid(mesh, check, profile or PrintProfile())

    @property
    def size_mm(self) -> tuple[float, float, float]:
        """Bounding box along x, y, z."""
        return self.size_x_mm, self.size_y_mm, self.size_z_mm

    def require_solid(self) -> PrintReport:
        """Return the report of a mesh that bounds a solid; raises ItemError for others."""
        if self.problem is not None:
            raise ItemError(self.problem, f"it does not bound a solid ({self.problem}: {self.detail})")
        return self

    def to_row(self) -> JsonDict:
        """Return the values of the report by column, as Python objects; lists for ``warnings`` and ``notes``.

        Returns
        -------
        dict
        """
        values = {name: getattr(self, name) for name in self.columns()}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}

    def explained(self, profile: PrintProfile, options: Mapping[str, str] = _NO_OPTIONS) -> tuple[str, ...]:
        """Return a line for each warning: what was found, what was expected, and what to do.

        ``options`` is as for :meth:`advice`.
        """
        floating = [low_mm for low_mm in self.lows_mm if low_mm > profile.floating_mm]
        heights = ", ".join(f"{low_mm:.2f}" for low_mm in floating)
        width, depth, height = self.size_mm
        plate = " x ".join(f"{side:g}" for side in profile.plate_mm)
        measures = {
            "thin-wall": f"the thinnest wall is {self.thinnest_wall_mm:.2f} mm, expected "
            f"{profile.min_wall_mm:g} mm or more",
            "separate-bodies": f"there are {with_count(self.bodies, 'parts')} that print apart",
            "floating-part": f"{len(floating)} of {self.bodies} parts begin above the plate, at {heights} mm",
            "overhang": f"{self.overhang_mm2:,.0f} mm² lean out by more than "
            f"{profile.overhang_deg:g} degrees",
            "small-contact": f"{self.contact_mm2:.1f} mm² lie on the plate of the printer, expected "
            f"{profile.min_contact_mm2:g} mm² or more",
            "larger-than-plate": f"it is {width:.1f} x {depth:.1f} mm, larger than the plate of {plate} mm",
            "too-tall": f"it is {height:.1f} mm tall, expected {profile.max_height_mm:g} mm at most",
        }
        return tuple(
            f"{word}: {measures[word]}; next: {advice.removeprefix(f'{word}: ')}"
            for word, advice in zip(self.warnings, self.advice(self.warnings, options), strict=True)
        )

    @staticmethod
    def advice(words: Iterable[str], options: Mapping[str, str] = _NO_OPTIONS) -> tuple[str, ...]:
        """Return a line for each warning: what to do, and the section that explains it.

        ``options`` names the options of a command, as :attr:`DATASET_OPTIONS` does.
        """
        warned = set(words)
        return tuple(
            f"{word}: {_ADVICE[word].format(**options)} (see {WARNINGS_PAGE}#{word})"
            for word in WARNINGS
            if word in warned
        )


def _report_of_solid(mesh: Mesh, check: ManifoldCheck, profile: PrintProfile) -> PrintReport:
    """Measure a solid for printing, with the result of :func:`check_manifold` for it."""
    # numba takes half a second to import.
    from tactile_toolkit.mesh.walls import leaning_out, thinnest_wall_mm

    vertices_mm = mesh.vertices_mm
    faces = mesh.faces.astype(np.int64)
    # Axis by axis: numpy takes thirteen times as long along rows of three.
    low, high = ([reach(axis) for axis in vertices_mm.T] for reach in (np.min, np.max))
    size_mm = (float(high[0] - low[0]), float(high[1] - low[1]), float(high[2] - low[2]))
    # A cut through the vertices of the mid-plane would run along edges.
    outlines = check.manifold.slice((low[2] + high[2]) / 2 + _OFF_VERTICES * size_mm[2]).to_polygons()
    # Faces within the first layer rest on the bed, whatever their direction.
    bed_mm = low[2] + profile.layer_height_mm
    sine = math.sin(math.radians(profile.overhang_deg))
    overhang_mm2 = float(leaning_out(vertices_mm, faces, bed_mm, sine).sum() / 2)
    contact_mm2 = float(check.manifold.slice(bed_mm).area())
    wall_mm = max(min(thinnest_width_mm(outlines), size_mm[2]), min(WALL_REACH_MM, *size_mm))
    wall_mm = min(wall_mm, thinnest_wall_mm(vertices_mm, faces, WALL_REACH_MM))
    overhang_share = overhang_mm2 / max(section_area_mm2(outlines), 1e-9)
    mass_g = check.volume_mm3 * profile.density_g_cm3 / 1000.0
    # The print may be rotated, so its longer side lies along the longer side of the plate.
    sides_mm = zip(sorted(size_mm[:2]), sorted(profile.plate_mm), strict=True)
    is_raised = {
        "thin-wall": wall_mm < profile.min_wall_mm,
        "separate-bodies": check.bodies > 1,
        "floating-part": check.lows_mm[-1] > profile.floating_mm,
        "overhang": overhang_share > profile.max_overhang_share,
        "small-contact": contact_mm2 < profile.min_contact_mm2,
        "larger-than-plate": any(side > plate for side, plate in sides_mm),
        "too-tall": size_mm[2] > profile.max_height_mm,
    }
    warnings = tuple(word for word in WARNINGS if is_raised[word])
    counts = (len(vertices_mm), len(faces), check.bodies, check.genus, check.volume_mm3)
    measured = (mass_g, *size_mm, wall_mm, overhang_mm2, contact_mm2)
    return PrintReport(
        True, check.status, None, None, *counts, *measured, warnings, mesh.notes, check.lows_mm
    )


def thinnest_width_mm(outlines_mm: Sequence[Float64]) -> float:
    """Measure the narrowest wall between two facing parts of the outlines of a section; 0 without outlines.

    Outlines are closed polygons in mm, shape (N, 2), with the material on their left: outer ones are
    counter-clockwise, holes clockwise. The result does not depend on their order and first corner: points are
    placed from the lowest corner on.
    """
    # numba takes half a second to import.
    from tactile_toolkit.mesh.walls import largest_discs

    begun = [np.roll(line, -np.lexsort(line.T)[0], axis=0) for line in outlines_mm if len(line) > 2]
    if not begun:
        return 0.0
    begun.sort(key=lambda line: (*line[0].tolist(), len(line)))
    radii, contacts = largest_discs(*_outline_points(begun))
    facing = contacts >= 2 * MIN_CONTACT_SINE * radii
    return float(2 * (radii[facing].min() if facing.any() else radii.max()))


def section_area_mm2(outlines_mm: Sequence[Float64]) -> float:
    """Return the area enclosed by outlines, oriented as in :func:`thinnest_width_mm`."""
    area = 0.0
    for outline in outlines_mm:  # not sum(), which rounds differently from Python 3.12 on
        x, y = outline.T
        area += float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2
    return area


def _outline_points(outlines: Sequence[Float64]) -> tuple[Float32, Float32]:
    """Return points along outlines, relative to their mean, and directions towards the material."""
    lengths = [_edge_lengths(outline).sum() for outline in outlines]
    spacing_mm = max(SPACING_MM, sum(lengths) / MAX_POINTS)
    points, inward = [], []
    for outline, length in zip(outlines, lengths, strict=True):
        # Small holes need enough points for their directions too.
        count = max(16, round(length / spacing_mm))
        arc_mm = np.concatenate([[0.0], np.cumsum(_edge_lengths(outline))])
        # Half a step from the first corner: the outline has no direction at a corner.
        stops = (np.arange(count) + 0.5) * (arc_mm[-1] / count)
        closed = np.concatenate([outline, outline[:1]])
        even = np.stack([np.interp(stops, arc_mm, closed[:, axis]) for axis in (0, 1)], axis=1)
        along = np.roll(even, -NORMAL_SPAN, axis=0) - np.roll(even, NORMAL_SPAN, axis=0)
        left = np.stack([-along[:, 1], along[:, 0]], axis=1)
        points.append(even)
        inward.append(left / np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-12))
    centred = np.concatenate(points)
    # Single precision is accurate enough near the mean.
    centred -= centred.mean(axis=0)
    return centred.astype(np.float32), np.concatenate(inward).astype(np.float32)


def _edge_lengths(outline: Float64) -> Float64:
    edges = np.roll(outline, -1, axis=0) - outline
    return np.hypot(edges[:, 0], edges[:, 1])
