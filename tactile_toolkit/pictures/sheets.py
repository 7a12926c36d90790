"""Sheets: pictures side by side with words about them, in one style for all kinds of data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.pictures.lettering import INK, MUTED, PAPER, Colour, draw_text, text_size

TITLE_PX, TEXT_PX, CAPTION_PX = 20, 14, 12

_LINE_GAP_PX = 4
_FRAME_PX = 3
_BAR_PX = 5
_HALO_PX = 2
_NICE_LENGTHS_MM = tuple(base * 10.0**power for power in range(-3, 4) for base in (1, 2, 5))


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


@dataclass(frozen=True, slots=True)
class ScaleBar:
    """A bar: the length that it stands for, and how long it is drawn."""

    length_mm: float
    length_px: int

    @classmethod
    def fitting(cls, width_px: int, px_per_mm: float) -> ScaleBar:
        """Take the longest round length that fills at most a quarter of a picture's width."""
        fitting = [mm for mm in _NICE_LENGTHS_MM if mm * px_per_mm <= width_px / 4]
        length_mm = fitting[-1] if fitting else _NICE_LENGTHS_MM[0]
        return cls(length_mm, max(1, round(length_mm * px_per_mm)))


def with_scale_bar(
    pixels: NDArray[np.uint8], px_per_mm: float, bar: ScaleBar | None = None
) -> NDArray[np.uint8]:
    """Return a picture, (H, W, 3), with a scale bar in its lower left corner; one that fits by default."""
    from PIL import Image, ImageDraw

    picture = Image.fromarray(pixels).convert("RGB")
    bar = bar or ScaleBar.fitting(picture.width, px_per_mm)
    pen = ImageDraw.Draw(picture)
    left, top = 10, picture.height - 10 - _BAR_PX
    right, bottom = left + bar.length_px - 1, top + _BAR_PX - 1
    # A halo keeps the bar readable on whatever lies below it.
    pen.rectangle((left - _HALO_PX, top - _HALO_PX, right + _HALO_PX, bottom + _HALO_PX), fill=PAPER)
    pen.rectangle((left, top, right, bottom), fill=INK)
    draw_text(pen, (left, top - 6), f"{bar.length_mm:g} mm", CAPTION_PX, anchor="ls", halo_px=_HALO_PX)
    return np.asarray(picture)
