"""Maps of build plates: a picture by which printed objects are found."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tactile_toolkit.pictures.sheets import draw_text, text_size
from tactile_toolkit.pictures.writing import png_bytes
from tactile_toolkit.printing.packing import cells_touched

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tactile_toolkit.printing.packing import Outline, Placed
    from tactile_toolkit.printing.spec import PlateSpec


_PAPER, _PLATE, _GRID, _INK = "#ffffff", "#f4f2ec", "#e0dcd2", "#222222"
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
_MARGIN_PX = 60
_LINE_HEIGHT = 1.25


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
        rings = placed.outline.section.translate((placed.x_mm, placed.y_mm)).to_polygons()
        sheet.area(rings, _FILLS[labels.index(placed.item.label) % len(_FILLS)])
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
        self._scale = self.px_per_mm * _SUPERSAMPLING
        width, depth = (round(side * self._scale) for side in sides_mm)
        words = round(text_size(title, _TITLE_PX * _SUPERSAMPLING)[0])
        margin = _MARGIN_PX * _SUPERSAMPLING
        left = max(margin, (words - width) // 2 + 10 * _SUPERSAMPLING)
        self._front_left = np.array([left, margin + sides_mm[1] * self._scale])
        self.picture = Image.new("RGB", (width + 2 * left, depth + 2 * margin), _PAPER)
        self.draw = ImageDraw.Draw(self.picture)
        self.text((sides_mm[0] / 2, sides_mm[1]), title, _TITLE_PX, anchor="md", shift_px=(0, -14))

    def points(self, *places_mm: Any) -> list[tuple[float, ...]]:
        """Return where points of the plate, each x and y, lie in the picture."""
        places = self._front_left + np.array(places_mm, float) * (self._scale, -self._scale)
        return list(map(tuple, places.tolist()))

    def line(self, *places_mm: Any, colour: str, width: int = 1) -> None:
        """Draw a line, thin by default."""
        self.draw.line(self.points(*places_mm), fill=colour, width=width * _SUPERSAMPLING)

    def area(self, rings_mm: Sequence[NDArray[np.float64]], fill: str) -> None:
        """Fill what rings enclose, of which those that are turned the other way round are holes."""
        import manifold3d

        corners = self.points(*np.concatenate(rings_mm))
        # What lies in a hole stays visible.
        for triangle in manifold3d.triangulate([*rings_mm]).tolist():
            self.draw.polygon([corners[corner] for corner in triangle], fill=fill)
        for ring in rings_mm:
            self.line(*ring, ring[0], colour=_INK)

    def text(
        self,
        place_mm: tuple[float, float],
        line: str,
        size_px: float,
        anchor: str = "mm",
        shift_px: tuple[float, float] = (0, 0),
        halo_px: int = 0,
    ) -> None:
        """Write a line at a point."""
        ((x, y),) = self.points(place_mm)
        at = (x + shift_px[0] * _SUPERSAMPLING, y + shift_px[1] * _SUPERSAMPLING)
        size, halo = round(size_px * _SUPERSAMPLING), halo_px * _SUPERSAMPLING
        draw_text(self.draw, at, line, size, anchor=anchor, halo_px=halo)

    def png(self) -> bytes:
        """Return the finished picture."""
        return png_bytes(np.asarray(self.picture.reduce(_SUPERSAMPLING)))


def _draw_plate(sheet: _Sheet, spec: PlateSpec) -> None:
    width_mm, depth_mm = spec.sides_mm
    # A round distance between ticks that leaves room between them.
    longer_mm = max(width_mm, depth_mm)
    least_mm = max(10 if longer_mm >= _COARSE_FROM_MM else 1, _LEAST_TICK_PX / sheet.px_per_mm)
    step_mm = next(step for step in _TICKS_MM if step >= least_mm)
    sheet.draw.rectangle(sheet.points((0, depth_mm), (width_mm, 0)), fill=_PLATE)
    for x_mm in range(0, int(width_mm) + 1, step_mm):
        sheet.line((x_mm, 0), (x_mm, depth_mm), colour=_GRID)
        if x_mm % (_TICKS_A_NUMBER * step_mm) == 0:
            sheet.text((x_mm, 0), str(x_mm) if x_mm else "0 mm", _SMALL_PX, "ma", (0, 8))
    for y_mm in range(0, int(depth_mm) + 1, step_mm):
        sheet.line((0, y_mm), (width_mm, y_mm), colour=_GRID)
        if y_mm % (_TICKS_A_NUMBER * step_mm) == 0 and y_mm:
            sheet.text((0, y_mm), str(y_mm), _SMALL_PX, "rm", (-8, 0))
    for inset_mm, colour, width in ((spec.margin_mm, _MARGIN, 1), (0.0, _INK, 2)):
        right_mm, back_mm = width_mm - inset_mm, depth_mm - inset_mm
        front = ((inset_mm, inset_mm), (right_mm, inset_mm))
        sheet.line(*front, (right_mm, back_mm), (inset_mm, back_mm), front[0], colour=colour, width=width)
    sheet.text((width_mm / 2, 0), "front", _SMALL_PX, "ma", (0, 30))


def _draw_field(sheet: _Sheet, placed: Placed, spec: PlateSpec) -> None:
    """Draw what only one object stands on: its hull and a little of the gap around it."""
    import manifold3d

    hull = placed.outline.footprint().grown(min(spec.gap_mm / 2, _FIELD_MM))
    plate = manifold3d.CrossSection.square(spec.sides_mm)
    sheet.area((hull.translate((placed.x_mm, placed.y_mm)) ^ plate).to_polygons(), _PAPER)


def _name_objects(sheet: _Sheet, plate: Sequence[Placed], spec: PlateSpec, shared: Collection[int]) -> None:
    """Write on each object what it is, unless no size is left at which that could be read."""
    taken: list[NDArray[np.float64]] = []
    left_out = 0
    for placed in plate:
        item = placed.item
        middle_mm = np.add(_widest_spot(placed.outline), (placed.x_mm, placed.y_mm))
        split = [item.split] if item.split and item.id in shared else []
        lines = [item.label, str(item.id), *split] if item.label else [item.name]
        # The largest size at which words are hardly wider than their object and on no others.
        room_mm = np.maximum(placed.outline.size_mm, _SLACK_PX / sheet.px_per_mm)
        for size_px in _WORDS_PX:
            step_px = _LINE_HEIGHT * size_px
            width_px = max(text_size(line, round(size_px * _SUPERSAMPLING))[0] for line in lines)
            sides_mm = np.array([width_px / _SUPERSAMPLING, len(lines) * step_px]) / sheet.px_per_mm
            box = np.array([middle_mm - sides_mm / 2, middle_mm + sides_mm / 2])
            is_free = all((box[1] < other[0]).any() or (box[0] > other[1]).any() for other in taken)
            if is_free and (sides_mm <= room_mm).all():
                taken.append(box)
                for number, line in enumerate(lines):
                    shift_px = (0, (number - (len(lines) - 1) / 2) * step_px)
                    sheet.text(tuple(middle_mm), line, size_px, shift_px=shift_px, halo_px=2)
                break
        else:
            left_out += 1
    if left_out:
        words = f"{left_out:,} without words, for want of space: plates.csv lists them"
        sheet.text((spec.width_mm / 2, 0), words, _SMALL_PX, "ma", (0, 44))


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
