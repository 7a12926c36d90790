"""Touches as pictures: contact sheets for notebooks and files."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.pictures.sheets import Sheet, Tile, sheet
from tactile_toolkit.pictures.writing import png_bytes
from tactile_toolkit.touch.jpeg import Pixels, resized

if TYPE_CHECKING:
    from realtouch.rounds import TouchRound
    from realtouch.touches import Touch

__all__ = ["contact_sheet", "round_html", "round_sheet", "touch_html"]

_COLUMNS = 8
_MOST_TILES = 32
_TILE_WIDTH = 120
_GAP = 4


def contact_sheet(images: Sequence[Pixels], columns: int = _COLUMNS, tile_width: int = _TILE_WIDTH) -> Pixels:
    """Lay images out in rows.

    Parameters
    ----------
    images : sequence of ndarray, shapes (H, W, 3), uint8
        RGB.
    columns : int
        Images in a row.
    tile_width : int
        Width of each, pixels; heights keep the proportions of the first.

    Returns
    -------
    ndarray, shape (height, width, 3), uint8
    """
    height, width = images[0].shape[:2]
    tile_height = max(1, round(tile_width * height / width))
    tiles = [Tile(resized(image, tile_width, tile_height)) for image in images]
    return sheet(tiles, Sheet(min(columns, len(images)), gap_px=_GAP, margin_px=_GAP))


def round_sheet(record: TouchRound, most: int = _MOST_TILES) -> Pixels:
    """Show up to ``most`` touches of a round, evenly spaced, as one picture; of clips, the contact frames."""
    return contact_sheet([touch.image for touch in _shown(record, most)])


def round_html(record: TouchRound) -> str:
    """Return a notebook's view of a round: a caption and a grid of touches with their numbers.

    What the data set does not store, and pictures that are damaged, are left out of it.
    """
    figures = [_figure_or_none(touch) for touch in _shown(record, _MOST_TILES)]
    tiles = "".join(figure for figure in figures if figure is not None)
    words = _named(record, label="label", object="object_id")
    words.append(f"{record.touch_count} touches")
    if None in figures:
        words.append(f"{figures.count(None)} of {len(figures)} pictures cannot be shown")
    caption = f"<b>{html.escape(record.shown('id', str) or 'Round')}</b>: {', '.join(words)}"
    return f'<div>{caption}<div style="display:flex;flex-wrap:wrap;gap:{_GAP}px">{tiles}</div></div>'


def touch_html(touch: Touch) -> str:
    """Return a notebook's view of a touch: its picture and where it is from."""
    words = [*_named(touch.round, label="label"), f"touch {touch.touch_index}"]
    with suppress(InputError):  # without positions
        x, y = (1000.0 * float(value) for value in touch.pos_in_cell_m)
        words.append(f"x {x:.1f} mm, y {y:.1f} mm")
    return f"<div>{_figure(touch, ', '.join(words))}</div>"


def _named(record: TouchRound, **fields: str) -> list[str]:
    """Say what the data set stores of some fields, given as word and field."""
    shown = ((word, record.shown(name, str)) for word, name in fields.items())
    return [f"{word} {value}" for word, value in shown if value is not None]


def _shown(record: TouchRound, most: int) -> list[Touch]:
    from realtouch.touches import Touch

    count = record.touch_count
    chosen = np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))
    return [Touch(record, int(touch)) for touch in chosen]


def _figure_or_none(touch: Touch) -> str | None:
    try:
        return _figure(touch, f"{touch.touch_index}")
    except IntegrityError:
        return None


def _figure(touch: Touch, caption: str) -> str:
    picture = touch.image
    tile = resized(picture, _TILE_WIDTH, max(1, round(_TILE_WIDTH * picture.shape[0] / picture.shape[1])))
    source = base64.b64encode(png_bytes(tile)).decode("ascii")
    return (
        f'<figure style="margin:0;text-align:center;font-size:smaller"><img width="{_TILE_WIDTH}" '
        f'src="data:image/png;base64,{source}"><figcaption>{html.escape(caption)}</figcaption></figure>'
    )
