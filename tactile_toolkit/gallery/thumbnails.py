"""Thumbnails of a gallery, as PNG."""

from __future__ import annotations

import numpy as np
from PIL import Image

from tactile_toolkit import pictures, touch
from tactile_toolkit.array_types import Floating, Integers, UInt8

THUMBNAIL_PX = 144
"""Longer side of a thumbnail."""

_MARGIN_PX = 9  # both margins of `relief` together


def thumbnail(pixels: UInt8, opaque_from: int | None = None) -> bytes:
    """Make a PNG thumbnail of grey levels, (H, W), or colours, (H, W, 3).

    With ``opaque_from``, paper, which has the colour of the top left pixel, becomes transparent, for light
    and dark pages. Pixels that are darker by this number of levels are opaque, lighter ones partly
    transparent; use 1 for pictures without smooth edges.
    """
    picture = Image.fromarray(np.ascontiguousarray(pixels))
    if opaque_from is not None:
        layers = pixels.reshape(*pixels.shape[:2], -1).astype(np.float32)
        paper = layers[0, 0]
        share = np.clip((paper - layers).max(axis=-1) / opaque_from, 0, 1)[..., None]
        # The share of the paper in smooth edges is removed, so that no light rim shows on dark pages.
        ink = np.clip((layers - (1 - share) * paper) / np.maximum(share, 1 / 255), 0, 255)
        levels = np.concatenate([np.where(share > 0, ink, 0), 255 * share], axis=-1).round().astype(np.uint8)
        picture = Image.fromarray(levels, {2: "LA", 4: "RGBA"}[levels.shape[-1]])
    picture.thumbnail((THUMBNAIL_PX, THUMBNAIL_PX), Image.Resampling.BOX)
    return touch.encode_png(picture)


def relief_thumbnail(vertices_m: Floating, faces: Integers) -> bytes:
    """Make the thumbnail of a mesh from above, scaled to its tile."""
    longest_m = float(np.ptp(vertices_m[:, :2], axis=0).max())
    # Drawn twice as large, except for the margin; meshes of other sources may have no extent.
    pitch_m = max(longest_m, 1e-6) / (2 * THUMBNAIL_PX - _MARGIN_PX)
    return thumbnail(pictures.relief(vertices_m, faces, pitch_m), opaque_from=1)
