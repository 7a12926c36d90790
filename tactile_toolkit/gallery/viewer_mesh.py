"""Meshes for the viewer of a gallery.

A mesh is packed as differences of integer steps of 10 µm, deflated, as text: a digit of 5,000 vertices takes
about 30 kB, instead of 180 kB for its arrays.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence

import numpy as np

from tactile_toolkit import mesh
from tactile_toolkit.array_types import Floating, Int64, Integers
from tactile_toolkit.errors import IntegrityError

STEP_MM = 0.01
"""Grid to which vertices are rounded, a twentieth of a printed layer; coarser for meshes above 655 mm, finer
for those below 10 mm."""

_MIN_STEPS = 1_000
_MIN_STEP_MM = 1e-6
_MAX_STEPS = np.iinfo(np.uint16).max


def packed_mesh(
    vertices_m: Floating,
    faces: Integers,
    parts: Sequence[tuple[int, str]] = (),
    *,
    flat: bool = False,
) -> dict[str, object]:
    """Pack a mesh, (V, 3) in metres with z up and (F, 3), as JSON values for the viewer of the page.

    ``parts`` are runs of triangles with their colour, ``"main"`` or ``"other"``; all are ``"main"`` by
    default. ``flat`` shows sharp edges instead of smooth shading. ``vertices`` and ``faces`` become base64 of
    zlib of four planes of bytes (lowest first) of zigzag numbers, each the difference to the number before;
    vertices are all x, all y, all z, in steps of ``step_mm`` above ``low_mm``.
    """
    vertices_mm = np.asarray(vertices_m, np.float64) * mesh.MM_PER_M
    low_mm = vertices_mm.min(axis=0)
    extent_mm = float((vertices_mm.max(axis=0) - low_mm).max())
    step_mm = max(min(STEP_MM, max(extent_mm / _MIN_STEPS, _MIN_STEP_MM)), extent_mm / _MAX_STEPS)
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


def _packed(numbers: Int64) -> str:
    # Neighbours differ little, so the upper planes of bytes are nearly all zero and compress well.
    change = np.diff(numbers, prepend=0)
    # Small differences of either sign become small numbers (as in Protocol Buffers).
    zigzag = ((change << 1) ^ (change >> 63)).astype("<u4")
    planes = zigzag.view(np.uint8).reshape(-1, 4).T
    return base64.b64encode(zlib.compress(planes.tobytes(), 6)).decode("ascii")


def size_text(vertices_m: Floating) -> str:
    """Return the size of a mesh as text: ``"38.2 x 52.1 x 8.0 mm"``."""
    size_mm = np.ptp(np.asarray(vertices_m, np.float64), axis=0) * mesh.MM_PER_M
    return " x ".join(f"{side:.1f}" for side in size_mm) + " mm"


def require_mesh(record: mesh.SolidRecord, split: str) -> None:
    """Raise IntegrityError for a stored mesh that cannot be drawn."""
    problem = mesh.array_problem(mesh.Mesh(record.vertices_m, record.faces))
    if problem is not None:
        raise IntegrityError(
            f"the mesh of id {record.id} in split {split!r} cannot be drawn: {problem[1]}",
            next="run `verify` and `validate` on the data set, then generate or download it again",
        )
