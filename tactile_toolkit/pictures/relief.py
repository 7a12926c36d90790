"""Small pictures of meshes, without a screen or a plotting library."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from tactile_toolkit.mesh.mesh import Mesh


_PITCH_M = 0.0002
_TILE_PX = 96
_MOST_PX = 4096  # of the longer side


def relief(
    vertices_m: NDArray[np.floating[Any]], faces: NDArray[np.integer[Any]], pitch_m: float = _PITCH_M
) -> NDArray[np.uint8]:
    """Draw a mesh from above in shaded relief, one pixel every ``pitch_m``; coarser where that is too many.

    Returns levels of uint8, shape (H, W): 255 is empty paper; row 0 is the largest y.
    """
    from tactile_toolkit.mesh.raster import highest_faces
    from tactile_toolkit.pictures.render import shades

    vertices, faces = np.asarray(vertices_m, np.float64), np.asarray(faces)
    low, high = vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0)
    # A mesh in millimetres, taken for metres, would have 10^10 pixels.
    pitch_m = max(pitch_m, float((high - low).max()) / _MOST_PX)
    # Four pixels of paper on every side, and one for the pixel that the last corner lies in.
    width, height = (np.ceil((high - low) / pitch_m).astype(int) + 9).tolist()
    columns, rows = ((vertices[:, :2] - low) / pitch_m + 4).T
    # Rows grow with y here, so that triangles keep their orientation; the picture is turned over at the end.
    seen = highest_faces(np.stack([columns, rows, vertices[:, 2]]), faces, (height, width))
    return np.append(shades(vertices, faces), np.uint8(255))[seen[::-1]]


def relief_tile_html(
    vertices_m: NDArray[np.floating[Any]], faces: NDArray[np.integer[Any]], caption: str
) -> str:
    """Return what a notebook shows of a mesh among others: a small relief and its caption, plain text."""
    from tactile_toolkit.pictures.writing import TILE_STYLE, figure_html

    pitch_m = max(float(np.ptp(vertices_m[:, :2], axis=0).max()) / _TILE_PX, 1e-6)
    return figure_html(relief(vertices_m, faces, pitch_m), caption, TILE_STYLE)


def relief_of(mesh: Mesh, px_per_mm: float, smoothing: int = 3) -> NDArray[np.uint8]:
    """Draw a mesh as :func:`relief` with smooth edges: so many times larger first, then averaged.

    The margin is one to two pixels.
    """
    from tactile_toolkit.pictures.render import averaged

    return averaged(relief(mesh.vertices_m, mesh.faces, 1e-3 / (px_per_mm * smoothing)), smoothing)
