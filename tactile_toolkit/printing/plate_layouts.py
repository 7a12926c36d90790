"""Layouts of build plates: packing in rows of bounding boxes, and maps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import manifold3d
import numpy as np
from PIL import Image

from tactile_toolkit import pictures
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.mesh import solid_check
from tactile_toolkit.pictures import sheets
from tactile_toolkit.printing.file_export import (
    FailedExport,
    PrintObject,
    Progress,
    require_scale,
)
from tactile_toolkit.printing.print_options import Physics, PlateSpec
from tactile_toolkit.touch.images import encode_png
from tactile_toolkit.value_types import Float64
from tactile_toolkit.wording import with_count

# Objects as wide as the plate fit, despite rounding.
_ROUNDING_MM = 1e-6

_PLATE = "#f4f2ec"
_GRID = "#e0dcd2"
_MARGIN = "#b9b3a3"
_OUTLINE = "#222222"

# One for each class; labels, not colours, identify objects.
_FILLS = (
    *("#9ecae1", "#fdbe85", "#a1d99b", "#fc9f97", "#cbb8dd"),
    *("#d8b49c", "#f5b9d6", "#c4c9cf", "#d9dc8c", "#9fdde2"),
)

# Lengths of the map before it is reduced by _FINER, which smooths the lines of Pillow.
_FINER = 2

_LONGER_SIDE_PX = 2_400
_LONGEST_SIDE_PX = 8_000
_MIN_PX_PER_MM = 8.0
_EDGE_PX = 120
_TITLE_PX = 40
_NUMBER_PX = 30
_WORD_PX = 24
_LINE_PX = 30
_LINES = 12  # least number of grid lines across the longer side


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """The area of the plate that an object covers, with its lower left corner at the origin.

    ``section`` is in mm; ``low_mm`` is the lower left corner in the frame of the object.
    """

    section: manifold3d.CrossSection
    low_mm: tuple[float, float]

    @classmethod
    def of(cls, solid: manifold3d.Manifold) -> Outline:
        """Project a solid, in mm, onto the plate."""
        section = solid.project()
        left, front, _, _ = section.bounds()
        return cls(section.translate((-left, -front)), (left, front))

    @property
    def rings(self) -> list[Float64]:
        """Closed lines around it, shape (n, 2) each, mm; holes have the opposite orientation."""
        return [np.asarray(ring, np.float64) for ring in self.section.to_polygons()]

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and depth."""
        left, front, right, back = self.section.bounds()
        return right - left, back - front


@dataclass(frozen=True, slots=True, eq=False)
class PlacedObject:
    """An object and its position on a plate.

    ``x_mm`` and ``y_mm`` are the lower left corner of its bounding box, from the front left corner of the
    plate.
    """

    item: PrintObject
    outline: Outline
    height_mm: float
    volume_mm3: float
    x_mm: float = 0.0
    y_mm: float = 0.0

    @property
    def offset_mm(self) -> tuple[float, float, float]:
        """Translation from the stored position; the lowest point is at z = 0 already."""
        return self.x_mm - self.outline.low_mm[0], self.y_mm - self.outline.low_mm[1], 0.0


@dataclass(frozen=True, slots=True, eq=False)
class PlateLayout:
    """The objects on each plate, from front to back; ``failures`` are not solids and were left out."""

    spec: PlateSpec
    scale: float
    plates: tuple[tuple[PlacedObject, ...], ...]
    failures: tuple[FailedExport, ...] = ()
    physics: Physics | None = None

    @property
    def shares(self) -> tuple[float, ...]:
        """Fraction of each plate that bounding boxes and gaps take."""
        gap_mm = self.spec.gap_mm
        whole_mm2 = np.prod(np.add(self.spec.inner_mm, gap_mm)) - np.prod(self.spec.corner_mm)
        sizes_mm = ([np.add(placed.outline.size_mm, gap_mm) for placed in plate] for plate in self.plates)
        return tuple(float(np.prod(placed, axis=1).sum() / whole_mm2) for placed in sizes_mm)


@dataclass(slots=True)
class _Row:
    y_mm: float
    depth_mm: float
    next_x_mm: float


class _Plate:
    """Rows of boxes on a plate, from the front to the back."""

    def __init__(self, spec: PlateSpec) -> None:
        self._spec = spec
        self._rows: list[_Row] = []
        self._next_y_mm = spec.margin_mm

    def place(self, width_mm: float, depth_mm: float) -> tuple[float, float] | None:
        """Reserve room for a box and return its lower left corner; None if there is no room."""
        for row in self._rows:
            if depth_mm <= row.depth_mm + _ROUNDING_MM and self._has_width(row.next_x_mm, width_mm):
                return self._put(row, width_mm)
        # Beside the unusable corner, or else behind it.
        behind_mm = max(self._next_y_mm, self._spec.corner_mm[1] + self._spec.margin_mm)
        for y_mm in (self._next_y_mm, behind_mm):
            row = _Row(y_mm, depth_mm, self._start_mm(y_mm))
            has_depth = y_mm + depth_mm <= self._spec.depth_mm - self._spec.margin_mm + _ROUNDING_MM
            if has_depth and self._has_width(row.next_x_mm, width_mm):
                self._rows.append(row)
                self._next_y_mm = y_mm + depth_mm + self._spec.gap_mm
                return self._put(row, width_mm)
        return None

    def _has_width(self, x_mm: float, width_mm: float) -> bool:
        return x_mm + width_mm <= self._spec.width_mm - self._spec.margin_mm + _ROUNDING_MM

    def _put(self, row: _Row, width_mm: float) -> tuple[float, float]:
        x_mm = row.next_x_mm
        row.next_x_mm += width_mm + self._spec.gap_mm
        return x_mm, row.y_mm

    def _start_mm(self, y_mm: float) -> float:
        """Return where a row starts along x: beside the unusable corner, or at the margin."""
        if y_mm < self._spec.corner_mm[1] + self._spec.margin_mm:
            return self._spec.margin_mm + self._spec.corner_mm[0]
        return self._spec.margin_mm


def arrange(
    objects: Sequence[PrintObject],
    spec: PlateSpec,
    scale: float = 1.0,
    physics: Physics | None = None,
    on_progress: Progress = lambda _done, _total: None,
) -> PlateLayout:
    """Place all objects on plates; ``scale`` multiplies all lengths, ``physics`` is for simulators.

    The objects of a plate are centred unless they would reach into an unusable corner. Equal input gives
    equal layouts.

    Raises InputError if an object is larger than a plate, or the scale is not positive.
    """
    require_scale(scale)
    pieces = []
    failures = []
    for done, item in enumerate(objects, 1):
        try:
            pieces.append(_measured(item, spec, scale))
        except ItemError as error:
            failures.append(FailedExport(item.name, error.reason, f"{error}; it was left out"))
        on_progress(done, len(objects))
    plates = tuple(_centred(plate, spec) for plate in _in_rows(pieces, spec))
    return PlateLayout(spec, scale, plates, tuple(failures), physics)


def _measured(item: PrintObject, spec: PlateSpec, scale: float) -> PlacedObject:
    verdict = solid_check.require_solid(item.on_plate(scale))
    outline = Outline.of(verdict.manifold)
    width_mm, depth_mm = outline.size_mm
    if _Plate(spec).place(width_mm, depth_mm) is None:
        margins = ""
        remedy = "--scale"
        if spec.margin_mm:
            margins = f" less {spec.margin_mm:g} mm at each edge"
            remedy = "--margin-mm or --scale"
        if any(spec.corner_mm):
            remedy = "--margin-mm or --scale"
            margins += f" and {spec.corner_mm[0]:g} x {spec.corner_mm[1]:g} mm in a corner"
        raise InputError(
            f"{item.name} does not fit on the plate: it needs {width_mm:.1f} x {depth_mm:.1f} mm, the plate "
            f"has {spec.width_mm:g} x {spec.depth_mm:g} mm{margins}; nothing was written",
            next=f"give a larger --plate, a smaller {remedy} or other --ids",
        )
    box = verdict.manifold.bounding_box()
    return PlacedObject(item, outline, float(box[5] - box[2]), verdict.volume_mm3)


def _in_rows(pieces: Sequence[PlacedObject], spec: PlateSpec) -> list[list[PlacedObject]]:
    plates: list[tuple[_Plate, list[PlacedObject]]] = []
    for piece in sorted(pieces, key=lambda piece: piece.outline.size_mm[::-1], reverse=True):
        for plate, held in [*plates, (_Plate(spec), [])]:
            corner_mm = plate.place(*piece.outline.size_mm)
            if corner_mm is None:
                continue
            if not held:
                plates.append((plate, held))
            held.append(replace(piece, x_mm=corner_mm[0], y_mm=corner_mm[1]))
            break
    return [held for _, held in plates]


def _centred(plate: Sequence[PlacedObject], spec: PlateSpec) -> tuple[PlacedObject, ...]:
    """Centre the objects of a plate, where the bed is flattest and most evenly warm."""
    low_mm = np.array([(placed.x_mm, placed.y_mm) for placed in plate])
    high_mm = low_mm + [placed.outline.size_mm for placed in plate]
    moved_mm = low_mm + (np.array(spec.sides_mm) - low_mm.min(axis=0) - high_mm.max(axis=0)) / 2
    if any(spec.corner_mm) and (moved_mm < np.add(spec.corner_mm, spec.margin_mm)).all(axis=1).any():
        moved_mm = low_mm
    placed = [
        replace(placed, x_mm=x_mm, y_mm=y_mm)
        for placed, (x_mm, y_mm) in zip(plate, moved_mm.tolist(), strict=True)
    ]
    return tuple(sorted(placed, key=lambda placed: (placed.y_mm, placed.x_mm)))


def draw_map(layout: PlateLayout, number: int) -> bytes:
    """Draw a plate from above, as PNG, with the front edge at the bottom.

    Colours follow from classes. Labels name the split too where several objects of the export share an id;
    labels that would cover others are left out and counted. Equal input gives equal bytes.
    """
    spec = layout.spec
    plate = layout.plates[number - 1]
    title = f"plate {number} of {len(layout.plates)}: {with_count(len(plate), 'objects')}, {spec.text}"
    every = [placed.item for objects in layout.plates for placed in objects]
    labels = sorted({item.label for item in every})
    ids = Counter(item.id for item in every)
    # More pixels for a larger plate, so that there is room for labels.
    longer_px = min(max(_LONGER_SIDE_PX, _MIN_PX_PER_MM * max(spec.sides_mm)), _LONGEST_SIDE_PX)
    scale = longer_px / max(spec.sides_mm)
    width_px, depth_px = (round(side * scale) for side in spec.sides_mm)
    sheet_px = max(width_px, round(pictures.Pen.text_size(title, _TITLE_PX)[0])) + 2 * _EDGE_PX
    picture = Image.new("RGB", (sheet_px, depth_px + 2 * _EDGE_PX), sheets.PAPER)
    chart = _Chart(pictures.Pen(picture), scale, depth_px)
    _draw_plate(chart, spec, sheets.bar_length_mm(longer_px / _LINES, scale))
    for placed in plate:
        _draw_object(chart, placed, _FILLS[labels.index(placed.item.label) % len(_FILLS)])
    missing = len(plate) - _draw_words(chart, plate, ids)
    words = "front; numbers are mm"
    if missing:
        words += f"; {missing:,} without words, for want of space: plates.csv lists them"
    foot_px = depth_px + 2 * _EDGE_PX - 20
    chart.pen.write((_EDGE_PX, foot_px), words, _NUMBER_PX, anchor="ls")
    chart.pen.write((_EDGE_PX, _EDGE_PX - 28), title, _TITLE_PX, anchor="ls")
    return encode_png(picture.reduce(_FINER))


@dataclass(frozen=True, slots=True)
class _Chart:
    """A picture to draw on, and the positions of points of the plate in it."""

    pen: pictures.Pen
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
            ends_mm[:, axis] = at_mm
            ends_mm[1, 1 - axis] = spec.sides_mm[1 - axis]
            chart.pen.line(chart.at(ends_mm), _GRID, 2)
            x, y = np.add(chart.at(ends_mm)[0], aside_px).tolist()
            chart.pen.write((x, y), f"{at_mm:g}", _NUMBER_PX, anchor=anchor)
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
        sides_px = max(pictures.Pen.text_size(line, _WORD_PX)[0] for line in lines), len(lines) * _LINE_PX
        box = np.array([middle - np.divide(sides_px, 2), middle + np.divide(sides_px, 2)])
        if any((box[1] >= taken_box[0]).all() and (box[0] <= taken_box[1]).all() for taken_box in taken):
            continue
        taken.append(box)
        for row, line in enumerate(lines):
            at_px = (float(middle[0]), float(box[0, 1]) + (row + 0.5) * _LINE_PX)
            chart.pen.write(at_px, line, _WORD_PX, anchor="mm", halo_px=4)
    return len(taken)
