"""An open-end wrench from a handful of lengths: a plane outline by constructive geometry, made a solid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from manifold3d import CrossSection, JoinType, triangulate

from env_assets.wrench.spec import WrenchSpec
from tactile_toolkit.arithmetic import cosine_sine
from tactile_toolkit.array_types import Float64, Int64
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import MM_PER_M, Mesh, check_manifold

# Sides of a whole circle: 0.03 mm from round at 60 mm across, less than a printer can show.
_SEGMENTS = 96

# Corners that matter less than this are dropped.
_TIDY_MM = 1e-3

# Area that tidying may take from where a nut is held.
_NOTHING_MM2 = 0.01


def wrench_mesh(spec: WrenchSpec) -> Mesh:
    """Make the solid of a wrench.

    Parameters
    ----------
    spec : WrenchSpec
        Its lengths.

    Returns
    -------
    Mesh
        Float32 metres. Frame: origin on the axis of the handle, half way along the length; x along the handle
        towards the first jaw, z up, the wrench lying on z = 0. A published environment that estimates poses
        takes origin and x axis of this frame as the pose.

    Raises
    ------
    InputError
        The chamfer is too large for the outline.
    """
    return chamfered_plate(wrench_outline(spec), spec.thickness_mm, spec.chamfer_mm)


def wrench_outline(spec: WrenchSpec) -> list[Float64]:
    """Draw a wrench: closed lines in millimetres, shapes (n, 2), the material on their left.

    The frame is that of :func:`wrench_mesh`. InputError when the chamfer leaves less than a whole wrench.
    """
    body = _body(spec)
    for place_mm, opening_mm, turned_deg in _jaws(spec):
        body -= _jaw(spec, opening_mm).rotate(turned_deg).translate((place_mm, 0.0))
    tidy = _opened(body, _tip_radius_mm(spec)).simplify(_TIDY_MM)
    _require_whole(spec, body, tidy)
    return [np.asarray(line, np.float64) for line in tidy.to_polygons()]


def _tip_radius_mm(spec: WrenchSpec) -> float:
    """Return how tips of jaws and other outer corners are rounded: wide enough to carry the chamfer.

    Rounding takes away what is narrower than its disc, so no jaw may become shorter than the sides of its
    nut: the disc between the jaw's flat side (at half the width w) and the circle of the head (of radius R)
    still touches that side at the nut's corner, ``(R - r)^2 - (w / 2 + r)^2 >= w^2 / 12``.
    """
    # One jaw less than heads where the second end is plain: nothing has to be held there.
    heads_mm = (spec.head_mm, spec.second_head_mm)
    most_mm = []
    for head_mm, (_, opening_mm, _) in zip(heads_mm, _jaws(spec), strict=False):
        width_mm = opening_mm + spec.clearance_mm
        most_mm.append((head_mm**2 / 4 - width_mm**2 / 3) / (head_mm + width_mm))
    return min(max(1.0, 2.0 * spec.chamfer_mm), *most_mm)


def _require_whole(spec: WrenchSpec, body: Any, tidy: Any) -> None:
    """Refuse what is not one piece, below and above the chamfer, or does not hold every nut any more."""
    for piece in (tidy, _grown(tidy, -spec.chamfer_mm)):
        if piece.num_contour() != 1:
            raise InputError(
                f"a chamfer of {spec.chamfer_mm:g} mm cuts this wrench into {piece.num_contour()} parts",
                next="choose a smaller chamfer_mm, or a larger handle_mm, head_mm or second_head_mm",
            )
    lost = body - tidy
    for place_mm, opening_mm, turned_deg in _jaws(spec):
        # Where the jaw bears on the outer half of two opposite sides of the nut.
        width_mm, deep_mm = opening_mm + spec.clearance_mm, 0.1
        size_mm = (width_mm / (2 * math.sqrt(3)), width_mm + 2 * deep_mm)
        flats = CrossSection.square(size_mm).translate((0.0, -size_mm[1] / 2))
        if (lost ^ flats.rotate(turned_deg).translate((place_mm, 0.0))).area() > _NOTHING_MM2:
            raise InputError(
                f"a chamfer of {spec.chamfer_mm:g} mm leaves no whole jaw for {opening_mm:g} mm",
                next="choose a smaller chamfer_mm, or a larger head_mm or second_head_mm",
            )


def _body(spec: WrenchSpec) -> Any:
    """Two discs and the handle between them, the joints filled."""
    first_mm, second_mm = _middles_mm(spec)
    body = CrossSection.square((first_mm - second_mm, spec.handle_mm)).translate(
        (second_mm, -spec.handle_mm / 2)
    )
    for place_mm, diameter_mm in ((first_mm, spec.head_mm), (second_mm, spec.second_head_mm)):
        body += CrossSection.circle(diameter_mm / 2, _SEGMENTS).translate((place_mm, 0.0))
    # Grown and shrunk again: inner corners are filled with the radius.
    return _grown(_grown(body, spec.fillet_mm), -spec.fillet_mm)


def _middles_mm(spec: WrenchSpec) -> tuple[float, float]:
    """Return where along x the middles of both ends lie."""
    return (spec.length_mm - spec.head_mm) / 2, (spec.second_head_mm - spec.length_mm) / 2


def _jaws(spec: WrenchSpec) -> list[tuple[float, float, float]]:
    """Return middle, opening and direction of each jaw."""
    first_mm, second_mm = _middles_mm(spec)
    jaws = [(first_mm, spec.opening_mm, spec.jaw_angle_deg)]
    if spec.second_opening_mm:
        jaws.append((second_mm, spec.second_opening_mm, 180.0 + spec.jaw_angle_deg))
    return jaws


def _jaw(spec: WrenchSpec, opening_mm: float) -> Any:
    """Return what a nut needs: its hexagon, and the way out along x."""
    width_mm = opening_mm + spec.clearance_mm
    # Not by numpy's cosine, which processors round differently: the shard's bytes are the same on all.
    corners = width_mm / math.sqrt(3) * np.array([cosine_sine(math.tau * side / 6) for side in range(6)])
    way_out = CrossSection.square((spec.length_mm, width_mm)).translate((0.0, -width_mm / 2))
    # A round root breaks less easily than a sharp one, and a printer rounds it anyway.
    return _opened(CrossSection([corners]) + way_out, 0.1 * opening_mm)


def _opened(shape: Any, radius_mm: float) -> Any:
    """Round outer corners with a radius."""
    return _grown(_grown(shape, -radius_mm), radius_mm)


def _grown(shape: Any, by_mm: float) -> Any:
    return shape.offset(by_mm, JoinType.Round, 2.0, _SEGMENTS) if by_mm else shape


def chamfered_plate(outline: Sequence[Float64], thickness_mm: float, chamfer_mm: float) -> Mesh:
    """Make a plate that lies on z = 0, its edges cut at 45 degrees above and below; a solid, float32 metres.

    The outline is closed lines in millimetres, the material on their left; 0 gives sharp edges. InputError
    when it is too narrow or too sharp for the chamfer.
    """
    inner = [_moved_in(line, chamfer_mm) for line in outline]
    levels: list[tuple[Sequence[Float64], float]] = [(inner, 0.0), (inner, thickness_mm)]
    if chamfer_mm:
        levels[1:1] = [(outline, chamfer_mm), (outline, thickness_mm - chamfer_mm)]
    # Inner lines have as many corners as the outline, so that levels are joined corner by corner: offsets of
    # manifold3d add and drop some.
    vertices_mm = np.concatenate(
        [np.insert(np.concatenate(lines), 2, z_mm, axis=1) for lines, z_mm in levels]
    )
    # Bottom and top, and what lies between.
    top = np.asarray(triangulate(list(inner)), np.int64)
    above = (len(levels) - 1) * sum(len(line) for line in inner)
    faces = [top[:, ::-1], top + above, *_sides(outline, len(levels))]
    mesh = Mesh((vertices_mm / MM_PER_M).astype(np.float32), np.concatenate(faces).astype(np.int32))
    verdict = check_manifold(mesh)
    if verdict.problem is not None:
        raise _too_large(chamfer_mm, str(verdict.detail))
    return mesh


def _moved_in(line: Float64, by_mm: float) -> Float64:
    """Move every side of a closed line to its left; corners keep their number."""
    if not by_mm:
        return line
    along = np.roll(line, -1, axis=0) - line
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    left = np.stack([-along[:, 1], along[:, 0]], axis=1)
    before = np.roll(left, 1, axis=0)
    moved = line + by_mm * (before + left) / (1.0 + (before * left).sum(axis=1, keepdims=True))
    sides = np.roll(moved, -1, axis=0) - moved
    if ((sides * along).sum(axis=1) <= 0).any():
        raise _too_large(by_mm, "a side of the outline vanishes")
    return np.asarray(moved)


def _sides(lines: Sequence[Float64], levels: int) -> list[Int64]:
    """Return the triangles between levels, two for each side of each line."""
    per_level = sum(len(line) for line in lines)
    triangles, start = [], 0
    for line in lines:
        here = start + np.arange(len(line))
        after = np.roll(here, -1)
        for level in range(levels - 1):
            low, high = level * per_level, (level + 1) * per_level
            triangles.append(np.stack([here + low, after + low, after + high], axis=1))
            triangles.append(np.stack([here + low, after + high, here + high], axis=1))
        start += len(line)
    return triangles


def _too_large(chamfer_mm: float, why: str) -> InputError:
    what = f"a chamfer of {chamfer_mm:g} mm is too large for this wrench ({why})"
    return InputError(what, next="choose a smaller one")
