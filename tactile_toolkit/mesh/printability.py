"""Whether a mesh bounds a solid, and what a printer needs to know about it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tactile_toolkit.array_types import Float32, Float64
from tactile_toolkit.checked_fields import check_fields, real
from tactile_toolkit.mesh.mesh import MeshLike, as_mesh
from tactile_toolkit.mesh.solid_check import check_manifold

WARNINGS = ("thin-wall", "separate-bodies", "overhang", "small-contact", "larger-than-plate", "too-tall")
"""What a print may suffer from; the numbers behind them are those of :class:`PrintProfile`."""

UNREADABLE = "unreadable"
"""What is wrong with a file beyond :data:`tactile_toolkit.mesh.solid_check.PROBLEMS`."""

WALL_REACH_MM = 2.5
"""Walls up to this are looked for in the whole solid; three times what is warned of by default."""

REPORT_COLUMNS: dict[str, type] = {
    "is_solid": bool,
    **dict.fromkeys(("status", "problem", "detail"), str),
    **dict.fromkeys(("vertices", "faces", "bodies", "genus"), int),
    **dict.fromkeys(("volume_mm3", "mass_g", "size_x_mm", "size_y_mm", "size_z_mm"), float),
    **dict.fromkeys(("thinnest_wall_mm", "overhang_mm2", "contact_mm2"), float),
    "warnings": str,
}
"""Columns of :meth:`PrintReport.to_row` and their types; a text column may hold None."""


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


@dataclass(frozen=True, slots=True)
class PrintReport:
    """What was found about one mesh. Lengths in mm.

    Attributes
    ----------
    is_solid : bool
        The mesh bounds a solid of positive volume.
    status : str
        Status of the mesh in manifold3d, ``"NoError"`` or a reason.
    problem : str or None
        Why the mesh is not a solid, a short stable word of
        :data:`tactile_toolkit.mesh.solid_check.PROBLEMS`, or :data:`UNREADABLE`.
    detail : str or None
        The same in a sentence.
    vertices, faces : int
        Of the mesh as given.
    bodies, genus : int
        Separate pieces, and holes through them in total.
    volume_mm3, mass_g : float
        Of the solid filled with material.
    size_mm : tuple of float
        Bounding box along x, y, z.
    thinnest_wall_mm : float
        Thinnest wall. Walls up to 2.5 mm are looked for in the whole solid: the smallest ball that touches
        the surface from inside on two sides whose directions differ by at most 36 degrees; 0 at an outer
        edge or tip that is sharper. It does not change when faces are divided further; rods, balls and tori
        of few flat sides come out some percent thinner than the round shape (32 sides: 3 to 8). Where there
        is none it is the narrowest wall of the section at half height, at most the height: thicker walls
        elsewhere are not looked for. NaN for a mesh that is not a solid, as the next two.
    overhang_mm2 : float
        Area that leans out too far and does not rest on the bed.
    contact_mm2 : float
        Area of the first layer, cut at its top.
    warnings : tuple of str
        Of :data:`WARNINGS`.
    notes : tuple of str
        What reading the file changed or left out (``Mesh.notes``).
    """

    is_solid: bool
    status: str
    problem: str | None
    detail: str | None
    vertices: int
    faces: int
    bodies: int = 0
    genus: int = 0
    volume_mm3: float = math.nan
    mass_g: float = math.nan
    size_mm: tuple[float, float, float] = (math.nan,) * 3
    thinnest_wall_mm: float = math.nan
    overhang_mm2: float = math.nan
    contact_mm2: float = math.nan
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def to_row(self) -> dict[str, Any]:
        """Give the report as a flat row with the columns of :data:`REPORT_COLUMNS`.

        Returns
        -------
        dict
        """
        row = {name: getattr(self, name) for name in REPORT_COLUMNS if name in self.__dataclass_fields__}
        row |= dict(zip(("size_x_mm", "size_y_mm", "size_z_mm"), self.size_mm, strict=True))
        row["warnings"] = " ".join(self.warnings)
        return {name: row[name] for name in REPORT_COLUMNS}


def inspect(mesh: MeshLike, profile: PrintProfile | None = None) -> PrintReport:
    """Check whether a mesh bounds a solid, and measure what matters for printing it.

    A bad mesh gives a report, not an exception.

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
    from tactile_toolkit.mesh.nearness import leaning_out, thinnest_wall_mm

    mesh = as_mesh(mesh)
    profile = PrintProfile() if profile is None else profile
    check = check_manifold(mesh)
    counts = (len(mesh.vertices_m), len(mesh.faces), check.bodies, check.genus, check.volume_mm3)
    if check.problem is not None:
        return PrintReport(False, check.status, check.problem, check.detail, *counts, notes=mesh.notes)
    vertices_mm, faces = mesh.vertices_mm, mesh.faces.astype(np.int64)
    # Axis by axis: along rows of three numpy takes thirteen times as long.
    low, high = ([reach(axis) for axis in vertices_mm.T] for reach in (np.min, np.max))
    size_mm = (float(high[0] - low[0]), float(high[1] - low[1]), float(high[2] - low[2]))
    # Vertices that lie in the mid-plane would make the cut run along edges: it is taken just above them.
    outlines = check.manifold.slice((low[2] + high[2]) / 2 + _OFF_VERTICES * size_mm[2]).to_polygons()
    # What lies within the first layer rests on the bed, whatever way it faces.
    bed_mm, sine = low[2] + profile.layer_height_mm, math.sin(math.radians(profile.overhang_deg))
    overhang_mm2 = float(leaning_out(vertices_mm, faces, bed_mm, sine).sum() / 2)
    contact_mm2 = float(check.manifold.slice(bed_mm).area())
    wall_mm = max(min(thinnest_width_mm(outlines), size_mm[2]), min(WALL_REACH_MM, *size_mm))
    wall_mm = min(wall_mm, thinnest_wall_mm(vertices_mm, faces, WALL_REACH_MM))
    overhang_share = overhang_mm2 / max(section_area_mm2(outlines), 1e-9)
    # Turned on the plate, the longer side of the print goes along the longer one of the plate.
    sides = zip(sorted(size_mm[:2]), sorted(profile.plate_mm), strict=True)
    found = {
        "thin-wall": wall_mm < profile.min_wall_mm,
        "separate-bodies": check.bodies > 1,
        "overhang": overhang_share > profile.max_overhang_share,
        "small-contact": contact_mm2 < profile.min_contact_mm2,
        "larger-than-plate": any(side > room for side, room in sides),
        "too-tall": size_mm[2] > profile.max_height_mm,
    }
    return PrintReport(
        True,
        check.status,
        None,
        None,
        *counts,
        mass_g=check.volume_mm3 * profile.density_g_cm3 / 1000.0,
        size_mm=size_mm,
        thinnest_wall_mm=wall_mm,
        overhang_mm2=overhang_mm2,
        contact_mm2=contact_mm2,
        warnings=tuple(name for name in WARNINGS if found[name]),
        notes=mesh.notes,
    )


def unreadable(detail: str) -> PrintReport:
    """Report a file that no mesh could be read from, and why."""
    return PrintReport(False, "NotTried", UNREADABLE, detail, 0, 0)


# Share of the height by which the middle section avoids the vertices that lie in the mid-plane.
_OFF_VERTICES = 1e-7


# --- the thinnest wall of a section, from its medial axis ----------------------------------------------

# For every point of the outline there is one largest disc that touches it from inside and crosses the outline
# nowhere. The middles of these discs are the medial axis. Where such a disc also touches the far side of a
# stroke, its diameter is the width there; where both contacts lie close together the disc only sits in a
# corner or behind a rough spot, and its diameter says nothing about a wall.

SPACING_MM = 0.4
"""Distance of outline points; the outlines of the digits have corners every 0.4 to 0.8 mm."""

NORMAL_SPAN = 2
"""Neighbours on either side that set the direction of the outline at a point."""

LEAST_CONTACT_SINE = 0.9
"""Sine of half the angle between the two contacts, seen from the middle of the disc: 128 degrees."""

MAX_POINTS = 6000
"""Every point is compared with many others: this bounds the time."""


def thinnest_width_mm(outlines_mm: Sequence[Float64]) -> float:
    """Measure the narrowest wall between two facing stretches of the outlines of a section, 0 without any.

    Outlines are closed polygons in mm, shape (N, 2), with the material on their left: outer ones
    counter-clockwise, holes clockwise. Where they begin, and their order, change nothing: points are laid
    along each from its lowest corner.
    """
    from tactile_toolkit.mesh.nearness import largest_discs

    begun = [np.roll(line, -np.lexsort(line.T)[0], axis=0) for line in outlines_mm if len(line) > 2]
    if not begun:
        return 0.0
    begun.sort(key=lambda line: (*line[0].tolist(), len(line)))
    radii, contacts = largest_discs(*_outline_points(begun))
    facing = contacts >= 2 * LEAST_CONTACT_SINE * radii
    return float(2 * (radii[facing].min() if facing.any() else radii.max()))


def section_area_mm2(outlines_mm: Sequence[Float64]) -> float:
    """Return the area that outlines enclose, turned as in :func:`thinnest_width_mm`."""
    area = 0.0
    for x, y in (
        outline.T for outline in outlines_mm
    ):  # not sum(), which rounds otherwise from Python 3.12 on
        area += float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2
    return area


def _outline_points(
    outlines: Sequence[Float64],
) -> tuple[Float32, Float32]:
    """Return points along outlines, from their middle, and directions to the material."""
    lengths = [_edge_lengths(outline).sum() for outline in outlines]
    spacing_mm = max(SPACING_MM, sum(lengths) / MAX_POINTS)
    points, inward = [], []
    for outline, length in zip(outlines, lengths, strict=True):
        # A small hole too has enough points for its directions.
        count = max(16, round(length / spacing_mm))
        way = np.concatenate([[0.0], np.cumsum(_edge_lengths(outline))])
        # Half a step off the first corner: at a corner itself the outline has no direction.
        stops = (np.arange(count) + 0.5) * (way[-1] / count)
        closed = np.concatenate([outline, outline[:1]])
        even = np.stack([np.interp(stops, way, closed[:, axis]) for axis in (0, 1)], axis=1)
        along = np.roll(even, -NORMAL_SPAN, axis=0) - np.roll(even, NORMAL_SPAN, axis=0)
        left = np.stack([-along[:, 1], along[:, 0]], axis=1)
        points.append(even)
        inward.append(left / np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-12))
    away = np.concatenate(points)
    # Single precision is fine enough near the middle.
    away -= away.mean(axis=0)
    return away.astype(np.float32), np.concatenate(inward).astype(np.float32)


def _edge_lengths(outline: Float64) -> Float64:
    edges = np.roll(outline, -1, axis=0) - outline
    return np.hypot(edges[:, 0], edges[:, 1])
