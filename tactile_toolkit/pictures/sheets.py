"""Sheets of pictures, with text and scale bars."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageOps

from tactile_toolkit.array_types import UInt8
from tactile_toolkit.pictures.lettering import (
    CAPTION_PX,
    INK,
    MUTED,
    PAPER,
    TEXT_PX,
    TITLE_PX,
    Colour,
    draw_text,
    text_size,
)

_LINE_GAP_PX = 4
_FRAME_PX = 3
_BAR_PX = 5
_HALO_PX = 2
_NICE_LENGTHS_MM = tuple(base * 10.0**power for power in range(-3, 4) for base in (1, 2, 5))


@dataclass(frozen=True, slots=True, eq=False)
class Tile:
    """A picture on a sheet, (H, W) or (H, W, 3), with a caption below and a frame."""

    pixels: UInt8
    caption: str = ""
    frame: Colour | None = None


def sheet(
    tiles: Sequence[Tile | None],
    columns: int,
    title: str = "",
    lines: Sequence[str] = (),
    row_labels: Sequence[str] = (),
    *,
    gap_px: int = 8,
    margin_px: int = 16,
    bar_room: bool = False,
) -> UInt8:
    """Arrange pictures row by row in cells of equal size, each centred in its cell; None is an empty cell.

    Title and lines are above them, labels left of each row; ``bar_room`` leaves room for a scale bar below.
    Returns colours of shape (H, W, 3).
    """
    columns = min(columns, max(len(tiles), 1))
    rows = -(-len(tiles) // columns)
    shown = [tile for tile in tiles if tile is not None]
    frame_px = 0
    if any(tile.frame for tile in shown):
        frame_px = 2 * _FRAME_PX
    cell_height = max((tile.pixels.shape[0] for tile in shown), default=1) + frame_px
    cell_width = max((tile.pixels.shape[1] for tile in shown), default=1) + frame_px
    row_step = cell_height + gap_px
    if any(tile.caption for tile in shown):
        row_step += _line_px(CAPTION_PX)
    label_px = max((round(text_size(label, TEXT_PX)[0]) for label in row_labels), default=0)
    head_px = _line_px(TEXT_PX) * len(lines)
    if title:
        head_px += _line_px(TITLE_PX)
    left_px = top_px = margin_px
    if label_px:
        left_px += label_px + gap_px + 4
    if head_px:
        top_px += head_px + gap_px
    words_px = max([text_size(line, TEXT_PX)[0] for line in lines] + [text_size(title, TITLE_PX)[0]])
    width = max(left_px + columns * (cell_width + gap_px) - gap_px, round(words_px) + margin_px) + margin_px
    height = top_px + rows * row_step - gap_px + margin_px
    if bar_room:
        height += gap_px + _line_px(TEXT_PX)
    picture = Image.new("RGB", (width, height), PAPER)
    pen = ImageDraw.Draw(picture)
    _draw_heading(pen, title, lines, margin_px)
    for row, label in enumerate(row_labels):
        middle = (left_px - gap_px - 4, top_px + row * row_step + cell_height // 2)
        draw_text(pen, middle, label, TEXT_PX, anchor="rm")
    for index, tile in enumerate(tiles):
        if tile is None:
            continue
        row, column = divmod(index, columns)
        cell_x, cell_y = left_px + column * (cell_width + gap_px), top_px + row * row_step
        image = _framed(tile)
        x, y = cell_x + (cell_width - image.width) // 2, cell_y + (cell_height - image.height) // 2
        picture.paste(image, (x, y))
        below = (cell_x + cell_width / 2, cell_y + cell_height + _LINE_GAP_PX)
        draw_text(pen, below, tile.caption, CAPTION_PX, MUTED, anchor="ma")
    return np.asarray(picture)


def _draw_heading(pen: ImageDraw.ImageDraw, title: str, lines: Sequence[str], margin_px: int) -> None:
    y_px = margin_px
    if title:
        draw_text(pen, (margin_px, y_px), title, TITLE_PX)
        y_px += _line_px(TITLE_PX)
    for line in lines:
        draw_text(pen, (margin_px, y_px), line, TEXT_PX, MUTED)
        y_px += _line_px(TEXT_PX)


def _framed(tile: Tile) -> Image.Image:
    """Return the picture of a tile with its frame."""
    image = Image.fromarray(tile.pixels).convert("RGB")
    if tile.frame is not None:
        image = ImageOps.expand(image, _FRAME_PX, tile.frame)
    return image


def _line_px(size_px: int) -> int:
    return text_size("", size_px)[1] + _LINE_GAP_PX


def in_rows(
    groups: Sequence[tuple[str, Sequence[Tile]]], most: int
) -> tuple[int, list[Tile | None], tuple[str, ...]]:
    """Arrange named groups in rows of at most ``most`` pictures; each group starts a row.

    Returns the number of columns, the tiles for :func:`sheet`, and a label for each row: the name of the
    group at its first row.
    """
    columns = min(most, max(len(tiles) for _, tiles in groups))
    cells: list[Tile | None] = []
    labels: list[str] = []
    for name, tiles in groups:
        cells += [*tiles, *[None] * (-len(tiles) % columns)]
        labels += [name, *[""] * (len(cells) // columns - len(labels) - 1)]
    return columns, cells, tuple(labels)


def bar_length_mm(width_px: int, px_per_mm: float) -> float:
    """Return the largest round length of at most a quarter of the width of a picture."""
    fitting = (mm for mm in _NICE_LENGTHS_MM if mm * px_per_mm <= width_px / 4)
    return max(fitting, default=_NICE_LENGTHS_MM[0])


def with_scale_bar(pixels: UInt8, px_per_mm: float, length_mm: float | None = None) -> UInt8:
    """Add a scale bar to a picture, (H, W, 3), in its lower left corner; of a fitting length by default."""
    picture = Image.fromarray(pixels).convert("RGB")
    length_mm = length_mm or bar_length_mm(picture.width, px_per_mm)
    pen = ImageDraw.Draw(picture)
    left, top = 10, picture.height - 10 - _BAR_PX
    right, bottom = left + max(1, round(length_mm * px_per_mm)) - 1, top + _BAR_PX - 1
    # A halo keeps the bar readable on any background.
    pen.rectangle((left - _HALO_PX, top - _HALO_PX, right + _HALO_PX, bottom + _HALO_PX), fill=PAPER)
    pen.rectangle((left, top, right, bottom), fill=INK)
    draw_text(pen, (left, top - 6), f"{length_mm:g} mm", CAPTION_PX, anchor="ls", halo_px=_HALO_PX)
    return np.asarray(picture)
