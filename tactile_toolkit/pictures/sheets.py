"""Sheets: pictures side by side with words about them, in one style for all rooms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.pictures.lettering import INK, MUTED, PAPER, Colour, draw_text, text_size

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw

__all__ = ["ScaleBar", "Sheet", "Tile", "in_rows", "sheet", "with_scale_bar"]

TITLE_PX, TEXT_PX, CAPTION_PX = 22, 16, 14

_MARGIN_PX = 16
_LINE_GAP_PX = 4
_FRAME_PX = 3
_BAR_PX = 5
_HALO_PX = 2
_NICE_LENGTHS_MM = tuple(base * 10.0**power for power in range(-3, 4) for base in (1, 2, 5))


@dataclass(frozen=True, slots=True, eq=False)
class Tile:
    """A picture on a sheet.

    Attributes
    ----------
    pixels : ndarray of uint8, shape (H, W) or (H, W, 3)
        The picture.
    caption : str
        Words below it.
    frame : tuple of int, optional
        Colour of a frame around it.
    """

    pixels: NDArray[np.uint8]
    caption: str = ""
    frame: Colour | None = None


@dataclass(frozen=True, slots=True)
class Sheet:
    """How a sheet is laid out.

    Attributes
    ----------
    columns : int
        Pictures in a row.
    title : str
        Heading.
    lines : tuple of str
        Words below the heading.
    footer : tuple of str
        Words at the foot.
    row_labels : tuple of str
        Words to the left of each row.
    gap_px : int
        Between pictures.
    margin_px : int
        Around all.
    """

    columns: int
    title: str = ""
    lines: tuple[str, ...] = ()
    footer: tuple[str, ...] = ()
    row_labels: tuple[str, ...] = ()
    gap_px: int = 8
    margin_px: int = _MARGIN_PX


def sheet(tiles: Sequence[Tile | None], layout: Sheet) -> NDArray[np.uint8]:
    """Lay pictures out in rows of cells of one size, each picture in the middle of its cell.

    Parameters
    ----------
    tiles : sequence of Tile or None
        Pictures row by row; None leaves a cell empty.
    layout : Sheet
        How.

    Returns
    -------
    ndarray of uint8, shape (H, W, 3)
    """
    from PIL import Image, ImageDraw

    shown = [tile for tile in tiles if tile is not None]
    grid = _grid(shown, min(layout.columns, max(len(tiles), 1)), len(tiles), layout)
    picture = Image.new("RGB", grid.size_px, PAPER)
    pen = ImageDraw.Draw(picture)
    _write_head(pen, layout)
    for place, tile in enumerate(tiles):
        if tile is not None:
            _put(picture, pen, tile, grid.cell(place), grid.cell_px)
    for row, label in enumerate(layout.row_labels):
        left, top = grid.cell(row * grid.columns)
        middle = (left - layout.gap_px - 4, top + grid.cell_px[1] // 2)
        draw_text(pen, middle, label, TEXT_PX, anchor="rm")
    foot_px = grid.size_px[1] - layout.margin_px - _lines_px(layout.footer)
    _write_lines(pen, layout.footer, (layout.margin_px, foot_px), MUTED)
    return np.asarray(picture)


def in_rows(
    groups: Sequence[tuple[str, Sequence[Tile]]], most: int
) -> tuple[int, list[Tile | None], tuple[str, ...]]:
    """Begin a row for each group of pictures.

    Parameters
    ----------
    groups : sequence of (str, sequence of Tile)
        Name and pictures of each.
    most : int
        Most pictures in a row; a larger group takes several rows.

    Returns
    -------
    columns : int
        Pictures in a row.
    tiles : list of Tile or None
        For :func:`sheet`.
    row_labels : tuple of str
        The name at the first row of each group.
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
    """A bar of known length.

    Attributes
    ----------
    length_mm : float
        What it stands for.
    length_px : int
        How long it is drawn.
    """

    length_mm: float
    length_px: int

    @classmethod
    def fitting(cls, width_px: int, px_per_mm: float) -> ScaleBar:
        """Take the longest round length that fills at most a quarter of a picture's width."""
        fitting = [mm for mm in _NICE_LENGTHS_MM if mm * px_per_mm <= width_px / 4]
        length_mm = fitting[-1] if fitting else _NICE_LENGTHS_MM[0]
        return cls(length_mm, max(1, round(length_mm * px_per_mm)))

    @property
    def label(self) -> str:
        """Its length in words."""
        return f"{self.length_mm:g} mm"


def with_scale_bar(
    pixels: NDArray[np.uint8], px_per_mm: float, bar: ScaleBar | None = None
) -> NDArray[np.uint8]:
    """Return a picture with a scale bar in its lower left corner.

    Parameters
    ----------
    pixels : ndarray of uint8, shape (H, W) or (H, W, 3)
        The picture.
    px_per_mm : float
        Its scale.
    bar : ScaleBar, optional
        The bar; one that fits by default.

    Returns
    -------
    ndarray of uint8, shape (H, W, 3)
    """
    from PIL import Image, ImageDraw

    picture = Image.fromarray(pixels).convert("RGB")
    bar = bar or ScaleBar.fitting(picture.width, px_per_mm)
    pen = ImageDraw.Draw(picture)
    left, top = 10, picture.height - 10 - _BAR_PX
    # A halo keeps the bar readable on whatever lies below it.
    box = (left, top, left + bar.length_px - 1, top + _BAR_PX - 1)
    halo = (box[0] - _HALO_PX, box[1] - _HALO_PX, box[2] + _HALO_PX, box[3] + _HALO_PX)
    pen.rectangle(halo, fill=PAPER)
    pen.rectangle(box, fill=INK)
    draw_text(pen, (left, top - 6), bar.label, CAPTION_PX, anchor="ls", halo_px=_HALO_PX)
    return np.asarray(picture)


@dataclass(frozen=True, slots=True)
class _Grid:
    columns: int
    first_px: tuple[int, int]
    cell_px: tuple[int, int]
    step_px: tuple[int, int]
    size_px: tuple[int, int]

    def cell(self, place: int) -> tuple[int, int]:
        row, column = divmod(place, self.columns)
        return self.first_px[0] + column * self.step_px[0], self.first_px[1] + row * self.step_px[1]


def _grid(tiles: Sequence[Tile], columns: int, count: int, layout: Sheet) -> _Grid:
    frame_px = 2 * _FRAME_PX if any(tile.frame for tile in tiles) else 0
    cell_px = (
        max((tile.pixels.shape[1] for tile in tiles), default=1) + frame_px,
        max((tile.pixels.shape[0] for tile in tiles), default=1) + frame_px,
    )
    captioned = any(tile.caption for tile in tiles)
    caption_px = _LINE_GAP_PX + text_size("0", CAPTION_PX)[1] if captioned else 0
    label_px = max((round(text_size(label, TEXT_PX)[0]) for label in layout.row_labels), default=0)
    gap, margin = layout.gap_px, layout.margin_px
    first_px = (margin + (label_px + gap + 4 if label_px else 0), margin + _head_px(layout))
    step_px = (cell_px[0] + gap, cell_px[1] + caption_px + gap)
    rows = -(-count // columns)
    width_px = max(first_px[0] + columns * step_px[0] - gap, _words_px(layout) + margin) + margin
    foot_px = gap + _lines_px(layout.footer) if layout.footer else 0
    height_px = first_px[1] + rows * step_px[1] - gap + foot_px + margin
    return _Grid(columns, first_px, cell_px, step_px, (width_px, height_px))


def _words_px(layout: Sheet) -> int:
    widths = [text_size(line, TEXT_PX)[0] for line in (*layout.lines, *layout.footer)]
    return round(max([*widths, text_size(layout.title, TITLE_PX)[0] if layout.title else 0]))


def _head_px(layout: Sheet) -> int:
    title_px = text_size(layout.title, TITLE_PX)[1] + _LINE_GAP_PX if layout.title else 0
    words_px = title_px + _lines_px(layout.lines)
    return words_px + layout.gap_px if words_px else 0


def _lines_px(lines: Sequence[str]) -> int:
    return len(lines) * (text_size("0", TEXT_PX)[1] + _LINE_GAP_PX)


def _write_head(pen: ImageDraw, layout: Sheet) -> None:
    top = layout.margin_px
    if layout.title:
        draw_text(pen, (layout.margin_px, top), layout.title, TITLE_PX)
        top += text_size(layout.title, TITLE_PX)[1] + _LINE_GAP_PX
    _write_lines(pen, layout.lines, (layout.margin_px, top), MUTED)


def _write_lines(pen: ImageDraw, lines: Sequence[str], place_px: tuple[int, int], colour: Colour) -> None:
    left, top = place_px
    for line in lines:
        draw_text(pen, (left, top), line, TEXT_PX, colour)
        top += text_size(line, TEXT_PX)[1] + _LINE_GAP_PX


def _put(
    picture: Image, pen: ImageDraw, tile: Tile, corner_px: tuple[int, int], cell_px: tuple[int, int]
) -> None:
    from PIL import Image

    height, width = tile.pixels.shape[:2]
    left, top = corner_px[0] + (cell_px[0] - width) // 2, corner_px[1] + (cell_px[1] - height) // 2
    if tile.frame is not None:
        edge = (left - _FRAME_PX, top - _FRAME_PX, left + width + _FRAME_PX - 1, top + height + _FRAME_PX - 1)
        pen.rectangle(edge, outline=tile.frame, width=_FRAME_PX)
    picture.paste(Image.fromarray(tile.pixels).convert("RGB"), (left, top))
    if tile.caption:
        middle = (corner_px[0] + cell_px[0] / 2, corner_px[1] + cell_px[1] + _LINE_GAP_PX)
        draw_text(pen, middle, tile.caption, CAPTION_PX, MUTED, anchor="ma")
