"""Division of a solid into convex parts, which simulators use for contacts.

A digit is flat ink with a rim: where part of the ink is convex seen from above, the solid over it is nearly
convex. A solid is therefore cut by vertical planes only, which are chosen on its outline.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from manifold3d import CrossSection

from tactile_toolkit.array_types import Float64
from tactile_toolkit.mesh import Mesh, require_solid

if TYPE_CHECKING:
    from manifold3d import Manifold

_DIRECTIONS = [
    np.array([math.cos(angle), math.sin(angle)]) for angle in np.linspace(0, math.pi, 12, endpoint=False)
]
_OUTLINE_MM = 0.02  # finer details of an outline are ignored
# Larger than any plate, and small enough for half planes in double precision.
_FAR_MM = 1e5
_MIN_MM3 = 1e-6  # smaller remainders of a cut are not parts


def convex_parts(
    mesh: Mesh, *, excess: float = 1.08, most: int = 64, tolerance_mm: float = 0.1
) -> list[Mesh]:
    """Cut a solid into parts and return their convex hulls.

    The part whose hull adds most volume is cut first, until the volume of all hulls is ``excess`` times that
    of the solid, or there are about ``most`` parts. The hulls contain the solid except for corners, which are
    smoothed by ``tolerance_mm``. Equal meshes give equal parts.

    Raises ItemError for a mesh that does not bound a solid.
    """
    solid = require_solid(mesh).manifold
    parts, whole_mm3 = _parts(solid), solid.volume()
    for _ in range(most):  # limits the cuts, which may split off chips that are not parts
        if len(parts) >= most or sum(hull.volume() for *_, hull in parts) <= excess * whole_mm3:
            break
        _, part, _ = parts.pop(int(np.argmax([added_mm3 for added_mm3, *_ in parts])))
        normal, offset_mm = _best_cut(part.project().simplify(_OUTLINE_MM))
        for half in part.split_by_plane((*normal.tolist(), 0.0), offset_mm):
            parts += _parts(half)
    smooth = [(hull, hull.simplify(tolerance_mm).hull()) for *_, hull in parts]
    # Smoothing removes chips that are thinner than the tolerance.
    return [Mesh.from_manifold(exact if simple.is_empty() else simple) for exact, simple in smooth]


def _parts(found: Manifold) -> list[tuple[float, Manifold, Manifold]]:
    """Return the bodies of a solid: the volume that the hull of each adds, the body, and its hull."""
    bodies = [(part, part.hull()) for part in found.decompose() if part.volume() > _MIN_MM3]
    return [(hull.volume() - part.volume(), part, hull) for part, hull in bodies]


def _best_cut(outline: CrossSection) -> tuple[Float64, float]:
    """Return the line, normal and offset in mm, with the least area between the halves and their hulls.

    It passes through the corner that is deepest in a bay. Without a bay, the added volume lies above the
    outline, as over a stroke of changing width: then the line halves the length.
    """
    corners = np.concatenate([np.asarray(each) for each in outline.to_polygons()])
    depths_mm = _depths_mm(outline, corners)
    deepest = corners[int(depths_mm.argmax())]
    cuts = []
    directions = _DIRECTIONS
    if depths_mm.max() <= _OUTLINE_MM:  # no bay
        directions = directions[:0]
    for number, normal in enumerate(directions):
        far, along = normal * _FAR_MM, np.array([-normal[1], normal[0]]) * _FAR_MM
        start = normal * float(normal @ deepest)
        corner = start - along, start - along + far, start + along + far, start + along
        half = CrossSection([np.array(corner)])
        halves = (outline ^ half, outline - half)
        if not any(each.is_empty() for each in halves):
            area = sum(piece.hull().area() for each in halves for piece in each.decompose())
            cuts.append((area, number))
    if cuts:
        normal = _DIRECTIONS[min(cuts)[1]]
        return normal, float(normal @ deepest)
    normal = max(_DIRECTIONS, key=lambda each: float(np.ptp(corners @ each)))
    along = corners @ normal
    return normal, float(along.min() + along.max()) / 2


def _depths_mm(outline: CrossSection, corners: Float64) -> Float64:
    """Return the depth of each corner of an outline below its convex hull, shape (N,), mm."""
    hull = np.asarray(outline.hull().to_polygons()[0])
    along = np.roll(hull, -1, axis=0) - hull
    inwards = np.stack([-along[:, 1], along[:, 0]], axis=1)
    inwards /= np.maximum(np.linalg.norm(inwards, axis=1, keepdims=True), 1e-12)
    depths: Float64 = ((corners[:, None] - hull[None]) * inwards[None]).sum(axis=2).min(axis=1)
    return depths
