"""Sheets: pictures side by side with words about them, in one font and one palette for all kinds of data."""

from __future__ import annotations

import io
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont


Colour: TypeAlias = tuple[int, int, int]

INK: Colour = (32, 36, 42)
MUTED: Colour = (98, 106, 116)
PAPER: Colour = (255, 255, 255)
ACCENTS: tuple[Colour, ...] = (
    (0, 114, 178),
    (230, 159, 0),
    (0, 158, 115),
    (213, 94, 0),
    (204, 121, 167),
    (86, 180, 233),
)
"""Colours that people with any kind of colour vision distinguish (Okabe and Ito 2008)."""

TITLE_PX, TEXT_PX, CAPTION_PX = 20, 14, 12

_LINE_GAP_PX = 4
_FRAME_PX = 3
_BAR_PX = 5
_HALO_PX = 2
_NICE_LENGTHS_MM = tuple(base * 10.0**power for power in range(-3, 4) for base in (1, 2, 5))
# Shipped with its licence: every machine writes the same letters. It has Latin, Greek, Cyrillic, Arabic and
# signs; anything else becomes its box for "no such letter".
_FONT_FILE = "DejaVuSans.ttf"


def draw_text(
    pen: ImageDraw,
    at_px: tuple[float, float],
    text: str,
    size_px: int,
    colour: Colour = INK,
    anchor: str = "la",
    halo_px: int = 0,
) -> None:
    """Write a line at a column and row, which ``anchor`` ties to the text as Pillow's anchors do.

    ``halo_px`` is the width of a rim of paper around the letters.
    """
    text, font = _one_line(text), _font(size_px)
    if halo_px:
        pen.text(at_px, text, PAPER, font, anchor, stroke_width=halo_px, stroke_fill=PAPER)
    pen.text(at_px, text, colour, font, anchor)


def text_size(text: str, size_px: int) -> tuple[float, int]:
    """Return the width and height of a line, pixels."""
    return _font(size_px).getlength(_one_line(text)), round(size_px * 1.3)


def _one_line(text: str) -> str:
    # Pillow places letter after letter, so accents must be joined to theirs; it breaks lines at control
    # characters, and fails on the lone surrogates of file names that are not UTF-8.
    joined = unicodedata.normalize("NFC", text)
    return "".join(letter if letter.isprintable() else "?" for letter in joined)


@cache
def _font(size_px: int) -> FreeTypeFont:
    from PIL import ImageFont

    content = resources.files("tactile_toolkit.pictures").joinpath(_FONT_FILE).read_bytes()
    # Basic layout, because the other one is only there where libraqm is, and spaces letters differently.
    return ImageFont.truetype(io.BytesIO(content), size_px, layout_engine=ImageFont.Layout.BASIC)


@dataclass(frozen=True, slots=True, eq=False)
class Tile:
    """A picture on a sheet, (H, W) or (H, W, 3), with words below it and a frame around it."""

    pixels: NDArray[np.uint8]
    caption: str = ""
    frame: Colour | None = None


@dataclass(frozen=True, slots=True)
class Sheet:
    """How a sheet is laid out: heading and lines above, labels left of each row, lines at the foot."""

    columns: int
    title: str = ""
    lines: tuple[str, ...] = ()
    footer: tuple[str, ...] = ()
    row_labels: tuple[str, ...] = ()
    gap_px: int = 8
    margin_px: int = 16


def sheet(tiles: Sequence[Tile | None], layout: Sheet) -> NDArray[np.uint8]:
    """Lay pictures out row by row in cells of one size, each in the middle of its cell; None is empty.

    Returns colours of shape (H, W, 3).
    """
    from PIL import Image, ImageDraw, ImageOps

    gap, margin = layout.gap_px, layout.margin_px
    columns = min(layout.columns, max(len(tiles), 1))
    rows = -(-len(tiles) // columns)
    shown = [tile for tile in tiles if tile is not None]
    frame_px = 2 * _FRAME_PX if any(tile.frame for tile in shown) else 0
    cell_height = max((tile.pixels.shape[0] for tile in shown), default=1) + frame_px
    cell_width = max((tile.pixels.shape[1] for tile in shown), default=1) + frame_px
    captioned = any(tile.caption for tile in shown)
    row_step = cell_height + gap + (_line_px(CAPTION_PX) if captioned else 0)
    label_px = max((round(text_size(label, TEXT_PX)[0]) for label in layout.row_labels), default=0)
    head_px = (_line_px(TITLE_PX) if layout.title else 0) + _line_px(TEXT_PX) * len(layout.lines)
    left_px = margin + (label_px + gap + 4 if label_px else 0)
    top_px = margin + (head_px + gap if head_px else 0)
    words_px = max(
        [text_size(line, TEXT_PX)[0] for line in (*layout.lines, *layout.footer)]
        + [text_size(layout.title, TITLE_PX)[0]]
    )
    width = max(left_px + columns * (cell_width + gap) - gap, round(words_px) + margin) + margin
    foot_px = top_px + rows * row_step
    foot_height = _line_px(TEXT_PX) * len(layout.footer)
    height = foot_px + (foot_height if layout.footer else -gap) + margin

    picture = Image.new("RGB", (width, height), PAPER)
    pen = ImageDraw.Draw(picture)
    if layout.title:
        draw_text(pen, (margin, margin), layout.title, TITLE_PX)
    for number, line in enumerate(layout.lines):
        y = margin + head_px - _line_px(TEXT_PX) * (len(layout.lines) - number)
        draw_text(pen, (margin, y), line, TEXT_PX, MUTED)
    for number, line in enumerate(layout.footer):
        draw_text(pen, (margin, foot_px + number * _line_px(TEXT_PX)), line, TEXT_PX, MUTED)
    for row, label in enumerate(layout.row_labels):
        middle = (left_px - gap - 4, top_px + row * row_step + cell_height // 2)
        draw_text(pen, middle, label, TEXT_PX, anchor="rm")
    for index, tile in enumerate(tiles):
        if tile is None:
            continue
        row, column = divmod(index, columns)
        cell_x, cell_y = left_px + column * (cell_width + gap), top_px + row * row_step
        image = Image.fromarray(tile.pixels).convert("RGB")
        if tile.frame is not None:
            image = ImageOps.expand(image, _FRAME_PX, tile.frame)
        x, y = cell_x + (cell_width - image.width) // 2, cell_y + (cell_height - image.height) // 2
        picture.paste(image, (x, y))
        below = (cell_x + cell_width / 2, cell_y + cell_height + _LINE_GAP_PX)
        draw_text(pen, below, tile.caption, CAPTION_PX, MUTED, anchor="ma")
    return np.asarray(picture)


def _line_px(size_px: int) -> int:
    return text_size("", size_px)[1] + _LINE_GAP_PX


def in_rows(
    groups: Sequence[tuple[str, Sequence[Tile]]], most: int
) -> tuple[int, list[Tile | None], tuple[str, ...]]:
    """Begin a row of at most ``most`` pictures for each named group; a larger one takes several rows.

    Returns the number of columns, the tiles for :func:`sheet`, and a label of each row: the name at the first
    row of its group.
    """
    columns = min(most, max(len(tiles) for _, tiles in groups))
    cells: list[Tile | None] = []
    labels: list[str] = []
    for name, tiles in groups:
        cells += [*tiles, *[None] * (-len(tiles) % columns)]
        labels += [name, *[""] * (len(cells) // columns - len(labels) - 1)]
    return columns, cells, tuple(labels)


def bar_length_mm(width_px: int, px_per_mm: float) -> float:
    """Return the longest round length that fills at most a quarter of a picture's width."""
    fitting = [mm for mm in _NICE_LENGTHS_MM if mm * px_per_mm <= width_px / 4]
    return fitting[-1] if fitting else _NICE_LENGTHS_MM[0]


def with_scale_bar(
    pixels: NDArray[np.uint8], px_per_mm: float, length_mm: float | None = None
) -> NDArray[np.uint8]:
    """Return a picture, (H, W, 3), with a scale bar in its lower left corner; one that fits by default."""
    from PIL import Image, ImageDraw

    picture = Image.fromarray(pixels).convert("RGB")
    length_mm = length_mm or bar_length_mm(picture.width, px_per_mm)
    pen = ImageDraw.Draw(picture)
    left, top = 10, picture.height - 10 - _BAR_PX
    right, bottom = left + max(1, round(length_mm * px_per_mm)) - 1, top + _BAR_PX - 1
    # A halo keeps the bar readable on whatever lies below it.
    pen.rectangle((left - _HALO_PX, top - _HALO_PX, right + _HALO_PX, bottom + _HALO_PX), fill=PAPER)
    pen.rectangle((left, top, right, bottom), fill=INK)
    draw_text(pen, (left, top - 6), f"{length_mm:g} mm", CAPTION_PX, anchor="ls", halo_px=_HALO_PX)
    return np.asarray(picture)
