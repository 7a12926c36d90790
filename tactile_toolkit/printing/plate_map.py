"""Maps of build plates: pictures of the objects at their positions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import manifold3d
import numpy as np
from PIL import Image, ImageDraw

from tactile_toolkit import pictures
from tactile_toolkit.array_types import Float64
from tactile_toolkit.printing.packing import PlacedObject, PlateLayout
from tactile_toolkit.printing.plate_spec import PlateSpec
from tactile_toolkit.wording import with_count

_PLATE, _GRID, _MARGIN, _OUTLINE = "#f4f2ec", "#e0dcd2", "#b9b3a3", "#222222"
# One for each class; labels, not colours, identify objects.
_FILLS = (
    *("#9ecae1", "#fdbe85", "#a1d99b", "#fc9f97", "#cbb8dd"),
    *("#d8b49c", "#f5b9d6", "#c4c9cf", "#d9dc8c", "#9fdde2"),
)
# Lengths of the map before it is reduced by _FINER, which smooths the lines of Pillow.
_FINER = 2
_LONGER_SIDE_PX, _LONGEST_SIDE_PX, _MIN_PX_PER_MM = 2_400, 8_000, 8.0
_EDGE_PX, _TITLE_PX, _NUMBER_PX, _WORD_PX, _LINE_PX = 120, 40, 30, 24, 30
_LINES = 12  # least number of grid lines across the longer side


def draw_map(layout: PlateLayout, number: int) -> bytes:
    """Draw a plate from above, as PNG, with the front edge at the bottom.

    Colours follow from classes. Labels name the split too where several objects of the export share an id;
    labels that would cover others are left out and counted. Equal input gives equal bytes.
    """
    spec, plate = layout.spec, layout.plates[number - 1]
    title = f"plate {number} of {len(layout.plates)}: {with_count(len(plate), 'objects')}, {spec.text}"
    every = [placed.item for other in layout.plates for placed in other]
    labels, ids = sorted({item.label for item in every}), Counter(item.id for item in every)
    # More pixels for a larger plate, so that there is room for labels.
    longer_px = min(max(_LONGER_SIDE_PX, _MIN_PX_PER_MM * max(spec.sides_mm)), _LONGEST_SIDE_PX)
    scale = longer_px / max(spec.sides_mm)
    width_px, depth_px = (round(side * scale) for side in spec.sides_mm)
    sheet_px = max(width_px, round(pictures.text_size(title, _TITLE_PX)[0])) + 2 * _EDGE_PX
    picture = Image.new("RGB", (sheet_px, depth_px + 2 * _EDGE_PX), pictures.PAPER)
    chart = _Chart(ImageDraw.Draw(picture), scale, depth_px)
    _draw_plate(chart, spec, pictures.bar_length_mm(longer_px / _LINES, scale))
    for placed in plate:
        _draw_object(chart, placed, _FILLS[labels.index(placed.item.label) % len(_FILLS)])
    missing = len(plate) - _draw_words(chart, plate, ids)
    words = "front; numbers are mm"
    if missing:
        words += f"; {missing:,} without words, for want of space: plates.csv lists them"
    foot_px = depth_px + 2 * _EDGE_PX - 20
    pictures.draw_text(chart.pen, (_EDGE_PX, foot_px), words, _NUMBER_PX, anchor="ls")
    pictures.draw_text(chart.pen, (_EDGE_PX, _EDGE_PX - 28), title, _TITLE_PX, anchor="ls")
    return pictures.png_bytes(np.asarray(picture.reduce(_FINER)))


@dataclass(frozen=True, slots=True)
class _Chart:
    """A picture to draw on, and the positions of points of the plate in it."""

    pen: ImageDraw.ImageDraw
    px_per_mm: float
    depth_px: int

    def at(self, points_mm: Sequence[Sequence[float]] | Float64) -> list[tuple[float, ...]]:
        """Return the pixels of points of the plate, mm."""
        scaled = np.multiply(points_mm, (self.px_per_mm, -self.px_per_mm))
        return list(map(tuple, np.add(scaled, (_EDGE_PX, _EDGE_PX + self.depth_px)).tolist()))

    def rectangle(
        self, low_mm: Sequence[float], high_mm: Sequence[float], colour: str, width: int, fill: str = ""
    ) -> None:
        corners = self.at([(low_mm[0], high_mm[1]), (high_mm[0], low_mm[1])])
        self.pen.rectangle(corners, fill or None, colour, width)


def _draw_plate(chart: _Chart, spec: PlateSpec, step_mm: float) -> None:
    """Draw the plate with its grid, margin and unusable corner."""
    chart.rectangle((0, 0), spec.sides_mm, _OUTLINE, 0, _PLATE)
    for axis, anchor, aside_px in ((0, "ma", (0, 16)), (1, "rm", (-16, 0))):
        for at_mm in np.arange(0, spec.sides_mm[axis] + 1e-6, step_mm).tolist():
            ends_mm = np.zeros((2, 2))
            ends_mm[:, axis], ends_mm[1, 1 - axis] = at_mm, spec.sides_mm[1 - axis]
            chart.pen.line(chart.at(ends_mm), _GRID, 2)
            x, y = np.add(chart.at(ends_mm)[0], aside_px).tolist()
            pictures.draw_text(chart.pen, (x, y), f"{at_mm:g}", _NUMBER_PX, anchor=anchor)
    margin_mm = spec.margin_mm
    inner_mm = (spec.width_mm - margin_mm, spec.depth_mm - margin_mm)
    chart.rectangle((margin_mm, margin_mm), inner_mm, _MARGIN, 2)
    if any(spec.corner_mm):
        chart.rectangle((0, 0), spec.corner_mm, _OUTLINE, 2, _MARGIN)
    chart.rectangle((0, 0), spec.sides_mm, _OUTLINE, 4)


def _draw_object(chart: _Chart, placed: PlacedObject, fill: str) -> None:
    rings = [np.add(ring, (placed.x_mm, placed.y_mm)) for ring in placed.outline.rings]
    corners = chart.at(np.concatenate(rings))
    # Objects in a hole stay visible.
    for triangle in manifold3d.triangulate(rings).tolist():
        chart.pen.polygon([corners[corner] for corner in triangle], fill)
    for ring in rings:
        chart.pen.line(chart.at([*ring, ring[0]]), _OUTLINE, 2)


def _draw_words(chart: _Chart, plate: Sequence[PlacedObject], ids: Counter[int]) -> int:
    """Write class and id in the middle of each object; return the number of labels that had room."""
    taken: list[Float64] = []
    for placed in plate:
        item = placed.item
        lines = [item.name]
        if item.label:
            lines = [item.label, str(item.id)]
            if item.split and ids[item.id] > 1:
                lines.append(item.split)
        width_mm, depth_mm = placed.outline.size_mm
        middle: Float64 = np.array(chart.at([(placed.x_mm + width_mm / 2, placed.y_mm + depth_mm / 2)])[0])
        sides_px = max(pictures.text_size(line, _WORD_PX)[0] for line in lines), len(lines) * _LINE_PX
        box = np.array([middle - np.divide(sides_px, 2), middle + np.divide(sides_px, 2)])
        if any((box[1] >= other[0]).all() and (box[0] <= other[1]).all() for other in taken):
            continue
        taken.append(box)
        for row, line in enumerate(lines):
            at_px = (float(middle[0]), float(box[0, 1]) + (row + 0.5) * _LINE_PX)
            pictures.draw_text(chart.pen, at_px, line, _WORD_PX, anchor="mm", halo_px=4)
    return len(taken)
