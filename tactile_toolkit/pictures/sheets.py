"""Pictures side by side with words about them, in one font and one palette, and in files and notebooks.

They are planned first, then drawn one by one; equal pixels give equal bytes.
"""

from __future__ import annotations

import base64
import html
import io
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from tactile_toolkit import store
from tactile_toolkit.array_types import UInt8
from tactile_toolkit.errors import InputError

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
    """Lay pictures out row by row in cells of one size, each in the middle of its cell; None is empty.

    Title and lines stand above them, labels left of each row; ``bar_room`` leaves that of a scale bar below.
    Returns colours of shape (H, W, 3).
    """
    from PIL import Image, ImageDraw, ImageOps

    columns = min(columns, max(len(tiles), 1))
    rows = -(-len(tiles) // columns)
    shown = [tile for tile in tiles if tile is not None]
    frame_px = 2 * _FRAME_PX if any(tile.frame for tile in shown) else 0
    cell_height = max((tile.pixels.shape[0] for tile in shown), default=1) + frame_px
    cell_width = max((tile.pixels.shape[1] for tile in shown), default=1) + frame_px
    captioned = any(tile.caption for tile in shown)
    row_step = cell_height + gap_px + (_line_px(CAPTION_PX) if captioned else 0)
    label_px = max((round(text_size(label, TEXT_PX)[0]) for label in row_labels), default=0)
    head_px = (_line_px(TITLE_PX) if title else 0) + _line_px(TEXT_PX) * len(lines)
    left_px = margin_px + (label_px + gap_px + 4 if label_px else 0)
    top_px = margin_px + (head_px + gap_px if head_px else 0)
    words_px = max([text_size(line, TEXT_PX)[0] for line in lines] + [text_size(title, TITLE_PX)[0]])
    width = max(left_px + columns * (cell_width + gap_px) - gap_px, round(words_px) + margin_px) + margin_px
    height = top_px + rows * row_step + (_line_px(TEXT_PX) if bar_room else -gap_px) + margin_px

    picture = Image.new("RGB", (width, height), PAPER)
    pen = ImageDraw.Draw(picture)
    if title:
        draw_text(pen, (margin_px, margin_px), title, TITLE_PX)
    for number, line in enumerate(lines):
        y = margin_px + head_px - _line_px(TEXT_PX) * (len(lines) - number)
        draw_text(pen, (margin_px, y), line, TEXT_PX, MUTED)
    for row, label in enumerate(row_labels):
        middle = (left_px - gap_px - 4, top_px + row * row_step + cell_height // 2)
        draw_text(pen, middle, label, TEXT_PX, anchor="rm")
    for index, tile in enumerate(tiles):
        if tile is None:
            continue
        row, column = divmod(index, columns)
        cell_x, cell_y = left_px + column * (cell_width + gap_px), top_px + row * row_step
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


def with_scale_bar(pixels: UInt8, px_per_mm: float, length_mm: float | None = None) -> UInt8:
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


# --- in files and notebooks -------------------------------------------------------------------------


TILE_STYLE = "margin:0;text-align:center;font-size:smaller"
"""Style of a small picture among others in a notebook."""


@dataclass(frozen=True, slots=True)
class PlannedPicture:
    """A picture that is not drawn yet: its file name (``.png``) and what it shows, in a few words."""

    name: str
    what: str
    draw: Callable[[], UInt8]


@dataclass(frozen=True, slots=True)
class PicturePlan:
    """What will be drawn, in order, and why kinds that were not named are left out."""

    pictures: tuple[PlannedPicture, ...]
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class WrittenPicture:
    """A picture on disk: name and words as planned, size in pixels and bytes."""

    file: str
    what: str
    width: int
    height: int
    bytes: int


def plan_kinds(
    asked: Sequence[str], plans: Mapping[str, Callable[[], Sequence[PlannedPicture]]]
) -> PicturePlan:
    """Plan the pictures of each kind that was asked for, or of the first one.

    ``"all"`` among those asked for stands for all. What cannot be drawn and was not named one by one is left
    out, with the reason; an InputError of a kind that was named or is unknown, or of all where nothing can be
    drawn, is raised.
    """
    unknown = [kind for kind in asked if kind not in (*plans, "all")]
    if unknown:
        raise InputError(f"no pictures of kind {unknown[0]!r}; expected {', '.join(plans)} or all")
    named = bool(asked) and "all" not in asked
    wanted = plans if "all" in asked else asked or next(iter(plans))
    pictures: list[PlannedPicture] = []
    reasons: list[InputError] = []
    for kind in filter(wanted.__contains__, plans):
        try:
            pictures += plans[kind]()
        except InputError as error:
            if named:
                raise
            reasons.append(error)
    if not pictures and reasons:
        raise reasons[0]
    # Several kinds may need the same missing package.
    return PicturePlan(tuple(pictures), tuple(dict.fromkeys(str(reason) for reason in reasons)))


def write_pictures(
    folder: store.DataFolder,
    pictures: Sequence[PlannedPicture],
    on_progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> list[WrittenPicture]:
    """Draw pictures and write each whole or not at all; one of the same name is replaced.

    When one cannot be drawn or written, those before it stay.
    """
    written = []
    for done, planned in enumerate(pictures, start=1):
        pixels = planned.draw()
        content = png_bytes(pixels)
        folder.write_bytes(planned.name, content)
        height, width = pixels.shape[:2]
        written.append(WrittenPicture(planned.name, planned.what, width, height, len(content)))
        on_progress(done, len(pictures))
    return written


def png_bytes(pixels: UInt8) -> bytes:
    """Encode a picture as PNG without times, names of programs or anything else but its pixels."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(stream, "PNG", compress_level=6)
    return stream.getvalue()


def figure_html(pixels: UInt8, caption: str, style: str = "") -> str:
    """Return what a notebook shows of a picture and its caption, which is plain text."""
    source = base64.b64encode(png_bytes(pixels)).decode("ascii")
    styled = f' style="{style}"' if style else ""
    return (
        f'<figure{styled}><img src="data:image/png;base64,{source}">'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
    )


def file_stem(name: str) -> str:
    """Return by what pictures of data sets differ in name: the last part of a path, in plain letters."""
    path = store.expanded(name)
    last = path.resolve().name if path.is_dir() else path.stem if path.is_file() else path.name
    plain = "".join(letter if letter.isalnum() or letter in "-_." else "-" for letter in last)
    # With a dot in front it would be hidden, and with a dash an option.
    return plain.strip("-.") or "pictures"
