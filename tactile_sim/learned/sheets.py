"""Sheets of pictures: how far a training is, and what came of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.pictures.lettering import PAPER, draw_text
from tactile_toolkit.pictures.writing import png_bytes

__all__ = ["sheet_png"]

_TILE_PX = 96
_TITLE_PX = 18


def sheet_png(columns: Sequence[tuple[str, NDArray[Any]]]) -> bytes:
    """Draw columns of pictures under their titles: uint8 colours (n, H, W, 3), or depth images (n, H, W).

    Where objects were left out of a set, its two kinds of pictures differ in number: shorter columns end in
    white.
    """
    from PIL import Image, ImageDraw

    strips = []
    for title, pictures in columns:
        tiles = [_tile(picture) for picture in pictures]
        head = Image.new("RGB", (tiles[0].shape[1], _TITLE_PX), PAPER)
        draw_text(ImageDraw.Draw(head), (3, 2), title, 11)
        strips.append(np.concatenate([np.asarray(head), *tiles]))
    tallest = max(map(len, strips))
    filled = [
        np.pad(strip, ((0, tallest - len(strip)), (0, 0), (0, 0)), constant_values=255) for strip in strips
    ]
    return png_bytes(np.concatenate(filled, axis=1))


def _tile(picture: NDArray[Any]) -> NDArray[np.uint8]:
    if picture.ndim == 2:
        picture = np.rint(np.clip(picture, 0, 1) * 255).astype(np.uint8)[..., None].repeat(3, axis=2)
    times = -(-_TILE_PX // picture.shape[1])  # titles need the room
    step = max(1, picture.shape[1] // (2 * _TILE_PX))
    shown = picture[::step, ::step].repeat(times, axis=0).repeat(times, axis=1)
    return np.pad(shown, ((1, 1), (1, 1), (0, 0)), constant_values=255)
