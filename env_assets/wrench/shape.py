"""An open-end wrench: one parametric outline by constructive geometry, made a solid with chamfered edges."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from manifold3d import CrossSection, JoinType, triangulate

from env_assets.wrench.kind import CHAMFER_MM, JAW_ANGLE_DEG, WrenchSpec
from tactile_toolkit.arithmetic import cosine_sine
from tactile_toolkit.array_types import Float64, Int64
from tactile_toolkit.mesh import MM_PER_M, Mesh

# Sides of a full circle: 0.03 mm from round at 60 mm across, less than a printer can show.
_SEGMENTS = 96
# Corners that deviate less than this from a straight line are dropped.
_TIDY_MM = 1e-3


def wrench_mesh(spec: WrenchSpec) -> Mesh:
    """Make the solid of a wrench.

    Parameters
    ----------
    spec : WrenchSpec
        Sizes of its nuts.

    Returns
    -------
    Mesh
        Float32 metres. Frame: origin on the axis of the handle, halfway along the length; x along the handle
        towards the first jaw, z up, the wrench lying on z = 0. A published environment that estimates poses
        takes origin and x axis of this frame as the pose.
    """
    return _chamfered_plate(_outline(spec), spec.lengths()["thickness_mm"])


def _outline(spec: WrenchSpec) -> list[Float64]:
    """Draw a wrench: closed lines in millimetres, shapes (n, 2), the material on their left."""
    lengths = spec.lengths()
    length_mm, handle_mm = lengths["length_mm"], lengths["handle_mm"]
    first_mm = (length_mm - lengths["head_mm"]) / 2
    second_mm = (lengths["second_head_mm"] - length_mm) / 2
    body = CrossSection.square((first_mm - second_mm, handle_mm)).translate((second_mm, -handle_mm / 2))
    for place_mm, diameter_mm in ((first_mm, lengths["head_mm"]), (second_mm, lengths["second_head_mm"])):
        body += CrossSection.circle(diameter_mm / 2, _SEGMENTS).translate((place_mm, 0.0))
    # Growing and shrinking it again rounds inner corners with the radius.
    body = _grown(_grown(body, lengths["fillet_mm"]), -lengths["fillet_mm"])
    jaws = ((first_mm, spec.opening_mm, 0.0), (second_mm, spec.second_opening_mm, 180.0))
    for place_mm, opening_mm, turned_deg in jaws:
        jaw = _jaw(opening_mm, spec.clearance_mm, length_mm).rotate(turned_deg + JAW_ANGLE_DEG)
        body -= jaw.translate((place_mm, 0.0))
    # Tips of jaws are rounded as wide as the chamfer needs; no jaw gets shorter than the sides of its nut.
    tidy = _opened(body, 2.0 * CHAMFER_MM).simplify(_TIDY_MM)
    return [np.asarray(line, np.float64) for line in tidy.to_polygons()]


def _jaw(opening_mm: float, clearance_mm: float, length_mm: float) -> CrossSection:
    """Return the space that a nut needs: its hexagon, and the opening of the jaw along x."""
    width_mm = opening_mm + clearance_mm
    # Not by numpy's cosine, which processors round differently: the bytes are the same on all.
    corners = width_mm / math.sqrt(3) * np.array([cosine_sine(math.tau * side / 6) for side in range(6)])
    way_out = CrossSection.square((length_mm, width_mm)).translate((0.0, -width_mm / 2))
    # A round root breaks less easily than a sharp one, and a printer rounds it anyway.
    return _opened(CrossSection([corners]) + way_out, 0.1 * opening_mm)


def _opened(shape: CrossSection, radius_mm: float) -> CrossSection:
    """Round outer corners with a radius."""
    return _grown(_grown(shape, -radius_mm), radius_mm)


def _grown(shape: CrossSection, by_mm: float) -> CrossSection:
    return shape.offset(by_mm, JoinType.Round, 2.0, _SEGMENTS)


def _chamfered_plate(outline: Sequence[Float64], thickness_mm: float) -> Mesh:
    """Make a plate that lies on z = 0, its edges cut at 45 degrees above and below; float32 metres."""
    # As many corners as the outline, so that levels are joined corner by corner: offsets of manifold3d add
    # and drop some.
    inner = [_moved_in(line) for line in outline]
    levels = (
        (inner, 0.0),
        (outline, CHAMFER_MM),
        (outline, thickness_mm - CHAMFER_MM),
        (inner, thickness_mm),
    )
    vertices_mm = np.concatenate(
        [np.insert(np.concatenate(lines), 2, z_mm, axis=1) for lines, z_mm in levels]
    )
    # Bottom, top and sides.
    top = np.asarray(triangulate(inner), np.int64)
    above = (len(levels) - 1) * sum(map(len, inner))
    faces = [top[:, ::-1], top + above, *_sides(outline, len(levels))]
    return Mesh((vertices_mm / MM_PER_M).astype(np.float32), np.concatenate(faces).astype(np.int32))


def _moved_in(line: Float64) -> Float64:
    """Move every side of a closed line to its left by the chamfer; corners keep their number."""
    along = np.roll(line, -1, axis=0) - line
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    left = np.stack([-along[:, 1], along[:, 0]], axis=1)
    before = np.roll(left, 1, axis=0)
    corners = (before + left) / (1.0 + (before * left).sum(axis=1, keepdims=True))
    return np.asarray(line + CHAMFER_MM * corners)


def _sides(lines: Sequence[Float64], levels: int) -> list[Int64]:
    """Return the triangles between levels, two for each side of each line."""
    per_level = sum(map(len, lines))
    triangles = []
    start = 0
    for line in lines:
        here = start + np.arange(len(line))
        after = np.roll(here, -1)
        for level in range(levels - 1):
            low = level * per_level
            high = (level + 1) * per_level
            triangles.append(np.stack([here + low, after + low, after + high], axis=1))
            triangles.append(np.stack([here + low, after + high, here + high], axis=1))
        start += len(line)
    return triangles
