"""Packing objects on build plates in rows of bounding boxes.

Objects are moved, not rotated. They are placed from the deepest to the shallowest, each in the first row with
room for it; a row is as deep as its first object. Slicers can arrange plates more tightly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tactile_toolkit import mesh
from tactile_toolkit.array_types import Float64
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.printing.file_export import (
    FailedExport,
    PrintObject,
    Progress,
    place_on_plate,
    require_scale,
)
from tactile_toolkit.printing.print_options import Physics, PlateSpec

if TYPE_CHECKING:
    import manifold3d

# Objects as wide as the plate fit, despite rounding.
_ROUNDING_MM = 1e-6


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
        sizes_mm = ([np.add(each.outline.size_mm, gap_mm) for each in plate] for plate in self.plates)
        return tuple(float(np.prod(each, axis=1).sum() / whole_mm2) for each in sizes_mm)


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
    pieces, failures = [], []
    for done, item in enumerate(objects, 1):
        try:
            pieces.append(_measured(item, spec, scale))
        except ItemError as error:
            failures.append(FailedExport(item.name, error.reason, f"{error}; it was left out"))
        on_progress(done, len(objects))
    plates = tuple(_centred(plate, spec) for plate in _in_rows(pieces, spec))
    return PlateLayout(spec, scale, plates, tuple(failures), physics)


def _measured(item: PrintObject, spec: PlateSpec, scale: float) -> PlacedObject:
    verdict = mesh.require_solid(place_on_plate(item.load(), scale))
    outline = Outline.of(verdict.manifold)
    width_mm, depth_mm = outline.size_mm
    if _Plate(spec).place(width_mm, depth_mm) is None:
        margins, remedy = "", "--scale"
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
    for piece in sorted(pieces, key=lambda each: each.outline.size_mm[::-1], reverse=True):
        for plate, held in [*plates, (_Plate(spec), [])]:
            place = plate.place(*piece.outline.size_mm)
            if place is None:
                continue
            if not held:
                plates.append((plate, held))
            held.append(replace(piece, x_mm=place[0], y_mm=place[1]))
            break
    return [held for _, held in plates]


def _centred(plate: Sequence[PlacedObject], spec: PlateSpec) -> tuple[PlacedObject, ...]:
    """Centre the objects of a plate, where the bed is flattest and most evenly warm."""
    low_mm = np.array([(each.x_mm, each.y_mm) for each in plate])
    high_mm = low_mm + [each.outline.size_mm for each in plate]
    moved_mm = low_mm + (np.array(spec.sides_mm) - low_mm.min(axis=0) - high_mm.max(axis=0)) / 2
    if any(spec.corner_mm) and (moved_mm < np.add(spec.corner_mm, spec.margin_mm)).all(axis=1).any():
        moved_mm = low_mm
    placed = [
        replace(each, x_mm=x_mm, y_mm=y_mm)
        for each, (x_mm, y_mm) in zip(plate, moved_mm.tolist(), strict=True)
    ]
    return tuple(sorted(placed, key=lambda each: (each.y_mm, each.x_mm)))
