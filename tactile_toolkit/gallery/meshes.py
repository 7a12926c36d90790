"""Meshes small enough for a page: whole steps of 10 µm, differences, deflated, as text.

A digit of 5,000 vertices takes about 30 kB so, where its plain arrays take 180 kB.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.mesh.mesh import MM_PER_M

if TYPE_CHECKING:
    from tactile_toolkit.mesh.records import SolidRecord

__all__ = ["STEP_MM", "packed_mesh", "require_mesh", "size_text"]

STEP_MM = 0.01
"""Grid that corners are rounded to, a twentieth of a printed layer; coarser for meshes above 655 mm and finer
for those below 10 mm."""

_FEWEST_STEPS = 1_000
_LEAST_STEP_MM = 1e-6
_MOST_STEPS = np.iinfo(np.uint16).max


def packed_mesh(
    vertices_m: NDArray[np.floating[Any]],
    faces: NDArray[np.integer[Any]],
    parts: Sequence[tuple[int, str]] = (),
    *,
    flat: bool = False,
) -> dict[str, Any]:
    """Pack a mesh for the viewer of the page.

    Parameters
    ----------
    vertices_m : ndarray of float, shape (V, 3)
        Metres, z up from the plate.
    faces : ndarray of int, shape (F, 3)
        Triangles, counter-clockwise seen from outside.
    parts : sequence of (int, str)
        Runs of triangles and the paint of each: ``"main"`` or ``"other"``. All are ``"main"`` by default.
    flat : bool
        Show edges sharp instead of rounding the shade off.

    Returns
    -------
    dict
        JSON values. ``vertices`` and ``faces``: base64 of zlib of four planes of bytes (lowest first) of
        zigzag numbers, each the difference to the number before; vertices as x of all, y of all, z of all in
        steps of ``step_mm`` above ``low_mm``.
    """
    vertices_mm = np.asarray(vertices_m, np.float64) * MM_PER_M
    low_mm = vertices_mm.min(axis=0)
    extent_mm = float((vertices_mm.max(axis=0) - low_mm).max())
    step_mm = max(min(STEP_MM, max(extent_mm / _FEWEST_STEPS, _LEAST_STEP_MM)), extent_mm / _MOST_STEPS)
    steps = np.round((vertices_mm - low_mm) / step_mm).astype(np.int64)
    return {
        "vertices": _packed(steps.T.reshape(-1)),
        "faces": _packed(np.asarray(faces, np.int64).reshape(-1)),
        "vertex_count": len(vertices_mm),
        "face_count": len(faces),
        "step_mm": step_mm,
        "low_mm": [round(float(value), 6) for value in low_mm],
        "parts": [list(part) for part in parts] or [[len(faces), "main"]],
        "flat": flat,
    }


def _packed(numbers: NDArray[np.int64]) -> str:
    """Write whole numbers as differences, byte plane by byte plane: neighbours differ little."""
    change = np.diff(numbers, prepend=0)
    zigzag = ((change << 1) ^ (change >> 63)).astype("<u4")
    planes = zigzag.view(np.uint8).reshape(-1, 4).T
    return base64.b64encode(zlib.compress(planes.tobytes(), 6)).decode("ascii")


def size_text(vertices_m: NDArray[np.floating[Any]]) -> str:
    """Write the size of a mesh for people: ``"38.2 x 52.1 x 8.0 mm"``."""
    size_mm = np.ptp(np.asarray(vertices_m, np.float64), axis=0) * MM_PER_M
    return " x ".join(f"{side:.1f}" for side in size_mm) + " mm"


def require_mesh(record: SolidRecord, split: str) -> None:
    """Refuse a stored mesh that nothing can draw.

    Raises
    ------
    IntegrityError
        It has no triangle, a corner that is no number, or triangles of corners that are not there.
    """
    vertices, faces = record.vertices_m, record.faces
    whole = len(vertices) and len(faces) and np.isfinite(vertices).all()
    if not whole or faces.min() < 0 or faces.max() >= len(vertices):
        message = (
            f"the mesh of id {record.id} in split {split!r} ({len(vertices):,} vertices, {len(faces):,} "
            "triangles) cannot be drawn: it is empty, or has corners that are missing or no numbers; next: "
            "run `verify` and `validate` on the data set, then generate or download it again"
        )
        raise IntegrityError(message)
