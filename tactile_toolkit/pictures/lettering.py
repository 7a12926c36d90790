"""Words and colours of pictures: one font and one palette for all rooms."""

from __future__ import annotations

import re
import string
import unicodedata
from functools import cache
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont, ImageFont

__all__ = ["ACCENTS", "INK", "MUTED", "PAPER", "Colour", "draw_text", "hex_of", "text_size"]

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
"""Colours that people with any kind of colour vision tell apart (Okabe and Ito 2008)."""

_RAISED = re.compile("([²³])")
_RAISED_PLAIN = {"²": "2", "³": "3"}

_LETTERS = frozenset(
    string.printable[:-5]
    + "©«°±·»“”…™"
    + "\N{ACUTE ACCENT}\N{LEFT SINGLE QUOTATION MARK}\N{RIGHT SINGLE QUOTATION MARK}\N{FRACTION SLASH}"
    + "\N{SINGLE LEFT-POINTING ANGLE QUOTATION MARK}\N{SINGLE RIGHT-POINTING ANGLE QUOTATION MARK}"
)
"""What the built-in font has letters for, the blank included."""

_SPELLED = {
    **{"ß": "ss", "ẞ": "SS", "æ": "ae", "Æ": "AE", "œ": "oe", "Œ": "OE", "þ": "th", "Þ": "Th"},
    **{"ø": "o", "Ø": "O", "đ": "d", "Đ": "D", "ð": "d", "Ð": "D", "ł": "l", "Ł": "L"},
    **{"\N{EN DASH}": "-", "\N{EM DASH}": "-", "\N{MINUS SIGN}": "-", "\N{MULTIPLICATION SIGN}": "x"},
    **{"\N{LATIN SMALL LETTER DOTLESS I}": "i"},
    **{"\N{MICRO SIGN}": "u", "\N{GREEK SMALL LETTER MU}": "u"},
}
"""Letters that are none of the font's with an accent."""


def draw_text(
    pen: ImageDraw,
    place_px: tuple[float, float],
    text: str,
    size_px: int,
    colour: Colour = INK,
    anchor: str = "la",
    halo_px: int = 0,
) -> None:
    """Write a line; ² and ³ are written as raised digits, which the built-in font lacks.

    It lacks letters beyond English too: they lose their accents, or are written as question marks.

    Parameters
    ----------
    pen : PIL.ImageDraw.ImageDraw
        Where.
    place_px : tuple of float
        Column and row.
    text : str
        What.
    size_px : int
        Height of the letters.
    colour : tuple of int
        Their colour.
    anchor : str
        Two letters: left, middle or right; ascender (a), middle (m) or baseline (s).
    halo_px : int
        Width of a rim of paper around the letters.
    """
    x, y = place_px
    width_px = text_size(text, size_px)[0]
    x -= {"l": 0.0, "m": width_px / 2, "r": width_px}[anchor[0]]
    for part, size in _parts(text, size_px):
        # Below a common ascender a smaller digit is raised already.
        rise = 0.0 if size == size_px or anchor[1] == "a" else size_px * 0.3
        pen.text(
            (x, y - rise),
            part,
            font=_font(size),
            fill=colour,
            anchor="l" + anchor[1],
            stroke_width=halo_px,
            stroke_fill=PAPER,
        )
        if halo_px:
            # Pillow's stroke makes letters bolder: they are written once more as they are.
            pen.text((x, y - rise), part, font=_font(size), fill=colour, anchor="l" + anchor[1])
        x += _font(size).getlength(part)


def text_size(text: str, size_px: int) -> tuple[float, int]:
    """Return the width and height of a line, pixels."""
    width_px = sum(_font(size).getlength(part) for part, size in _parts(text, size_px))
    return width_px, round(size_px * 1.3)


def hex_of(colour: Colour) -> str:
    """Write a colour as ``#rrggbb``."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def _parts(text: str, size_px: int) -> list[tuple[str, int]]:
    """Split a line at raised digits: words and their size."""
    return [
        (_RAISED_PLAIN[part], round(size_px * 0.7)) if part in _RAISED_PLAIN else (part, size_px)
        for part in _RAISED.split("".join(map(_written, text)))
        if part
    ]


@cache
def _written(letter: str) -> str:
    """Return a letter as the built-in font can write it; without its accents, or else a question mark."""
    if letter in _LETTERS or letter in _RAISED_PLAIN:
        return letter
    if unicodedata.combining(letter):
        return ""
    parts = unicodedata.normalize("NFKD", _SPELLED.get(letter, letter))
    plain = "".join(part for part in parts if not unicodedata.combining(part))
    return plain if plain and _LETTERS.issuperset(plain) else "?"


@cache
def _font(size_px: int) -> FreeTypeFont | ImageFont:
    from PIL import ImageFont

    # The font that Pillow carries, so that every machine writes the same letters.
    return ImageFont.load_default(size_px)
