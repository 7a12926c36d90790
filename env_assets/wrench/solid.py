"""From an outline to a plate with chamfered edges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh
from tactile_toolkit.mesh.solid_check import check_manifold

__all__ = ["chamfered_plate"]

Line = NDArray[np.float64]


def chamfered_plate(outline: Sequence[Line], thickness_mm: float, chamfer_mm: float) -> Mesh:
    """Make a plate that lies on z = 0, its edges cut at 45 degrees above and below.

    Parameters
    ----------
    outline : sequence of ndarray, shape (n, 2)
        Closed lines in millimetres, the material on their left.
    thickness_mm, chamfer_mm : float
        Height of the plate, and how far the chamfer goes in and down; 0 gives sharp edges.

    Returns
    -------
    Mesh
        Float32 metres; a solid by :func:`tactile_toolkit.mesh.solid_check.check_manifold`.

    Raises
    ------
    InputError
        The outline is too narrow or too sharp for the chamfer.
    """
    inner = [_moved_in(line, chamfer_mm) for line in outline]
    levels: list[tuple[Sequence[Line], float]] = [(inner, 0.0), (inner, thickness_mm)]
    if chamfer_mm:
        levels[1:1] = [(outline, chamfer_mm), (outline, thickness_mm - chamfer_mm)]
    vertices_mm = np.concatenate([_lifted(np.concatenate(lines), z_mm) for lines, z_mm in levels])
    faces = [*_caps(inner, len(levels)), *_sides(outline, len(levels))]
    mesh = Mesh((vertices_mm / MM_PER_M).astype(np.float32), np.concatenate(faces).astype(np.int32))
    verdict = check_manifold(mesh)
    if verdict.problem is not None:
        raise InputError(_too_large(chamfer_mm, str(verdict.detail)))
    return mesh


def _moved_in(line: Line, by_mm: float) -> Line:
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
        raise InputError(_too_large(by_mm, "a side of the outline vanishes"))
    return np.asarray(moved)


def _lifted(points_mm: Line, z_mm: float) -> Line:
    return np.column_stack([points_mm, np.full(len(points_mm), z_mm)])


def _caps(lines: Sequence[Line], levels: int) -> list[NDArray[np.int64]]:
    """Return the triangles of bottom and top."""
    from manifold3d import triangulate

    top = np.asarray(triangulate(list(lines)), np.int64)
    per_level = sum(len(line) for line in lines)
    return [top[:, ::-1], top + (levels - 1) * per_level]


def _sides(lines: Sequence[Line], levels: int) -> list[NDArray[np.int64]]:
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


def _too_large(chamfer_mm: float, why: str) -> str:
    return f"a chamfer of {chamfer_mm:g} mm is too large for this wrench ({why}); next: choose a smaller one"
