"""Pictures of touches side by side: contact sheets, and what notebooks show of rounds and touches."""

from __future__ import annotations

import html
from collections.abc import Sequence

import numpy as np

from tactile_toolkit.pictures.sheets import Sheet, Tile, sheet
from tactile_toolkit.pictures.writing import TILE_STYLE, figure_html
from tactile_toolkit.touch.jpeg import Pixels, resized

MOST_TILES = 32
"""Touches that a notebook shows of a round."""

_TILE_WIDTH = 120
_GAP = 4


def evenly_spaced(count: int, most: int) -> list[int]:
    """Choose up to ``most`` of ``count`` indices, first and last among them."""
    indices: list[int] = np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int)).tolist()
    return indices


def fitted(image: Pixels, width: int) -> Pixels:
    """Return an image, (H, W, 3), at another width in pixels, its proportions kept."""
    return resized(image, width, max(1, round(width * image.shape[0] / image.shape[1])))


def contact_sheet(images: Sequence[Pixels], columns: int = 8, tile_width: int = _TILE_WIDTH) -> Pixels:
    """Lay RGB images, (H, W, 3), out in rows of ``columns``, each ``tile_width`` pixels wide.

    All get the proportions of the first.
    """
    height = fitted(images[0], tile_width).shape[0]
    tiles = [Tile(resized(image, tile_width, height)) for image in images]
    return sheet(tiles, Sheet(min(columns, len(images)), gap_px=_GAP, margin_px=_GAP))


def round_html(title: str, words: Sequence[str], pictures: Sequence[tuple[str, Pixels | None]]) -> str:
    """Return a notebook's view of a round: a caption and a grid of captioned pictures.

    Pictures that cannot be read are None: the caption counts them.
    """
    tiles = "".join(touch_html(picture, caption) for caption, picture in pictures if picture is not None)
    missing = sum(picture is None for _, picture in pictures)
    unshown = [f"{missing} of {len(pictures)} pictures cannot be shown"] if missing else []
    caption = f"<b>{html.escape(title)}</b>: {', '.join([*words, *unshown])}"
    return f'<div>{caption}<div style="display:flex;flex-wrap:wrap;gap:{_GAP}px">{tiles}</div></div>'


def touch_html(picture: Pixels, caption: str) -> str:
    """Return a notebook's view of a touch: its picture and what it is."""
    return figure_html(fitted(picture, _TILE_WIDTH), caption, TILE_STYLE)
