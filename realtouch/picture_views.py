"""Choice and sheets of pictures of touches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tactile_toolkit import pictures, touch
from tactile_toolkit.array_types import UInt8

MAX_TILES = 32
"""Touches that a notebook shows of a round."""

_GAP = 4


def evenly_spaced(count: int, most: int) -> list[int]:
    """Choose up to ``most`` of ``count`` indices, first and last among them."""
    indices: list[int] = np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int)).tolist()
    return indices


def contact_sheet(images: Sequence[UInt8], columns: int = 8, tile_width: int = 120) -> UInt8:
    """Arrange RGB images, (H, W, 3), in rows of ``columns``, each ``tile_width`` pixels wide.

    All get the proportions of the first.
    """
    height = pictures.fitted(images[0], tile_width).shape[0]
    tiles = [pictures.Tile(touch.resized(image, tile_width, height)) for image in images]
    return pictures.sheet(tiles, min(columns, len(images)), gap_px=_GAP, margin_px=_GAP)
