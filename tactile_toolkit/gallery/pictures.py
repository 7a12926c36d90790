"""Thumbnails: small pictures with clear paper, so that they look right on light and dark pages."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.mesh.mesh import MM_PER_M

__all__ = ["THUMBNAIL_PX", "png", "thumbnail", "top_view"]

THUMBNAIL_PX = 144
"""Longer side of a thumbnail."""

_PAPER = 255


def thumbnail(pixels: NDArray[np.uint8], opaque_from: int | None = None) -> bytes:
    """Make the thumbnail of a picture.

    Parameters
    ----------
    pixels : ndarray of uint8, shape (H, W) or (H, W, 3)
        Grey levels or RGB.
    opaque_from : int, optional
        Make paper, which has the colour of the top left pixel, transparent: what is so many levels darker is
        opaque, what is less dark shows the page through. 1 for pictures without smoothed edges.

    Returns
    -------
    bytes
        PNG; the longer side has at most :data:`THUMBNAIL_PX` pixels.
    """
    from PIL import Image

    if opaque_from is None:
        picture = Image.fromarray(np.ascontiguousarray(pixels))
    else:
        picture = _on_clear_paper(pixels, opaque_from)
    picture.thumbnail((THUMBNAIL_PX, THUMBNAIL_PX), Image.Resampling.BOX)
    return png(picture)


def _on_clear_paper(pixels: NDArray[np.uint8], opaque_from: int) -> Any:
    from PIL import Image

    layers = pixels.reshape(*pixels.shape[:2], -1).astype(np.float32)
    paper = layers[0, 0]
    share = np.clip((paper - layers).max(axis=-1) / opaque_from, 0, 1)[..., None]
    # What the paper adds to a smoothed edge is taken out again, so that no light rim shows on a dark page.
    ink = np.clip((layers - (1 - share) * paper) / np.maximum(share, 1 / 255), 0, 255)
    levels = np.concatenate([np.where(share > 0, ink, 0), 255 * share], axis=-1).round().astype(np.uint8)
    return Image.fromarray(levels, "LA" if levels.shape[-1] == 2 else "RGBA")


def png(picture: Any) -> bytes:
    """Encode a picture of Pillow; the bytes depend on its pixels alone."""
    stream = io.BytesIO()
    picture.save(stream, "PNG", compress_level=6)
    return stream.getvalue()


def top_view(
    vertices_m: NDArray[np.floating[Any]],
    faces: NDArray[np.integer[Any]],
    size_m: tuple[float, float],
    px_per_mm: float,
) -> NDArray[np.uint8]:
    """Draw what of a mesh faces up, in one grey: for meshes of flat tops that nothing else is known of.

    Parameters
    ----------
    vertices_m : ndarray of float, shape (V, 3)
        Metres, origin in the middle of the picture, y up.
    faces : ndarray of int, shape (F, 3)
        Triangles, counter-clockwise seen from outside.
    size_m : tuple of float
        Width and height of what is shown.
    px_per_mm : float
        Scale.

    Returns
    -------
    ndarray of uint8, shape (H, W)
        255 is empty paper.
    """
    from PIL import Image, ImageDraw

    scale = px_per_mm * MM_PER_M
    width, height = (max(1, round(side * scale)) for side in size_m)
    picture = Image.new("L", (width, height), _PAPER)
    draw = ImageDraw.Draw(picture)
    corners = np.asarray(vertices_m, np.float64)[np.asarray(faces)][:, :, :2]
    sides = corners[:, 1:] - corners[:, :1]
    upward = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0] > 0
    points = corners[upward] * (scale, -scale) + (width / 2, height / 2)
    for triangle in points.tolist():
        draw.polygon([tuple(point) for point in triangle], fill=110)
    return np.asarray(picture)
