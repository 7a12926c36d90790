"""Solids on a base plate, which joins separate parts and prints without support."""

from __future__ import annotations

from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.mesh import Mesh, MeshLike, as_mesh
from tactile_toolkit.mesh.solid_check import require_solid

# The plate is wider than the solid on each side, and its corners are round.
_MARGIN_MM, _CORNER_MM = 3.0, 2.0
# The solid reaches so far into the plate that both become one body.
_SUNK_MM = 0.2
_SEGMENTS = 32


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
        raise InputError(f"base_mm is {base_mm!r}; expected a thickness above 0 mm")
    body = require_solid(as_mesh(solid)).manifold
    left, front, low, right, back, high = body.bounding_box()
    middle, sunk = (low + high) / 2, min(_SUNK_MM, base_mm / 2)
    upper = body.trim_by_plane((0.0, 0.0, 1.0), middle - sunk).translate((0.0, 0.0, base_mm - middle))
    inner = _MARGIN_MM - _CORNER_MM
    sides = (right - left + 2 * inner, back - front + 2 * inner)
    outline = manifold3d.CrossSection.square(sides).translate((left - inner, front - inner))
    outline = outline.offset(_CORNER_MM, manifold3d.JoinType.Round, circular_segments=_SEGMENTS)
    plate = manifold3d.Manifold.extrude(outline, base_mm)
    return Mesh.from_manifold(upper + plate)
