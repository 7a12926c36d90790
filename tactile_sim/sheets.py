"""Sheets of pictures: those of cards, how far a training is, and what came of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.pictures.sheets import PAPER, draw_text
from tactile_toolkit.pictures.writing import png_bytes

TILE_PX = 96
"""Width of pictures in sheets, about."""

_TITLE_PX = 18


def sheet_png(columns: Sequence[tuple[str, NDArray[Any]]]) -> bytes:
    """Draw columns of pictures under their titles: uint8 colours (n, H, W, 3), or depth images (n, H, W).

    Where objects were left out of a set, its two kinds of pictures differ in number: shorter columns end in
    white.
    """
    from PIL import Image, ImageDraw

    strips = []
    for title, pictures in columns:
        tiles = [tile(picture, TILE_PX, 2 * TILE_PX) for picture in pictures]  # titles need the room
        head = Image.new("RGB", (tiles[0].shape[1], _TITLE_PX), PAPER)
        draw_text(ImageDraw.Draw(head), (3, 2), title, 11)
        strips.append(np.concatenate([np.asarray(head), *tiles]))
    tallest = max(map(len, strips))
    filled = [
        np.pad(strip, ((0, tallest - len(strip)), (0, 0), (0, 0)), constant_values=255) for strip in strips
    ]
    return png_bytes(np.concatenate(filled, axis=1))


def tile(picture: NDArray[Any], least_px: int = 1, most_px: int = TILE_PX) -> NDArray[np.uint8]:
    """Return a picture, uint8 colours (H, W, 3) or depth (H, W), in a white frame; its width between both.

    Every n-th pixel, or each n times: as a data set holds it, nothing is smoothed.
    """
    if picture.ndim == 2:
        picture = np.rint(np.clip(picture, 0, 1) * 255).astype(np.uint8)[..., None].repeat(3, axis=2)
    times, step = -(-least_px // picture.shape[1]), max(1, picture.shape[1] // most_px)
    shown = picture[::step, ::step].repeat(times, axis=0).repeat(times, axis=1)
    return np.pad(shown, ((1, 1), (1, 1), (0, 0)), constant_values=255)
