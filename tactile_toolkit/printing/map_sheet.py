"""Drawings in millimetres, and their words in pixels."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from tactile_toolkit.errors import InputError
from tactile_toolkit.pictures.lettering import draw_text, text_size

__all__ = ["LINE_PX", "Sheet"]

_LONGER_SIDE_PX = 1_200
_LEAST_PX_PER_MM = 4.0
_LONGEST_SIDE_PX = 4_000
_SUPERSAMPLING = 2
LINE_PX = _SUPERSAMPLING
"""Width of a thin line."""
_MARGIN_PX = 60
_TITLE_PX = 20
_LINE_HEIGHT = 1.25
_PAPER = "#ffffff"

Box = tuple[float, float, float, float]
Points = Sequence[tuple[float, float]]


class Sheet:
    """A drawing in millimetres, y upwards.

    Parameters
    ----------
    sides_mm : tuple of float
        Along x and y. Pixels grow with them up to a limit, so that words keep their room.
    title : str
        Written above it.
    """

    def __init__(self, sides_mm: tuple[float, float], title: str) -> None:
        from PIL import Image, ImageDraw

        _require_letters()
        longer_mm = max(sides_mm)
        longer_px = min(max(_LONGER_SIDE_PX, _LEAST_PX_PER_MM * longer_mm), _LONGEST_SIDE_PX)
        self.px_per_mm = longer_px / longer_mm
        """Of the finished picture."""
        self._depth_mm = sides_mm[1]
        self._scale = self.px_per_mm * _SUPERSAMPLING
        width, depth = (round(side * self._scale) for side in sides_mm)
        words = round(text_size(title, _TITLE_PX * _SUPERSAMPLING)[0])
        self._left = max(_MARGIN_PX * _SUPERSAMPLING, (words - width) // 2 + 10 * _SUPERSAMPLING)
        self._top = _MARGIN_PX * _SUPERSAMPLING
        self.picture = Image.new("RGB", (width + 2 * self._left, depth + 2 * self._top), _PAPER)
        self.draw = ImageDraw.Draw(self.picture)
        self.text((sides_mm[0] / 2, sides_mm[1]), title, _TITLE_PX, anchor="md", shift_px=(0, -14))

    def point(self, x_mm: float, y_mm: float) -> tuple[float, float]:
        """Return where a point of the plate lies in the picture."""
        return self._left + x_mm * self._scale, self._top + (self._depth_mm - y_mm) * self._scale

    def points(self, ring_mm: Any, place_mm: tuple[float, float]) -> list[tuple[float, float]]:
        """Return where a ring lies whose frame begins at a place."""
        return [self.point(x + place_mm[0], y + place_mm[1]) for x, y in ring_mm.tolist()]

    def line(self, start: tuple[float, float], end: tuple[float, float], colour: str, width: int = 1) -> None:
        """Draw a line."""
        self.draw.line([self.point(*start), self.point(*end)], fill=colour, width=width * _SUPERSAMPLING)

    def rectangle(self, low: tuple[float, float], high: tuple[float, float], **paint: Any) -> None:
        """Draw an upright rectangle."""
        (left, bottom), (right, top) = self.point(*low), self.point(*high)
        self.draw.rectangle([left, top, right, bottom], **paint)

    def area(self, rings: Sequence[tuple[Points, bool]], fill: str) -> None:
        """Fill rings, largest first; those that are holes keep what lies in them visible.

        Parameters
        ----------
        rings : sequence of (points, bool)
            Corners in the picture, and whether the inside is filled or left out.
        fill : str
            Colour.
        """
        from PIL import Image, ImageDraw

        corners = np.concatenate([np.asarray(points) for points, _ in rings])
        low = np.floor(corners.min(axis=0)).astype(int)
        width, depth = (np.ceil(corners.max(axis=0)).astype(int) - low + 1).tolist()
        mask = Image.new("1", (width, depth))
        pen = ImageDraw.Draw(mask)
        for points, filled in rings:
            pen.polygon([(x - low[0], y - low[1]) for x, y in points], fill=int(filled))
        self.picture.paste(fill, (int(low[0]), int(low[1])), mask)

    def text(
        self,
        place: tuple[float, float],
        words: str,
        size_px: float,
        anchor: str = "mm",
        shift_px: tuple[float, float] = (0, 0),
        halo: bool = False,
    ) -> None:
        """Write lines about a point; the size is that in the finished picture."""
        x, y = self.point(*place)
        lines = words.split("\n")
        for number, line in enumerate(lines):
            down_px = (number - (len(lines) - 1) / 2) * _LINE_HEIGHT * size_px + shift_px[1]
            draw_text(
                self.draw,
                (x + shift_px[0] * _SUPERSAMPLING, y + down_px * _SUPERSAMPLING),
                line,
                round(size_px * _SUPERSAMPLING),
                anchor=anchor,
                halo_px=2 * _SUPERSAMPLING if halo else 0,
            )

    def text_box(self, place: tuple[float, float], words: str, size_px: float) -> Box:
        """Return left, top, right and bottom of lines about a point, pixels of the finished picture."""
        x, y = (side / _SUPERSAMPLING for side in self.point(*place))
        lines = words.split("\n")
        size = round(size_px * _SUPERSAMPLING)
        width = max(text_size(line, size)[0] for line in lines) / _SUPERSAMPLING
        depth = len(lines) * _LINE_HEIGHT * size_px
        return x - width / 2, y - depth / 2, x + width / 2, y + depth / 2

    def png(self) -> bytes:
        """Return the finished picture."""
        from PIL import Image

        width, height = self.picture.size
        small = self.picture.resize(
            (width // _SUPERSAMPLING, height // _SUPERSAMPLING), Image.Resampling.LANCZOS
        )
        stream = io.BytesIO()
        small.save(stream, format="PNG", optimize=False)
        return stream.getvalue()


def _require_letters() -> None:
    from PIL import features

    if not features.check("freetype2"):
        message = (
            "this build of pillow cannot write text (no FreeType); next: pip install --force-reinstall pillow"
        )
        raise InputError(message)
