"""Touches as sheets of tiles: one file per round for all stills, one per clip for its frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from realtouch.clips import TouchClip
from realtouch.jpeg import Pixels, encode_image
from realtouch.resizing import resized

__all__ = ["Film", "FRAMES_PER_FILM", "TileSheet", "film_of", "sheet_of"]

FRAMES_PER_FILM = 24
"""Frames shown of a clip, evenly spaced; of the published 58 to 90 every third or so."""

_TILE_WIDTH_PX = 160
_COLUMNS = 8
_FILM_COLUMNS = 6
_QUALITY = 80


@dataclass(frozen=True, slots=True)
class TileSheet:
    """Pictures of one size in rows, without gaps.

    Attributes
    ----------
    jpeg : bytes
        The sheet.
    tile_px : tuple of int
        Width and height of a tile.
    columns : int
        Tiles in a row.
    """

    jpeg: bytes = field(repr=False)
    tile_px: tuple[int, int]
    columns: int


@dataclass(frozen=True, slots=True)
class Film:
    """Some frames of a clip as a sheet of tiles.

    Attributes
    ----------
    name : str
        End of its file name.
    jpeg : bytes
        The sheet.
    columns : int
        Tiles in a row.
    numbers : tuple of int
        Which frames of the clip.
    times_s : tuple of float
        Their time stamps, seconds.
    window : tuple of int
        First and last tile that show registered contact.
    """

    name: str
    jpeg: bytes = field(repr=False)
    columns: int
    numbers: tuple[int, ...]
    times_s: tuple[float, ...]
    window: tuple[int, int]

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values for the page, without the sheet."""
        first, last = self.window
        return {
            "name": self.name,
            "columns": self.columns,
            "frames": len(self.numbers),
            "numbers": list(self.numbers),
            "times_s": list(self.times_s),
            "first": first,
            "last": last,
        }


def sheet_of(images: Sequence[Pixels], columns: int = _COLUMNS) -> TileSheet:
    """Lay pictures out in rows without gaps.

    Parameters
    ----------
    images : sequence of ndarray, shapes (H, W, 3), uint8
        RGB; tiles have the proportions of the first and are at most 160 pixels wide.
    columns : int
        Tiles in a row.
    """
    height, width = images[0].shape[:2]
    tile_width = min(width, _TILE_WIDTH_PX)
    tile_height = max(1, round(tile_width * height / width))
    columns = min(columns, len(images))
    rows = -(-len(images) // columns)
    sheet = np.zeros((rows * tile_height, columns * tile_width, 3), np.uint8)
    for place, image in enumerate(images):
        row, column = divmod(place, columns)
        y, x = row * tile_height, column * tile_width
        sheet[y : y + tile_height, x : x + tile_width] = resized(image, tile_width, tile_height)
    return TileSheet(encode_image(sheet, "jpeg", _QUALITY), (tile_width, tile_height), columns)


def film_of(clip: TouchClip, name: str) -> Film:
    """Choose frames of a clip, evenly spaced and with both ends of the contact, and lay them out."""
    window = clip.contact_window
    spaced = np.linspace(0, len(clip) - 1, min(len(clip), FRAMES_PER_FILM)).round().astype(int)
    numbers = np.unique([*spaced, window.start, window.stop - 1])
    times_s = clip.timestamps_s[numbers]
    sheet = sheet_of(list(clip.frames(numbers)), _FILM_COLUMNS)
    return Film(
        name=name,
        jpeg=sheet.jpeg,
        columns=sheet.columns,
        numbers=tuple(numbers.tolist()),
        times_s=tuple(round(float(time), 3) for time in times_s),
        window=(int(np.searchsorted(numbers, window.start)), int(np.searchsorted(numbers, window.stop - 1))),
    )
