"""Maps of build plates: a picture that tells printed objects apart."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from dataset_store.errors import InputError
from dataset_store.printing.outlines import cells_touched

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from dataset_store.printing.layout import Placed, Tag
    from dataset_store.printing.outlines import Outline
    from dataset_store.printing.plate_spec import PlateSpec

__all__ = ["draw_map"]

_LONGER_SIDE_PX = 1_200
_SUPERSAMPLING = 2
_PAPER, _PLATE, _GRID, _INK = "#ffffff", "#f4f2ec", "#e0dcd2", "#222222"
_TAG, _HALO = "#fff3c4", "#ffffff"
_FILLS = (
    *("#9ecae1", "#fdbe85", "#a1d99b", "#fc9f97", "#cbb8dd"),
    *("#d8b49c", "#f5b9d6", "#c4c9cf", "#d9dc8c", "#9fdde2"),
)
"""One per class; the words on the map, not the colours, tell objects apart."""
_TICK_MM = 10
_NUMBERED_MM = 50
_SPOT_MM = 0.5


class _Sheet:
    """A drawing in millimetres, y upwards."""

    def __init__(self, spec: PlateSpec, title: str) -> None:
        from PIL import Image, ImageDraw

        self.spec = spec
        self.px_per_mm = _LONGER_SIDE_PX * _SUPERSAMPLING / max(spec.width_mm, spec.depth_mm)
        self.margin_px = 60 * _SUPERSAMPLING
        width, depth = (
            round(side * self.px_per_mm) + 2 * self.margin_px for side in (spec.width_mm, spec.depth_mm)
        )
        self.picture = Image.new("RGB", (width, depth), _PAPER)
        self.draw = ImageDraw.Draw(self.picture)
        self.text((spec.width_mm / 2, spec.depth_mm), title, 20, anchor="md", shift_px=(0, -14))

    def point(self, x_mm: float, y_mm: float) -> tuple[float, float]:
        """Return where a point of the plate lies in the picture."""
        return (
            self.margin_px + x_mm * self.px_per_mm,
            self.margin_px + (self.spec.depth_mm - y_mm) * self.px_per_mm,
        )

    def line(self, start: tuple[float, float], end: tuple[float, float], colour: str, width: int = 1) -> None:
        """Draw a line."""
        self.draw.line([self.point(*start), self.point(*end)], fill=colour, width=width * _SUPERSAMPLING)

    def rectangle(self, low: tuple[float, float], high: tuple[float, float], **paint: Any) -> None:
        """Draw an upright rectangle."""
        (left, bottom), (right, top) = self.point(*low), self.point(*high)
        self.draw.rectangle([left, top, right, bottom], **paint)

    def text(
        self,
        place: tuple[float, float],
        words: str,
        size_px: float,
        anchor: str = "mm",
        shift_px: tuple[int, int] = (0, 0),
        halo: bool = False,
    ) -> None:
        """Write words at a point; the size is that in the finished picture."""
        x, y = self.point(*place)
        self.draw.text(
            (x + shift_px[0] * _SUPERSAMPLING, y + shift_px[1] * _SUPERSAMPLING),
            words,
            fill=_INK,
            anchor=anchor,
            align="center",
            font=_font(round(size_px * _SUPERSAMPLING)),
            stroke_width=2 * _SUPERSAMPLING if halo else 0,
            stroke_fill=_HALO,
        )

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


def draw_map(plate: Sequence[Placed], spec: PlateSpec, title: str, labels: Sequence[str]) -> bytes:
    """Draw a plate from above.

    Parameters
    ----------
    plate : sequence of Placed
        What lies on it.
    spec : PlateSpec
        Its sides.
    title : str
        Written above it.
    labels : sequence of str
        Classes, which choose the colours.

    Returns
    -------
    bytes
        A PNG file with the front edge at the bottom, as the printer is looked at; the same input always
        gives the same bytes.
    """
    sheet = _Sheet(spec, title)
    _draw_plate(sheet)
    for placed in plate:
        fill = _FILLS[labels.index(placed.item.label) % len(_FILLS)]
        _draw_object(sheet, placed, fill)
        if placed.tag is not None:
            _draw_tag(sheet, placed.tag)
    for placed in plate:
        _name_object(sheet, placed)
    return sheet.png()


def _draw_plate(sheet: _Sheet) -> None:
    width_mm, depth_mm = sheet.spec.width_mm, sheet.spec.depth_mm
    sheet.rectangle((0, 0), (width_mm, depth_mm), fill=_PLATE)
    for x_mm in range(0, int(width_mm) + 1, _TICK_MM):
        sheet.line((x_mm, 0), (x_mm, depth_mm), _GRID)
        if x_mm % _NUMBERED_MM == 0:
            unit = " mm" if x_mm == 0 else ""
            sheet.text((x_mm, 0), f"{x_mm}{unit}", 15, anchor="ma", shift_px=(0, 8))
    for y_mm in range(0, int(depth_mm) + 1, _TICK_MM):
        sheet.line((0, y_mm), (width_mm, y_mm), _GRID)
        if y_mm % _NUMBERED_MM == 0 and y_mm:
            sheet.text((0, y_mm), str(y_mm), 15, anchor="rm", shift_px=(-8, 0))
    sheet.rectangle((0, 0), (width_mm, depth_mm), outline=_INK, width=2 * _SUPERSAMPLING)
    sheet.text((width_mm / 2, 0), "front", 15, anchor="ma", shift_px=(0, 30))


def _draw_object(sheet: _Sheet, placed: Placed, fill: str) -> None:
    from PIL import Image, ImageDraw

    rings = [_on_sheet(sheet, ring, placed) for ring in placed.outline.rings]
    # Rings turned the other way round are holes; a mask keeps what lies in them visible.
    mask = Image.new("1", sheet.picture.size)
    for ring in sorted(placed.outline.rings, key=lambda ring: -abs(_signed_area(ring))):
        ImageDraw.Draw(mask).polygon(_on_sheet(sheet, ring, placed), fill=int(_signed_area(ring) > 0))
    sheet.picture.paste(fill, mask=mask)
    for corners in rings:
        sheet.draw.line([*corners, corners[0]], fill=_INK, width=_SUPERSAMPLING)


def _draw_tag(sheet: _Sheet, tag: Tag) -> None:
    high = (tag.x_mm + tag.width_mm, tag.y_mm + tag.depth_mm)
    sheet.rectangle((tag.x_mm, tag.y_mm), high, fill=_TAG, outline=_INK, width=_SUPERSAMPLING)
    middle = (tag.x_mm + tag.width_mm / 2, tag.y_mm + tag.depth_mm / 2)
    sheet.text(middle, tag.text, min(0.6 * tag.depth_mm * sheet.px_per_mm / _SUPERSAMPLING, 24))


def _name_object(sheet: _Sheet, placed: Placed) -> None:
    x_mm, y_mm = _widest_spot(placed.outline)
    words = f"{placed.item.label}\n{placed.item.id}" if placed.item.label else placed.item.name
    sheet.text((placed.x_mm + x_mm, placed.y_mm + y_mm), words, 14, halo=True)


def _widest_spot(outline: Outline) -> tuple[float, float]:
    """Find where an outline has most room for words."""
    from scipy import ndimage

    width_mm, depth_mm = outline.size_mm
    shape = (math.ceil(depth_mm / _SPOT_MM), math.ceil(width_mm / _SPOT_MM))
    cells = cells_touched([ring / _SPOT_MM for ring in outline.rings], shape)
    room = ndimage.distance_transform_edt(np.pad(cells, 1))
    row, column = np.unravel_index(int(room.argmax()), room.shape)
    return (float(column) - 0.5) * _SPOT_MM, (float(row) - 0.5) * _SPOT_MM


def _on_sheet(sheet: _Sheet, ring: NDArray[np.float64], placed: Placed) -> list[tuple[float, float]]:
    return [sheet.point(x + placed.x_mm, y + placed.y_mm) for x, y in ring.tolist()]


def _signed_area(ring: NDArray[np.float64]) -> float:
    x, y = ring.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def _font(size_px: int) -> Any:
    from PIL import ImageFont, features

    if not features.check("freetype2"):
        message = (
            "this build of pillow cannot write text (no FreeType); next: pip install --force-reinstall pillow"
        )
        raise InputError(message)
    return ImageFont.load_default(size_px)
