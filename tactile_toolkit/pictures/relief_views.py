"""Meshes from above in shaded relief, with equal pixels on all machines."""

from __future__ import annotations

import numpy as np

from tactile_toolkit import arithmetic
from tactile_toolkit.array_types import Floating, Integers, UInt8
from tactile_toolkit.mesh import Mesh, highest_faces
from tactile_toolkit.pictures.picture_files import TILE_STYLE, figure_html
from tactile_toolkit.pictures.vectors import face_normals, unit_vectors

_PITCH_M = 0.0002
_TILE_PX = 96
_MAX_PX = 4096  # largest side of a relief

# Direction of the light of reliefs: right, up and out of the picture.
_LIGHT = np.array([-0.45, 0.55, 0.70])

_DARKEST, _RANGE = 60, 180


def box_downsample(pixels: UInt8, factor: int) -> UInt8:
    """Reduce a picture, (H, W) or (H, W, 3), by an integer factor; each pixel is a mean.

    Sides that are not a multiple of ``factor`` are padded with white.
    """
    height, width = (-(-side // factor) for side in pixels.shape[:2])
    padding = [(0, height * factor - pixels.shape[0]), (0, width * factor - pixels.shape[1])]
    padded = np.pad(pixels, [*padding, *[(0, 0)] * (pixels.ndim - 2)], constant_values=255)
    blocks = padded.reshape(height, factor, width, factor, *pixels.shape[2:])
    sums = blocks.sum(axis=(1, 3), dtype=np.uint32)
    return np.asarray((sums + factor * factor // 2) // (factor * factor), np.uint8)


def relief(vertices_m: Floating, faces: Integers, pitch_m: float = _PITCH_M) -> UInt8:
    """Draw a mesh from above in shaded relief, with pixels of ``pitch_m``, or larger ones for large meshes.

    Returns levels of uint8, shape (H, W): 255 is empty paper; row 0 is the largest y.
    """
    vertices, faces = np.asarray(vertices_m, np.float64), np.asarray(faces)
    low, high = vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0)
    # A mesh in millimetres that is read in metres would have 10^10 pixels.
    pitch_m = max(pitch_m, float((high - low).max()) / _MAX_PX)
    # Four pixels of margin on each side, and one for the pixel of the last corner.
    width, height = (np.ceil((high - low) / pitch_m).astype(int) + 9).tolist()
    columns, rows = ((vertices[:, :2] - low) / pitch_m + 4).T
    # Rows grow with y here, so that triangles keep their orientation; the picture is flipped at the end.
    seen = highest_faces(np.stack([columns, rows, vertices[:, 2]]), faces, (height, width))
    normals = face_normals(vertices, faces)
    # Faces that point away are lit as if they did not, so that damaged meshes are visible.
    normals *= np.where(normals[:, 2:] < 0, -1.0, 1.0)
    light = arithmetic.moved(unit_vectors(normals), _LIGHT[:, None])[:, 0]
    shades = np.asarray(_DARKEST + _RANGE * np.clip(light, 0, 1)).astype(np.uint8)
    return np.append(shades, np.uint8(255))[seen[::-1]]


def relief_tile_html(vertices_m: Floating, faces: Integers, caption: str) -> str:
    """Return HTML for notebooks of a small relief and its caption, which is plain text."""
    pitch_m = max(float(np.ptp(vertices_m[:, :2], axis=0).max()) / _TILE_PX, 1e-6)
    return figure_html(relief(vertices_m, faces, pitch_m), caption, TILE_STYLE)


def relief_of(mesh: Mesh, px_per_mm: float, smoothing: int = 3) -> UInt8:
    """Draw a mesh as :func:`relief` does, with smooth edges. The margin is one to two pixels."""
    return box_downsample(relief(mesh.vertices_m, mesh.faces, 1e-3 / (px_per_mm * smoothing)), smoothing)
