"""Checks of a mesh for printing: solid or not, walls, overhangs, first layer."""

from __future__ import annotations

import math

import numpy as np

from tactile_toolkit.mesh.mesh import MeshLike, as_mesh
from tactile_toolkit.mesh.print_profile import PrintProfile
from tactile_toolkit.mesh.print_report import WARNINGS, PrintReport
from tactile_toolkit.mesh.section import section_area_mm2, thinnest_width_mm
from tactile_toolkit.mesh.solid_check import check_manifold

WALL_REACH_MM = 2.5
"""Walls up to this are searched for in the entire solid; three times the default limit of the warning."""

# The middle section is taken this fraction of the height above the vertices that lie in the mid-plane.
_OFF_VERTICES = 1e-7


def inspect(mesh: MeshLike, profile: PrintProfile | None = None) -> PrintReport:
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
    # numba takes half a second to import.
    from tactile_toolkit.mesh.nearness import thinnest_wall_mm
    from tactile_toolkit.mesh.surface_kernels import leaning_out

    mesh = as_mesh(mesh)
    profile = profile or PrintProfile()
    check = check_manifold(mesh)
    counts = (len(mesh.vertices_m), len(mesh.faces), check.bodies, check.genus, check.volume_mm3)
    if check.problem is not None:
        return PrintReport(False, check.status, check.problem, check.detail, *counts, notes=mesh.notes)
    vertices_mm, faces = mesh.vertices_mm, mesh.faces.astype(np.int64)
    # Axis by axis: numpy takes thirteen times as long along rows of three.
    low, high = ([reach(axis) for axis in vertices_mm.T] for reach in (np.min, np.max))
    size_mm = (float(high[0] - low[0]), float(high[1] - low[1]), float(high[2] - low[2]))
    # A cut through the vertices of the mid-plane would run along edges.
    outlines = check.manifold.slice((low[2] + high[2]) / 2 + _OFF_VERTICES * size_mm[2]).to_polygons()
    # Faces within the first layer rest on the bed, whatever their direction.
    bed_mm, sine = low[2] + profile.layer_height_mm, math.sin(math.radians(profile.overhang_deg))
    overhang_mm2 = float(leaning_out(vertices_mm, faces, bed_mm, sine).sum() / 2)
    contact_mm2 = float(check.manifold.slice(bed_mm).area())
    wall_mm = max(min(thinnest_width_mm(outlines), size_mm[2]), min(WALL_REACH_MM, *size_mm))
    wall_mm = min(wall_mm, thinnest_wall_mm(vertices_mm, faces, WALL_REACH_MM))
    overhang_share = overhang_mm2 / max(section_area_mm2(outlines), 1e-9)
    mass_g = check.volume_mm3 * profile.density_g_cm3 / 1000.0
    warnings = _warnings(profile, check.bodies, size_mm, wall_mm, overhang_share, contact_mm2)
    measured = (mass_g, *size_mm, wall_mm, overhang_mm2, contact_mm2)
    return PrintReport(True, check.status, None, None, *counts, *measured, warnings, mesh.notes)


def _warnings(
    profile: PrintProfile,
    bodies: int,
    size_mm: tuple[float, float, float],
    wall_mm: float,
    overhang_share: float,
    contact_mm2: float,
) -> tuple[str, ...]:
    # The print may be rotated, so its longer side lies along the longer side of the plate.
    sides = zip(sorted(size_mm[:2]), sorted(profile.plate_mm), strict=True)
    found = {
        "thin-wall": wall_mm < profile.min_wall_mm,
        "separate-bodies": bodies > 1,
        "overhang": overhang_share > profile.max_overhang_share,
        "small-contact": contact_mm2 < profile.min_contact_mm2,
        "larger-than-plate": any(side > room for side, room in sides),
        "too-tall": size_mm[2] > profile.max_height_mm,
    }
    return tuple(name for name in WARNINGS if found[name])
