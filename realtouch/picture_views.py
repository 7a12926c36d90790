"""Sheets of pictures, and views of touches in notebooks."""

from __future__ import annotations

import html
from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np

from tactile_toolkit import errors, touch
from tactile_toolkit.array_types import UInt8
from tactile_toolkit.pictures import TILE_STYLE, Tile, figure_html, sheet

MAX_TILES = 32
"""Touches that a notebook shows of a round."""

_TILE_WIDTH = 120
_GAP = 4


def evenly_spaced(count: int, most: int) -> list[int]:
    """Choose up to ``most`` of ``count`` indices, first and last among them."""
    indices: list[int] = np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int)).tolist()
    return indices


def fitted(image: UInt8, width: int) -> UInt8:
    """Return an image, (H, W, 3), at another width in pixels, its proportions kept."""
    return touch.resized(image, width, max(1, round(width * image.shape[0] / image.shape[1])))


def contact_sheet(images: Sequence[UInt8], columns: int = 8, tile_width: int = _TILE_WIDTH) -> UInt8:
    """Arrange RGB images, (H, W, 3), in rows of ``columns``, each ``tile_width`` pixels wide.

    All get the proportions of the first.
    """
    height = fitted(images[0], tile_width).shape[0]
    tiles = [Tile(touch.resized(image, tile_width, height)) for image in images]
    return sheet(tiles, min(columns, len(images)), gap_px=_GAP, margin_px=_GAP)


def round_html(title: str, words: Sequence[str], pictures: Sequence[tuple[str, Callable[[], UInt8]]]) -> str:
    """Return a notebook's view of a round: a caption, which counts damaged pictures, and the others."""
    tiles = []
    for caption, read in pictures:
        with suppress(errors.IntegrityError):
            tiles.append(touch_html(read(), caption))
    if len(tiles) < len(pictures):
        words = [*words, f"{len(pictures) - len(tiles)} of {len(pictures)} pictures cannot be shown"]
    grid = f'<div style="display:flex;flex-wrap:wrap;gap:{_GAP}px">{"".join(tiles)}</div>'
    return f"<div><b>{html.escape(title)}</b>: {', '.join(words)}{grid}</div>"


def touch_html(picture: UInt8, caption: str) -> str:
    """Return a notebook's view of a touch: its picture and a caption."""
    return figure_html(fitted(picture, _TILE_WIDTH), caption, TILE_STYLE)
