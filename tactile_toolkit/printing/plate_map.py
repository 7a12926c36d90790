"""Maps of build plates: a picture by which printed objects are found."""

from __future__ import annotations

import io
import math
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tactile_toolkit.mesh.printability import signed_area_mm2
from tactile_toolkit.pictures.sheets import draw_text, text_size
from tactile_toolkit.printing.packing import cells_touched

if TYPE_CHECKING:
    from tactile_toolkit.printing.packing import Outline, Placed
    from tactile_toolkit.printing.spec import PlateSpec


_PAPER, _PLATE, _GRID, _INK, _FIELD = "#ffffff", "#f4f2ec", "#e0dcd2", "#222222", "#ffffff"
_MARGIN = "#b9b3a3"
# One per class; the words on the map, not the colours, distinguish objects.
_FILLS = (
    *("#9ecae1", "#fdbe85", "#a1d99b", "#fc9f97", "#cbb8dd"),
    *("#d8b49c", "#f5b9d6", "#c4c9cf", "#d9dc8c", "#9fdde2"),
)
_COARSE_FROM_MM = 50
_LEAST_TICK_PX = 20
_TICKS_MM = (1, 2, 5, 10, 20, 50, 100, 200, 500)
_TICKS_A_NUMBER = 5
_TITLE_PX, _SMALL_PX = 20, 15
_WORDS_PX = (14, 12, 10, 8)
# What words may take on an object that is narrower.
_SLACK_PX = 30
_FIELD_MM = 1.5
_SPOT_MM = 0.5
_MOST_SPOTS = 600

_LONGER_SIDE_PX = 1_200
_LEAST_PX_PER_MM = 4.0
_LONGEST_SIDE_PX = 4_000
_SUPERSAMPLING = 2  # drawn so many times larger: PIL's own lines have no smooth edges
# Width of a thin line.
_LINE_PX = _SUPERSAMPLING
_MARGIN_PX = 60
_LINE_HEIGHT = 1.25

Box = tuple[float, float, float, float]
Points = list[tuple[float, float]]


def draw_map(
    plate: Sequence[Placed], spec: PlateSpec, title: str, labels: Sequence[str], shared: Collection[int] = ()
) -> bytes:
    """Draw a plate from above, a PNG file with the front edge at the bottom, as the printer is looked at.

    ``labels`` are all classes, which choose the colours. Where several objects of the export have an id in
    common, one of ``shared``, words name the split too. What belongs to one object of several parts stands on
    a white field of its own. The same input always gives the same bytes.
    """
    sheet = _Sheet(spec.sides_mm, title)
    _draw_plate(sheet, spec)
    for placed in plate:
        if placed.outline.parts > 1:
            _draw_field(sheet, placed, spec)
    for placed in plate:
        # Largest ring first; rings turned the other way round are holes.
        rings = sorted(placed.outline.rings, key=lambda ring: -abs(signed_area_mm2(ring)))
        drawn = [(sheet.points(ring, placed.x_mm, placed.y_mm), signed_area_mm2(ring) > 0) for ring in rings]
        sheet.area(drawn, _FILLS[labels.index(placed.item.label) % len(_FILLS)])
    _name_objects(sheet, plate, spec, shared)
    return sheet.png()


class _Sheet:
    """A drawing in millimetres, y upwards, below its title; words are in pixels of the finished picture."""

    def __init__(self, sides_mm: tuple[float, float], title: str) -> None:
        from PIL import Image, ImageDraw

        longer_mm = max(sides_mm)
        # More pixels for a larger plate, so that words keep their room.
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

    def points(self, ring_mm: Any, x_mm: float, y_mm: float) -> Points:
        """Return where a ring lies whose frame begins at a point of the plate."""
        return [self.point(x + x_mm, y + y_mm) for x, y in ring_mm.tolist()]

    def line(self, start: tuple[float, float], end: tuple[float, float], colour: str) -> None:
        """Draw a thin line."""
        self.draw.line([self.point(*start), self.point(*end)], fill=colour, width=_LINE_PX)

    def area(self, rings: Sequence[tuple[Points, bool]], fill: str) -> None:
        """Fill rings, each with whether its inside is filled or left out, and draw their lines.

        Filled through a mask: what lies in a hole stays visible.
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
        for points, _ in rings:
            self.draw.line([*points, points[0]], fill=_INK, width=_LINE_PX)

    def text(
        self,
        point_mm: tuple[float, float],
        line: str,
        size_px: float,
        anchor: str = "mm",
        shift_px: tuple[float, float] = (0, 0),
        halo: bool = False,
    ) -> None:
        """Write a line at a point."""
        x, y = self.point(*point_mm)
        at = (x + shift_px[0] * _SUPERSAMPLING, y + shift_px[1] * _SUPERSAMPLING)
        halo_px = 2 * _SUPERSAMPLING if halo else 0
        draw_text(self.draw, at, line, round(size_px * _SUPERSAMPLING), anchor=anchor, halo_px=halo_px)

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


def _draw_plate(sheet: _Sheet, spec: PlateSpec) -> None:
    width_mm, depth_mm = spec.sides_mm
    # A round distance between ticks that leaves room between them.
    longer_mm = max(width_mm, depth_mm)
    least_mm = max(10 if longer_mm >= _COARSE_FROM_MM else 1, _LEAST_TICK_PX / sheet.px_per_mm)
    step_mm = next(step for step in _TICKS_MM if step >= least_mm)
    corners = [sheet.point(0, depth_mm), sheet.point(width_mm, 0)]
    sheet.draw.rectangle(corners, fill=_PLATE)
    for x_mm in range(0, int(width_mm) + 1, step_mm):
        sheet.line((x_mm, 0), (x_mm, depth_mm), _GRID)
        if x_mm % (_TICKS_A_NUMBER * step_mm) == 0:
            unit = " mm" if x_mm == 0 else ""
            sheet.text((x_mm, 0), f"{x_mm}{unit}", _SMALL_PX, anchor="ma", shift_px=(0, 8))
    for y_mm in range(0, int(depth_mm) + 1, step_mm):
        sheet.line((0, y_mm), (width_mm, y_mm), _GRID)
        if y_mm % (_TICKS_A_NUMBER * step_mm) == 0 and y_mm:
            sheet.text((0, y_mm), str(y_mm), _SMALL_PX, anchor="rm", shift_px=(-8, 0))
    margin_mm = spec.margin_mm
    inner = [sheet.point(margin_mm, depth_mm - margin_mm), sheet.point(width_mm - margin_mm, margin_mm)]
    sheet.draw.rectangle(inner, outline=_MARGIN, width=_LINE_PX)
    sheet.draw.rectangle(corners, outline=_INK, width=2 * _LINE_PX)
    sheet.text((width_mm / 2, 0), "front", _SMALL_PX, anchor="ma", shift_px=(0, 30))


def _draw_field(sheet: _Sheet, placed: Placed, spec: PlateSpec) -> None:
    """Draw what only one object stands on: its hull and a little of the gap around it."""
    import manifold3d

    hull = placed.outline.claimed().grown(min(spec.gap_mm / 2, _FIELD_MM))
    plate = manifold3d.CrossSection.square(spec.sides_mm)
    for ring in (hull.translate((placed.x_mm, placed.y_mm)) ^ plate).to_polygons():
        sheet.area([(sheet.points(np.asarray(ring), 0.0, 0.0), True)], _FIELD)


def _name_objects(sheet: _Sheet, plate: Sequence[Placed], spec: PlateSpec, shared: Collection[int]) -> None:
    """Write on each object what it is, unless no size is left at which that could be read."""
    taken: list[Box] = []
    left_out = 0
    for placed in plate:
        x_mm, y_mm = _widest_spot(placed.outline)
        middle_mm = (placed.x_mm + x_mm, placed.y_mm + y_mm)
        item = placed.item
        split = [item.split] if item.split and item.id in shared else []
        lines = [item.label, str(item.id), *split] if item.label else [item.name]
        # The largest size at which words are hardly wider than their object and on no others.
        room = [max(side * sheet.px_per_mm, _SLACK_PX) for side in placed.outline.size_mm]
        x, y = (side / _SUPERSAMPLING for side in sheet.point(*middle_mm))
        for size_px in _WORDS_PX:
            size = round(size_px * _SUPERSAMPLING)
            width = max(text_size(line, size)[0] for line in lines) / _SUPERSAMPLING
            step_px = _LINE_HEIGHT * size_px
            depth = len(lines) * step_px
            box = left, top, right, bottom = x - width / 2, y - depth / 2, x + width / 2, y + depth / 2
            free = all(
                right < other[0] or left > other[2] or bottom < other[1] or top > other[3] for other in taken
            )
            if free and right - left <= room[0] and bottom - top <= room[1]:
                taken.append(box)
                for number, line in enumerate(lines):
                    shift_px = (0, (number - (len(lines) - 1) / 2) * step_px)
                    sheet.text(middle_mm, line, size_px, shift_px=shift_px, halo=True)
                break
        else:
            left_out += 1
    if left_out:
        words = f"{left_out:,} without words, for want of space: plates.csv lists them"
        sheet.text((spec.width_mm / 2, 0), words, _SMALL_PX, anchor="ma", shift_px=(0, 44))


def _widest_spot(outline: Outline) -> tuple[float, float]:
    """Find where an outline has most room for words, mm."""
    from scipy import ndimage

    width_mm, depth_mm = outline.size_mm
    spot_mm = max(_SPOT_MM, max(outline.size_mm) / _MOST_SPOTS)
    shape = (math.ceil(depth_mm / spot_mm), math.ceil(width_mm / spot_mm))
    cells = cells_touched([ring / spot_mm for ring in outline.rings], shape)
    room = ndimage.distance_transform_edt(np.pad(cells, 1))
    row, column = np.unravel_index(int(room.argmax()), room.shape)
    return (float(column) - 0.5) * spot_mm, (float(row) - 0.5) * spot_mm
