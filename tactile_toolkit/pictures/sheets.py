"""Pictures of records: sheets with text and scale bars, equal on all machines, and views in notebooks."""

from __future__ import annotations

import base64
import html
import io
import unicodedata
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from itertools import groupby
from typing import TypeAlias

import numpy as np
from PIL import Image, ImageDraw, ImageFont, ImageOps

from tactile_toolkit import read, touch
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.value_types import UInt8

Colour: TypeAlias = tuple[int, int, int]
INK: Colour = (32, 36, 42)
MUTED: Colour = (98, 106, 116)
PAPER: Colour = (255, 255, 255)

_TITLE_PX, _TEXT_PX, _CAPTION_PX = 20, 14, 12
_LINE_GAP_PX = 4
_LABEL_GAP_PX = 12
_FRAME_PX = 3
_BAR_PX = 5
_HALO_PX = 2
_NICE_LENGTHS_MM = tuple(base * 10.0**power for power in range(-3, 4) for base in (1, 2, 5))

# Shipped with its licence. It has Latin, Greek, Cyrillic, Arabic and symbols; other characters become its box
# for missing glyphs.
_FONT_FILE = "DejaVuSans.ttf"

# Width of the picture of a record in a notebook, alone and among others.
_VIEW_PX = 300
_TILE_PX = 120
_TILE_STYLE = "margin:0;text-align:center;font-size:smaller"


@dataclass(frozen=True, slots=True, eq=False)
class Tile:
    """A picture on a sheet, (H, W) or (H, W, 3), with a caption below and a frame.

    Tiles of one group follow one another; its name is left of its first row.
    """

    pixels: UInt8
    caption: str = ""
    frame: Colour | None = None
    group: str = ""

    def with_scale_bar(self, px_per_mm: float) -> Tile:
        """Add a scale bar in the lower left corner, at most a quarter of the width."""
        return replace(self, pixels=_with_scale_bar(self.pixels, px_per_mm))


class Pen(ImageDraw.ImageDraw):
    """Draws on a picture of Pillow; its text has equal pixels on all machines."""

    def write(
        self,
        at_px: tuple[float, float],
        text: str,
        size_px: int,
        colour: Colour = INK,
        anchor: str = "la",
        halo_px: int = 0,
    ) -> None:
        """Write a line at a column and row; ``anchor`` is an anchor of Pillow.

        ``halo_px`` is the width of an outline in the colour of the paper.
        """
        text = _one_line(text)
        font = _font(size_px)
        if halo_px:
            self.text(at_px, text, PAPER, font, anchor, stroke_width=halo_px, stroke_fill=PAPER)
        self.text(at_px, text, colour, font, anchor)

    @staticmethod
    def text_size(text: str, size_px: int) -> tuple[float, int]:
        """Return the width and height of a line, pixels."""
        return _font(size_px).getlength(_one_line(text)), round(size_px * 1.3)


def sheet(
    tiles: Sequence[Tile],
    columns: int,
    title: str = "",
    lines: Sequence[str] = (),
    *,
    px_per_mm: float | None = None,
    gap_px: int = 8,
    margin_px: int = 16,
) -> UInt8:
    """Arrange pictures row by row in cells of equal size, each centred in its cell.

    Title and lines are above them. Each group starts a row of at most ``columns`` pictures. ``px_per_mm``
    adds a scale bar below. Returns colours of shape (H, W, 3).
    """
    cells, labels, columns = _in_rows(tiles, columns)
    frame_px = 0
    if any(tile.frame for tile in tiles):
        frame_px = 2 * _FRAME_PX
    cell_height = max((tile.pixels.shape[0] for tile in tiles), default=1) + frame_px
    cell_width = max((tile.pixels.shape[1] for tile in tiles), default=1) + frame_px
    row_step = cell_height + gap_px
    if any(tile.caption for tile in tiles):
        row_step += _line_px(_CAPTION_PX)
    label_px = max((round(Pen.text_size(label, _TEXT_PX)[0]) for label in labels), default=0)
    heading = [(title, _TITLE_PX, INK)] * bool(title) + [(line, _TEXT_PX, MUTED) for line in lines]
    left_px = top_px = margin_px
    if label_px:
        left_px += label_px + _LABEL_GAP_PX
    if heading:
        top_px += sum(_line_px(size_px) for _, size_px, _ in heading) + gap_px
    words_px = max((round(Pen.text_size(text, size_px)[0]) for text, size_px, _ in heading), default=0)
    width = max(left_px + columns * (cell_width + gap_px) - gap_px, words_px + margin_px) + margin_px
    height = top_px + len(labels) * row_step - gap_px + margin_px
    if px_per_mm is not None:
        height += gap_px + _line_px(_TEXT_PX)
    picture = Image.new("RGB", (width, height), PAPER)
    pen = Pen(picture)
    y_px = margin_px
    for text, size_px, colour in heading:
        pen.write((margin_px, y_px), text, size_px, colour)
        y_px += _line_px(size_px)
    for row, label in enumerate(labels):
        middle = (left_px - _LABEL_GAP_PX, top_px + row * row_step + cell_height // 2)
        pen.write(middle, label, _TEXT_PX, anchor="rm")
    for tile, row, column in cells:
        image = Image.fromarray(tile.pixels).convert("RGB")
        if tile.frame is not None:
            image = ImageOps.expand(image, _FRAME_PX, tile.frame)
        x = left_px + column * (cell_width + gap_px)
        y = top_px + row * row_step
        picture.paste(image, (x + (cell_width - image.width) // 2, y + (cell_height - image.height) // 2))
        below = (x + cell_width / 2, y + cell_height + _LINE_GAP_PX)
        pen.write(below, tile.caption, _CAPTION_PX, MUTED, anchor="ma")
    if px_per_mm is None:
        return np.asarray(picture)
    length_mm = bar_length_mm(min(cell_width, width // 4), px_per_mm)  # not longer than a tile
    return _with_scale_bar(np.asarray(picture), px_per_mm, length_mm)


def _in_rows(tiles: Sequence[Tile], most: int) -> tuple[list[tuple[Tile, int, int]], list[str], int]:
    """Return the tiles with their row and column, the label of each row, and the number of columns."""
    cells: list[tuple[Tile, int, int]] = []
    labels: list[str] = []
    for name, members in groupby(tiles, key=lambda tile: tile.group):
        for number, tile in enumerate(members):
            if number % most == 0:
                labels.append("" if number else name)
            cells.append((tile, len(labels) - 1, number % most))
    columns = max((column + 1 for _, _, column in cells), default=1)
    return cells, labels or [""], columns


def _line_px(size_px: int) -> int:
    return Pen.text_size("", size_px)[1] + _LINE_GAP_PX


def fitted(pixels: UInt8, width_px: float) -> UInt8:
    """Return an image, (H, W, 3), at another width, its proportions kept."""
    width = max(1, round(width_px))
    return touch.resized(pixels, width, max(1, round(width * pixels.shape[0] / pixels.shape[1])))


def bar_length_mm(most_px: float, px_per_mm: float) -> float:
    """Return the largest round length of at most this many pixels."""
    fitting = (mm for mm in _NICE_LENGTHS_MM if mm * px_per_mm <= most_px)
    return max(fitting, default=_NICE_LENGTHS_MM[0])


def _with_scale_bar(pixels: UInt8, px_per_mm: float, length_mm: float | None = None) -> UInt8:
    """Add a scale bar to a picture, (H, W, 3), in its lower left corner.

    It is at most a quarter of the width by default.
    """
    picture = Image.fromarray(pixels).convert("RGB")
    length_mm = length_mm or bar_length_mm(picture.width // 4, px_per_mm)
    pen = Pen(picture)
    left = 10
    top = picture.height - 10 - _BAR_PX
    right = left + max(1, round(length_mm * px_per_mm)) - 1
    bottom = top + _BAR_PX - 1
    # A halo keeps the bar readable on any background.
    pen.rectangle((left - _HALO_PX, top - _HALO_PX, right + _HALO_PX, bottom + _HALO_PX), fill=PAPER)
    pen.rectangle((left, top, right, bottom), fill=INK)
    pen.write((left, top - 6), f"{length_mm:g} mm", _CAPTION_PX, anchor="ls", halo_px=_HALO_PX)
    return np.asarray(picture)


def _one_line(text: str) -> str:
    # Pillow places letters one by one, so accents must be composed. It breaks lines at control characters,
    # and fails on lone surrogates, which file names that are not UTF-8 have.
    joined = unicodedata.normalize("NFC", text)
    return "".join(letter if letter.isprintable() else "?" for letter in joined)


@cache
def _font(size_px: int) -> ImageFont.FreeTypeFont:
    content = resources.files("tactile_toolkit.pictures").joinpath(_FONT_FILE).read_bytes()
    # Basic layout, because the other one needs libraqm and spaces letters differently.
    return ImageFont.truetype(io.BytesIO(content), size_px, layout_engine=ImageFont.Layout.BASIC)


class Drawn(read.FieldAccess, ABC):
    """Base class of records that draw themselves; views, sheets, cards and galleries follow from it."""

    __slots__ = ()

    @abstractmethod
    def caption(self, label_names: Sequence[str] = ()) -> str:
        """Return what the record shows, in a few words; ``label_names`` are the names of the classes."""

    @property
    def tile_caption(self) -> str:
        """Text below a small picture among others."""
        return self.caption()

    @property
    def details(self) -> str:
        """Text below a large picture."""
        return self.caption()

    @abstractmethod
    def picture(self, width_px: float) -> UInt8:
        """Draw the record, (H, W) or (H, W, 3); the longer side of what it shows is ``width_px`` long."""

    def _repr_html_(self) -> str:
        """Show the record in a notebook."""
        return figure_html(self.picture(_VIEW_PX), self.details)

    def tile_html(self) -> str:
        """Return HTML of a small picture with a caption, for notebooks."""
        return figure_html(self.picture(_TILE_PX), self.tile_caption, small=True)

    @staticmethod
    def grid_html(
        title: str, words: Sequence[str], pictures: Sequence[tuple[str, Callable[[], UInt8]]]
    ) -> str:
        """Return HTML for notebooks of small pictures with captions; damaged ones are counted."""
        tiles = []
        for caption, draw in pictures:
            with suppress(IntegrityError):
                tiles.append(figure_html(fitted(draw(), _TILE_PX), caption, small=True))
        if len(tiles) < len(pictures):
            words = [*words, f"{len(pictures) - len(tiles)} of {len(pictures)} pictures cannot be shown"]
        grid = f'<div style="display:flex;flex-wrap:wrap;gap:4px">{"".join(tiles)}</div>'
        return f"<div><b>{html.escape(title)}</b>: {', '.join(words)}{grid}</div>"


def figure_html(pixels: UInt8, caption: str, *, small: bool = False) -> str:
    """Return HTML for notebooks of a picture and its caption, which is plain text."""
    source = base64.b64encode(touch.encode_image(pixels, "png")).decode("ascii")
    style = ""
    if small:
        style = f' style="{_TILE_STYLE}"'
    return (
        f'<figure{style}><img src="data:image/png;base64,{source}">'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
    )
