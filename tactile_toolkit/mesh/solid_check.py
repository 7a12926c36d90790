"""Checks whether triangles bound a solid, by manifold3d and conditions beyond it; solids on a base plate.

manifold3d checks how triangles are joined. It accepts meshes that are inside out, that cross themselves or
whose bodies overlap; these are refused here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np

from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh, MeshLike

if TYPE_CHECKING:
    from manifold3d import Manifold

PROBLEMS = (
    "bad-shape",
    "empty",
    "not-finite",
    "index-out-of-range",
    "not-manifold",
    "inside-out",
    "no-volume",
    "overlap",
    "self-crossing",
)
"""Reasons why a mesh is refused, in the order of the checks."""

OVERLAP_MM3 = 1e-6

FLAT_MM3 = 1e-6
"""A smaller volume, that of a cube of 10 um, may be rounding of bodies that touch, or of a flat sheet."""

BASE_MARGIN_MM = 3.0
"""Width of a base plate around the solid on each side."""

_CORNER_MM = 2.0
"""Radius of the corners of a base plate."""

# The solid reaches so far into the plate that both become one body.
_SUNK_MM = 0.2

# Vertices up to this height lie in an underside at z = 0; cutting rounds them.
_LEVEL_MM = 1e-6
_SEGMENTS = 32


@dataclass(frozen=True, slots=True, eq=False)
class ManifoldCheck:
    """Result for one mesh; ``problem``, a word of :data:`PROBLEMS`, and ``detail`` are None for a solid."""

    manifold: Manifold
    """The solid, a manifold3d.Manifold in mm, if there is one."""
    status: str
    """Status of manifold3d; ``"NotTried"`` where the arrays are invalid."""
    problem: str | None = None
    detail: str | None = None
    bodies: int = 0
    genus: int = 0
    """Number of holes through all bodies."""
    volume_mm3: float = math.nan
    """Enclosed volume, negative if inside out; NaN if unknown, as where some space is enclosed twice."""
    lows_mm: tuple[float, ...] = ()
    """Height of the lowest point of each body of a solid above that of the lowest body, in order."""


def check_manifold(mesh: Mesh) -> ManifoldCheck:
    """Decide whether a mesh, in metres, bounds a solid."""
    problem = mesh.array_problem
    if problem is not None:
        return ManifoldCheck(None, "NotTried", *problem)
    manifold = mesh.to_manifold()
    status = str(manifold.status()).rpartition(".")[2]
    if status != "NoError":
        return ManifoldCheck(None, status, "not-manifold", _edge_problem(mesh))
    parts = manifold.decompose()
    volume_mm3 = float(manifold.volume())
    if not parts or abs(volume_mm3) < FLAT_MM3:
        problem = "no-volume", "the surface is closed, but the enclosed volume is nearly 0"
    elif volume_mm3 < 0:
        problem = "inside-out", f"the triangles face inwards, the volume is {volume_mm3:.3f} mm³"
    else:
        problem = _overlap_problem(parts) or _crossing_problem(mesh, len(parts))
    outer = [part for part in parts if part.volume() > 0]
    genus = sum(part.genus() for part in parts)
    if problem is not None:
        # Some of the space is counted twice.
        if problem[0] in ("overlap", "self-crossing"):
            volume_mm3 = math.nan
        return ManifoldCheck(None, status, *problem, len(outer), genus, volume_mm3)
    lowest_mm = manifold.bounding_box()[2]
    lows_mm = tuple(sorted(part.bounding_box()[2] - lowest_mm for part in outer))
    return ManifoldCheck(manifold, status, None, None, len(outer), genus, volume_mm3, lows_mm)


def require_solid(mesh: Mesh) -> ManifoldCheck:
    """Return the result for a mesh that bounds a solid; raises ItemError for others."""
    verdict = check_manifold(mesh)
    if verdict.problem is not None:
        raise ItemError(verdict.problem, f"it does not bound a solid ({verdict.problem}: {verdict.detail})")
    return verdict


def _overlap_problem(parts: list[Manifold]) -> tuple[str, str] | None:
    if len(parts) == 1:
        return None
    # numba takes half a second to import.
    from tactile_toolkit.mesh.box_tree import near_pairs

    bodies = [part for part in parts if part.volume() > 0]
    cavities = [part for part in parts if part.volume() < 0]
    # A cavity belongs to the smallest body around it, since a body may lie loose in a cavity of another.
    order = sorted(range(len(bodies)), key=lambda number: float(bodies[number].volume()))
    held = list(bodies)
    for cavity in cavities:
        around = next((number for number in order if _encloses(bodies[number], cavity)), None)
        if around is None:
            return "inside-out", f"one of {len(parts)} bodies faces inwards without lying inside another one"
        less = held[around] - _filled(cavity)
        if abs(less.volume() - held[around].volume() - cavity.volume()) > OVERLAP_MM3:
            return "overlap", f"two cavities of one of {len(bodies)} bodies overlap"
        held[around] = less
    boxes_mm = np.array([body.bounding_box() for body in bodies]).reshape(-1, 2, 3)
    for first, second in chain.from_iterable(pairs.T.tolist() for pairs in near_pairs(boxes_mm, 0.0)):
        shared_mm3 = (held[first] ^ held[second]).volume()
        if shared_mm3 > OVERLAP_MM3:
            return "overlap", f"two of {len(bodies)} bodies overlap by {shared_mm3:.3g} mm³"
    return None


def _crossing_problem(mesh: Mesh, bodies: int) -> tuple[str, str] | None:
    place_mm = mesh.crossing_mm(bodies)
    if place_mm is None:
        return None
    position = ", ".join(f"{coordinate + 0.0:.2f}" for coordinate in place_mm)
    return "self-crossing", f"the surface of one body crosses itself, at ({position}) mm among others"


def _encloses(body: Manifold, cavity: Manifold) -> bool:
    filling = _filled(cavity)
    return bool((filling ^ body).volume() >= filling.volume() - OVERLAP_MM3)


def _filled(cavity: Manifold) -> Manifold:
    inside_out = Mesh.from_manifold(cavity)
    return Mesh(inside_out.vertices_m, np.ascontiguousarray(inside_out.faces[:, ::-1])).to_manifold()


def _edge_problem(mesh: Mesh) -> str:
    ends = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    ends.sort(axis=1)
    uses = np.unique(ends[:, 0] * len(mesh.vertices_m) + ends[:, 1], return_counts=True)[1]
    rim = int((uses == 1).sum())
    crowded = int((uses > 2).sum())
    if rim:
        return f"the surface is open: {rim} edges border one triangle only"
    if crowded:
        return f"{crowded} edges border more than two triangles"
    return "neighbouring triangles are turned against each other"


def with_flat_underside(
    solid: MeshLike, base_mm: float | None = None, thickness_mm: float | None = None
) -> Mesh:
    """Replace the lower half of a solid by a flat underside, on which all its parts stand.

    The upper half is put on upright walls along the outline of the middle section, on a base plate, or on
    both. A base plate is 3 mm wider than the solid on each side, has round corners and joins all parts.

    Parameters
    ----------
    solid : Mesh, record of a data set, or trimesh.Trimesh
        In metres, z pointing away from the plate. It must bound a solid.
    base_mm : float, optional
        Thickness of the base plate; None for no base plate.
    thickness_mm : float, optional
        Thickness above the base plate. Walls make up what the upper half lacks; None for no walls.

    Returns
    -------
    Mesh
        Metres, float64, lowest point at z = 0; x and y are those of the solid.

    Raises
    ------
    InputError
        ``base_mm`` is not positive.
    ItemError
        The mesh does not bound a solid.
    """
    from manifold3d import CrossSection, JoinType, Manifold  # few meshes are printed

    if base_mm is not None and not base_mm > 0:
        raise InputError(f"is {base_mm!r}; expected a thickness above 0 mm", field="base_mm")
    body = require_solid(Mesh.of(solid)).manifold
    left, front, low, right, back, high = body.bounding_box()
    middle = (low + high) / 2
    upper = body.trim_by_plane((0.0, 0.0, 1.0), middle).translate((0.0, 0.0, -middle))
    wall_mm = 0.0 if thickness_mm is None else thickness_mm - (high - middle)
    plate_mm = base_mm or 0.0
    depth_mm = max(wall_mm + min(_SUNK_MM, plate_mm / 2), 0.0)
    standing = _on_walls(upper, depth_mm).translate((0.0, 0.0, plate_mm + wall_mm))
    if base_mm is not None:
        inner = BASE_MARGIN_MM - _CORNER_MM
        sides = (right - left + 2 * inner, back - front + 2 * inner)
        outline = CrossSection.square(sides).translate((left - inner, front - inner))
        outline = outline.offset(_CORNER_MM, JoinType.Round, circular_segments=_SEGMENTS)
        standing += Manifold.extrude(outline, base_mm)
    return Mesh.from_manifold(standing)


def _on_walls(upper: Manifold, depth_mm: float) -> Manifold:
    """Extend a solid with a flat underside at z = 0 down by upright walls.

    The union with an extruded section would leave slivers, since manifold3d rounds sections.
    """
    if depth_mm == 0:
        return upper
    arrays = upper.to_mesh64()
    vertices, faces = np.asarray(arrays.vert_properties), np.asarray(arrays.tri_verts).astype(np.int64)
    count = len(vertices)
    is_low = vertices[:, 2] < _LEVEL_MM
    in_underside = is_low[faces].all(axis=1)
    lowered = np.arange(count)
    lowered[is_low] = count + np.arange(np.count_nonzero(is_low))
    ends = faces[in_underside][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    start, end = ends[~np.isin(ends @ (count, 1), ends @ (1, count))].T
    faces[in_underside] = lowered[faces[in_underside]]
    walls = [start, end, lowered[end], start, lowered[end], lowered[start]]
    below = np.column_stack([vertices[is_low, :2], np.full(np.count_nonzero(is_low), -depth_mm)])
    faces = np.concatenate([faces, np.stack(walls, axis=1).reshape(-1, 3)])
    return Mesh(np.concatenate([vertices, below]) / MM_PER_M, faces.astype(np.int32)).to_manifold()
