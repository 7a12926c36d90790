"""Text in pictures: one font and one palette, with equal pixels on all machines."""

from __future__ import annotations

import io
import unicodedata
from functools import cache
from importlib import resources
from typing import TypeAlias

from PIL import ImageDraw, ImageFont

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

# Shipped with its licence. It has Latin, Greek, Cyrillic, Arabic and symbols; other characters become its box
# for missing glyphs.
_FONT_FILE = "DejaVuSans.ttf"


def draw_text(
    pen: ImageDraw.ImageDraw,
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
    text, font = _one_line(text), _font(size_px)
    if halo_px:
        pen.text(at_px, text, PAPER, font, anchor, stroke_width=halo_px, stroke_fill=PAPER)
    pen.text(at_px, text, colour, font, anchor)


def text_size(text: str, size_px: int) -> tuple[float, int]:
    """Return the width and height of a line, pixels."""
    return _font(size_px).getlength(_one_line(text)), round(size_px * 1.3)


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
