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
from tactile_toolkit.mesh.mesh import Mesh, MeshLike

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

# The plate is wider than the solid on each side, and its corners are round.
_MARGIN_MM, _CORNER_MM = 3.0, 2.0

# The solid reaches so far into the plate that both become one body.
_SUNK_MM = 0.2
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
    return ManifoldCheck(manifold, status, None, None, len(outer), genus, volume_mm3)


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


def on_base_plate(solid: MeshLike, base_mm: float) -> Mesh:
    """Put the upper half of a solid on a plate with round corners, 3 mm wider than it on each side.

    Digits are symmetric, so their upper half is a relief with a flat underside. All parts of the solid become
    one body with the plate.

    Parameters
    ----------
    solid : Mesh, record of a data set, or trimesh.Trimesh
        In metres, z pointing away from the plate. It must bound a solid.
    base_mm : float
        Thickness of the plate.

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
    import manifold3d  # few meshes get a plate

    if not base_mm > 0:
        raise InputError(f"is {base_mm!r}; expected a thickness above 0 mm", field="base_mm")
    body = require_solid(Mesh.of(solid)).manifold
    left, front, low, right, back, high = body.bounding_box()
    middle = (low + high) / 2
    sunk = min(_SUNK_MM, base_mm / 2)
    upper = body.trim_by_plane((0.0, 0.0, 1.0), middle - sunk).translate((0.0, 0.0, base_mm - middle))
    inner = _MARGIN_MM - _CORNER_MM
    sides = (right - left + 2 * inner, back - front + 2 * inner)
    outline = manifold3d.CrossSection.square(sides).translate((left - inner, front - inner))
    outline = outline.offset(_CORNER_MM, manifold3d.JoinType.Round, circular_segments=_SEGMENTS)
    plate = manifold3d.Manifold.extrude(outline, base_mm)
    return Mesh.from_manifold(upper + plate)
