"""Maps of build plates: a picture that tells printed objects apart."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

import numpy as np

from tactile_toolkit.printing.map_sheet import LINE_PX, Sheet
from tactile_toolkit.printing.outlines import cells_touched, signed_area

if TYPE_CHECKING:
    from tactile_toolkit.printing.layout import Placed, Tag
    from tactile_toolkit.printing.outlines import Outline
    from tactile_toolkit.printing.plate_spec import PlateSpec

__all__ = ["draw_map"]

_PLATE, _GRID, _INK = "#f4f2ec", "#e0dcd2", "#222222"
_TAG, _FIELD = "#fff3c4", "#ffffff"
_FILLS = (
    *("#9ecae1", "#fdbe85", "#a1d99b", "#fc9f97", "#cbb8dd"),
    *("#d8b49c", "#f5b9d6", "#c4c9cf", "#d9dc8c", "#9fdde2"),
)
"""One per class; the words on the map, not the colours, tell objects apart."""
_COARSE_FROM_MM = 50
_LEAST_TICK_PX = 20
_TICKS_MM = (1, 2, 5, 10, 20, 50, 100, 200, 500)
_TICKS_A_NUMBER = 5
_SMALL_PX = 15
_WORDS_PX = (14, 12, 10, 8)
_LEAST_WORDS_PX = _WORDS_PX[-1]
_SLACK_PX = 30
"""What words may take on an object that is narrower."""
_FIELD_MM = 1.5
_SPOT_MM = 0.5
_MOST_SPOTS = 600

Box = tuple[float, float, float, float]


def draw_map(
    plate: Sequence[Placed], spec: PlateSpec, title: str, labels: Sequence[str], shared: Collection[int] = ()
) -> bytes:
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
    shared : collection of int
        Ids that several objects of the export have: words name the split too.

    Returns
    -------
    bytes
        A PNG file with the front edge at the bottom, as the printer is looked at; the same input always
        gives the same bytes. What belongs to one object of several parts stands on a white field of its own.
    """
    sheet = Sheet((spec.width_mm, spec.depth_mm), title)
    _draw_plate(sheet, spec)
    for placed in plate:
        if placed.outline.parts > 1:
            _draw_field(sheet, placed, spec)
    for placed in plate:
        fill = _FILLS[labels.index(placed.item.label) % len(_FILLS)]
        _draw_object(sheet, placed, fill)
        if placed.tag is not None:
            _draw_tag(sheet, placed.tag)
    _name_objects(sheet, plate, spec, shared)
    return sheet.png()


def _draw_plate(sheet: Sheet, spec: PlateSpec) -> None:
    width_mm, depth_mm = spec.width_mm, spec.depth_mm
    step_mm = _tick_mm(sheet, max(width_mm, depth_mm))
    sheet.rectangle((0, 0), (width_mm, depth_mm), fill=_PLATE)
    for x_mm in range(0, int(width_mm) + 1, step_mm):
        sheet.line((x_mm, 0), (x_mm, depth_mm), _GRID)
        if x_mm % (_TICKS_A_NUMBER * step_mm) == 0:
            unit = " mm" if x_mm == 0 else ""
            sheet.text((x_mm, 0), f"{x_mm}{unit}", _SMALL_PX, anchor="ma", shift_px=(0, 8))
    for y_mm in range(0, int(depth_mm) + 1, step_mm):
        sheet.line((0, y_mm), (width_mm, y_mm), _GRID)
        if y_mm % (_TICKS_A_NUMBER * step_mm) == 0 and y_mm:
            sheet.text((0, y_mm), str(y_mm), _SMALL_PX, anchor="rm", shift_px=(-8, 0))
    sheet.rectangle((0, 0), (width_mm, depth_mm), outline=_INK, width=2 * LINE_PX)
    sheet.text((width_mm / 2, 0), "front", _SMALL_PX, anchor="ma", shift_px=(0, 30))


def _tick_mm(sheet: Sheet, longer_mm: float) -> int:
    """Choose a round distance between ticks that leaves room between them."""
    least_mm = 10 if longer_mm >= _COARSE_FROM_MM else 1
    return next(step for step in _TICKS_MM if step >= least_mm and step * sheet.px_per_mm >= _LEAST_TICK_PX)


def _draw_field(sheet: Sheet, placed: Placed, spec: PlateSpec) -> None:
    """Draw what only one object stands on: its hull and a little of the gap around it."""
    import manifold3d

    hull = placed.outline.claimed().grown(min(spec.gap_mm / 2, _FIELD_MM))
    plate = manifold3d.CrossSection.square((spec.width_mm, spec.depth_mm))
    for ring in (hull.translate((placed.x_mm, placed.y_mm)) ^ plate).to_polygons():
        corners = sheet.points(np.asarray(ring), (0.0, 0.0))
        sheet.area([(corners, True)], _FIELD)
        sheet.draw.line([*corners, corners[0]], fill=_INK, width=LINE_PX)


def _draw_object(sheet: Sheet, placed: Placed, fill: str) -> None:
    # Rings turned the other way round are holes.
    rings = sorted(placed.outline.rings, key=lambda ring: -abs(signed_area(ring)))
    drawn = [(sheet.points(ring, (placed.x_mm, placed.y_mm)), signed_area(ring) > 0) for ring in rings]
    sheet.area(drawn, fill)
    for corners, _ in drawn:
        sheet.draw.line([*corners, corners[0]], fill=_INK, width=LINE_PX)


def _draw_tag(sheet: Sheet, tag: Tag) -> None:
    high = (tag.x_mm + tag.width_mm, tag.y_mm + tag.depth_mm)
    sheet.rectangle((tag.x_mm, tag.y_mm), high, fill=_TAG, outline=_INK, width=LINE_PX)
    if _tag_text_px(sheet, tag) >= _LEAST_WORDS_PX:
        middle = (tag.x_mm + tag.width_mm / 2, tag.y_mm + tag.depth_mm / 2)
        sheet.text(middle, tag.text, _tag_text_px(sheet, tag))


def _tag_text_px(sheet: Sheet, tag: Tag) -> float:
    return min(0.6 * tag.depth_mm * sheet.px_per_mm, 24)


def _name_objects(sheet: Sheet, plate: Sequence[Placed], spec: PlateSpec, shared: Collection[int]) -> None:
    """Write on each object what it is, unless no size is left at which that could be read."""
    taken: list[Box] = []
    left_out = 0
    for placed in plate:
        x_mm, y_mm = _widest_spot(placed.outline)
        place = (placed.x_mm + x_mm, placed.y_mm + y_mm)
        words = _words(sheet, placed, alone=placed.item.id not in shared)
        size_px = _size_px(sheet, placed, place, words, taken)
        if size_px is None:
            left_out += 1
            continue
        taken.append(sheet.text_box(place, words, size_px))
        sheet.text(place, words, size_px, halo=True)
    if left_out:
        words = f"{left_out:,} without words, for want of room: plates.csv says what they are"
        sheet.text((spec.width_mm / 2, 0), words, _SMALL_PX, anchor="ma", shift_px=(0, 44))


def _words(sheet: Sheet, placed: Placed, alone: bool) -> str:
    item, tag = placed.item, placed.tag
    if not item.label:
        return item.name
    if tag is not None and _tag_text_px(sheet, tag) >= _LEAST_WORDS_PX:
        # The tag beside it says the rest.
        return item.label
    split = [] if alone or not item.split else [item.split]
    return "\n".join([item.label, str(item.id), *split])


def _size_px(
    sheet: Sheet, placed: Placed, place: tuple[float, float], words: str, taken: Sequence[Box]
) -> float | None:
    """Find the largest size at which words are no wider than their object and on no others."""
    room = [max(side * sheet.px_per_mm, _SLACK_PX) for side in placed.outline.size_mm]
    for size_px in _WORDS_PX:
        left, top, right, bottom = sheet.text_box(place, words, size_px)
        free = all(
            right < other[0] or left > other[2] or bottom < other[1] or top > other[3] for other in taken
        )
        if free and right - left <= room[0] and bottom - top <= room[1]:
            return size_px
    return None


def _widest_spot(outline: Outline) -> tuple[float, float]:
    """Find where an outline has most room for words."""
    from scipy import ndimage

    width_mm, depth_mm = outline.size_mm
    spot_mm = max(_SPOT_MM, max(outline.size_mm) / _MOST_SPOTS)
    shape = (math.ceil(depth_mm / spot_mm), math.ceil(width_mm / spot_mm))
    cells = cells_touched([ring / spot_mm for ring in outline.rings], shape)
    room = ndimage.distance_transform_edt(np.pad(cells, 1))
    row, column = np.unravel_index(int(room.argmax()), room.shape)
    return (float(column) - 0.5) * spot_mm, (float(row) - 0.5) * spot_mm
