"""Small pictures of meshes, without a screen or a plotting library."""

from __future__ import annotations

import base64
import html
import io
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from mnist3d.dataset import MeshRecord

__all__ = ["record_html", "relief"]

_LIGHT = np.array([-0.45, 0.55, 0.70])
_PITCH_M = 0.0002


def relief(
    vertices_m: NDArray[np.floating[Any]], faces: NDArray[np.integer[Any]], pitch_m: float = _PITCH_M
) -> NDArray[np.uint8]:
    """Draw a mesh from above in shaded relief.

    Parameters
    ----------
    vertices_m : ndarray of float, shape (V, 3)
        Metres, z towards the viewer.
    faces : ndarray of int, shape (F, 3)
        Triangles, counter-clockwise seen from outside.
    pitch_m : float
        Side of a pixel.

    Returns
    -------
    ndarray of uint8, shape (H, W)
        255 is empty paper; row 0 is the largest y.
    """
    from PIL import Image, ImageDraw

    corners = np.asarray(vertices_m, np.float64)[np.asarray(faces)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    seen = (normals[:, 2] > 0) & (lengths > 0)
    corners, normals = corners[seen], normals[seen] / lengths[seen, None]
    shades = (60 + 180 * np.clip(normals @ _LIGHT, 0, 1)).astype(int)
    low, high = vertices_m[:, :2].min(axis=0), vertices_m[:, :2].max(axis=0)
    width, height = (np.ceil((high - low) / pitch_m).astype(int) + 9).tolist()
    picture = Image.new("L", (width, height), 255)
    draw = ImageDraw.Draw(picture)
    points = (corners[:, :, :2] - low) / pitch_m + 4
    points[:, :, 1] = height - 1 - points[:, :, 1]
    # Painter's order: what lies higher is drawn last.
    for index in np.argsort(corners[:, :, 2].mean(axis=1)):
        draw.polygon([tuple(point) for point in points[index].tolist()], fill=int(shades[index]))
    return np.asarray(picture)


def record_html(record: MeshRecord) -> str:
    """Return what a notebook shows of a digit: its relief and its figures."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(relief(record.vertices_m, record.faces)).save(stream, format="PNG")
    picture = base64.b64encode(stream.getvalue()).decode()
    size_mm = np.ptp(record.vertices_m, axis=0) * 1000
    facts = (
        f"digit {record.label}, id {record.id}, writer {record.writer}: "
        f"{size_mm[0]:.1f} x {size_mm[1]:.1f} x {size_mm[2]:.1f} mm, "
        f"{record.volume_m3 * 1e9:.0f} mm³, {len(record.faces):,} triangles"
    )
    caption = f"<figcaption>{html.escape(facts)}</figcaption>"
    return f'<figure><img src="data:image/png;base64,{picture}">{caption}</figure>'
