"""What lies where on build plates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.mesh.solid_check import require_solid
from tactile_toolkit.printing.checked import Failure, Progress
from tactile_toolkit.printing.objects import require_scale, standing
from tactile_toolkit.printing.packing import Outline, PlateSpec, outline_of, pack

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tactile_toolkit.printing.objects import PrintObject
    from tactile_toolkit.printing.simulator import Physics


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """An object made ready for packing, and where it lies on its plate.

    It needs ``cells`` of a plate, shape (rows, columns), those among its parts too, and an area: that of the
    outline grown by half the gap. ``x_mm`` and ``y_mm`` are the lower left corner of its bounding box, from
    the front left corner of the plate; 0 until it is packed.
    """

    item: PrintObject
    outline: Outline
    height_mm: float
    volume_mm3: float
    cells: NDArray[np.bool_]
    area_mm2: float
    x_mm: float = 0.0
    y_mm: float = 0.0

    @property
    def offset_mm(self) -> tuple[float, float, float]:
        """How the object moves from where it is stored; z = 0 is its lowest point already."""
        return self.x_mm - self.outline.low_mm[0], self.y_mm - self.outline.low_mm[1], 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Objects made ready for packing, in their order, and what lies on each plate, from front to back.

    ``failures`` are those that are not solids and were left out. No packing needs fewer than
    ``least_plates``: the area that all need, over that of a plate. There are no plates until it is packed.
    """

    spec: PlateSpec
    scale: float
    pieces: tuple[Placed, ...]
    failures: tuple[Failure, ...]
    plates: tuple[tuple[Placed, ...], ...] = ()
    least_plates: int = 0
    physics: Physics | None = None

    @property
    def shares(self) -> tuple[float, ...]:
        """Shares of each plate that are needed, counted as ``least_plates`` is."""
        return tuple(sum(each.area_mm2 for each in plate) / self.spec.area_mm2 for plate in self.plates)


def measure(
    objects: Sequence[PrintObject],
    spec: PlateSpec,
    scale: float = 1.0,
    on_progress: Progress = lambda _done, _total: None,
) -> Layout:
    """Take the outline of every object; ``scale`` is a factor on all lengths.

    Raises InputError where an object is larger than a plate, or the scale is not positive.
    """
    require_scale(scale)
    pieces, failures = [], []
    for done, item in enumerate(objects, 1):
        try:
            pieces.append(_piece(item, spec, scale))
        except ItemError as error:
            failures.append(Failure(item.name, error.reason, f"{error}; it was left out"))
        on_progress(done, len(objects))
    return Layout(spec, scale, tuple(pieces), tuple(failures))


def _piece(item: PrintObject, spec: PlateSpec, scale: float) -> Placed:
    verdict = require_solid(standing(item.load(), scale))
    outline = outline_of(verdict.manifold)
    width_mm, depth_mm = outline.size_mm
    # Outlines as wide as the plate fit, whatever their last bits.
    if width_mm > spec.inner_mm[0] + 1e-6 or depth_mm > spec.inner_mm[1] + 1e-6:
        margins = f" less {spec.margin_mm:g} mm at each edge" if spec.margin_mm else ""
        raise InputError(
            f"{item.name} does not fit on the plate: it needs {width_mm:.1f} x {depth_mm:.1f} mm, the plate "
            f"has {spec.width_mm:g} x {spec.depth_mm:g} mm{margins}; nothing was written",
            next=f"a larger --plate, a smaller {'--margin-mm or ' if margins else ''}--scale, or other --ids",
        )
    box = verdict.manifold.bounding_box()
    claimed = outline.claimed()
    area_mm2 = float(claimed.grown(spec.gap_mm / 2).area())
    height_mm = float(box[5] - box[2])
    return Placed(item, outline, height_mm, verdict.volume_mm3, spec.cells_of(claimed), area_mm2)


def arrange(measured: Layout, on_progress: Progress = lambda _done, _total: None) -> Layout:
    """Find a place for every object on few plates; objects are moved, never turned.

    What lies on a plate is in its middle. The same input gives the same layout; progress counts objects
    placed over all attempts.
    """
    spec, pieces = measured.spec, measured.pieces
    # Plates that are filled to the last bit are not one more.
    least = math.ceil(sum(piece.area_mm2 for piece in pieces) / spec.area_mm2 - 1e-9)
    packed = pack([piece.cells for piece in pieces], spec.cells, least, on_progress)
    cell_width_mm, cell_depth_mm = spec.cell_mm
    plates = []
    for spots in packed:
        corners_mm = np.array([(spot.column * cell_width_mm, spot.row * cell_depth_mm) for spot in spots])
        sizes_mm = np.array([pieces[spot.shape].outline.size_mm for spot in spots])
        # What lies there is moved to the middle: the bed is flattest and most evenly warm there.
        reach_mm = corners_mm.min(axis=0) + (corners_mm + sizes_mm).max(axis=0)
        corners_mm += (np.array(spec.sides_mm) - reach_mm) / 2
        placed = [
            replace(pieces[spot.shape], x_mm=x_mm, y_mm=y_mm)
            for spot, (x_mm, y_mm) in zip(spots, corners_mm.tolist(), strict=True)
        ]
        plates.append(tuple(sorted(placed, key=lambda each: (each.y_mm, each.x_mm))))
    return replace(measured, plates=tuple(plates), least_plates=least)
