"""What objects cover of a build plate, and packing them onto as few plates as a patient greedy search finds.

Plates are divided into cells. Plates are filled one after another: at each step every shape that is left (or
the largest of them) is tried at every position of the plate, by correlation in the frequency domain, and the
one with the best contact score is put down: the share of its rim that is taken already, and a bonus for large
shapes, which only get harder to place. Shapes are moved by whole cells and never turned.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy import fft, ndimage

from tactile_toolkit import mesh
from tactile_toolkit.array_types import Bool, Float64
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.printing.objects import Failure, PrintObject, Progress, place_on_plate, require_scale
from tactile_toolkit.printing.spec import Physics, PlateSpec

if TYPE_CHECKING:
    from numpy.typing import NDArray


Rings = Sequence["Float64"]

_ARC_SEGMENTS = 64
_SAMPLES_PER_CELL = 8  # steps along an edge: it cannot pass through a cell unseen but at a corner


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """What an object covers of the plate, its lower left corner at the origin.

    ``section`` is a manifold3d.CrossSection in mm; ``low_mm`` is where the lower left corner is in the
    object's own frame.
    """

    section: Any
    low_mm: tuple[float, float]

    @property
    def rings(self) -> list[Float64]:
        """Closed lines around it, shape (n, 2) each, mm; holes are turned the other way round."""
        return [np.asarray(ring, np.float64) for ring in self.section.to_polygons()]

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and depth."""
        left, front, right, back = self.section.bounds()
        return right - left, back - front

    def footprint(self) -> Outline:
        """Return what no other object may enter: of one part, the outline; of several, their convex hull.

        Parts that stand alone could not be distinguished from those of another object that stands among them.
        """
        return self if len(self.section.decompose()) <= 1 else replace(self, section=self.section.hull())

    def grown(self, by_mm: float) -> Any:
        """Return everything within a distance of the outline, a manifold3d.CrossSection."""
        import manifold3d

        # Arcs become chords, which lie inside them: the polygon is drawn around the arc instead.
        around_mm = by_mm / math.cos(math.pi / _ARC_SEGMENTS)
        return self.section.offset(around_mm, manifold3d.JoinType.Round, circular_segments=_ARC_SEGMENTS)


def outline_of(manifold: Any) -> Outline:
    """Return what a solid, a manifold3d.Manifold in mm, covers of the plate."""
    section = manifold.project()
    left, front, _, _ = section.bounds()
    return Outline(section.translate((-left, -front)), (left, front))


def cells_of(spec: PlateSpec, outline: Outline) -> Bool:
    """Return the cells that an outline needs, shape (rows, columns).

    The first cell begins half a gap left of and below the outline's lower left corner.
    """
    cell_mm = np.array(spec.cell_mm)
    columns, rows = (
        # Less a little: an object as large as the plate must not need one cell more than the plate has.
        math.ceil((side_mm + spec.gap_mm) / side_of_cell_mm - 1e-6)
        for side_mm, side_of_cell_mm in zip(outline.size_mm, spec.cell_mm, strict=True)
    )
    # Sampled edges may cut the corner of a cell unseen; growing by half a step makes up for it.
    slack_mm = float(cell_mm.max()) / _SAMPLES_PER_CELL / 2
    rings = outline.grown(spec.gap_mm / 2 + slack_mm).to_polygons()
    return cells_touched([(np.asarray(ring) + spec.gap_mm / 2) / cell_mm for ring in rings], (rows, columns))


def cells_touched(rings: Rings, shape: tuple[int, int]) -> Bool:
    """Return the cells, shape (rows, columns), whose middle is inside polygons or that an edge runs through.

    Rings are closed, in units of cells, x then y, holes turned the other way round; what lies outside of
    ``shape`` is cut off. A corner cut by less than an eighth of a cell may be missed.
    """
    import manifold3d

    starts = np.concatenate(list(rings))
    # The middle of the first cell is at 0.5, that of the first pixel at 0.
    corners = np.vstack([starts.T - 0.5, np.zeros(len(starts))])
    cells = np.isfinite(mesh.highest_values(corners, manifold3d.triangulate([*rings]), shape))
    steps = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings]) - starts
    count = np.maximum(np.ceil(np.linalg.norm(steps, axis=1) * _SAMPLES_PER_CELL).astype(int), 1)
    edge = np.repeat(np.arange(len(count)), count)
    share = mesh.positions_in_runs(count) / count[edge]
    column, row = np.floor(starts[edge] + share[:, None] * steps[edge]).astype(int).T
    inside = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
    cells[row[inside], column[inside]] = True
    return cells


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
    cells: Bool
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
    verdict = mesh.require_solid(place_on_plate(item.load(), scale))
    outline = outline_of(verdict.manifold)
    width_mm, depth_mm = outline.size_mm
    footprint = outline.footprint()
    # Outlines as wide as the plate fit, whatever their last bits.
    fits = width_mm <= spec.inner_mm[0] + 1e-6 and depth_mm <= spec.inner_mm[1] + 1e-6
    cells = cells_of(spec, footprint) if fits else np.zeros((0, 0), np.bool_)
    if not (fits and _fits_corner(spec, cells)):
        margins = f" less {spec.margin_mm:g} mm at each edge" if spec.margin_mm else ""
        if any(spec.corner_mm):
            margins += f" and {spec.corner_mm[0]:g} x {spec.corner_mm[1]:g} mm in a corner"
        raise InputError(
            f"{item.name} does not fit on the plate: it needs {width_mm:.1f} x {depth_mm:.1f} mm, the plate "
            f"has {spec.width_mm:g} x {spec.depth_mm:g} mm{margins}; nothing was written",
            next=f"a larger --plate, a smaller {'--margin-mm or ' if margins else ''}--scale, or other --ids",
        )
    box = verdict.manifold.bounding_box()
    area_mm2 = float(footprint.grown(spec.gap_mm / 2).area())
    height_mm = float(box[5] - box[2])
    return Placed(item, outline, height_mm, verdict.volume_mm3, cells, area_mm2)


def _fits_corner(spec: PlateSpec, cells: Bool) -> bool:
    """Return whether an object that is no larger than a plate fits on it, for all the corner."""
    beside = np.subtract(spec.cells, spec.corner_cells)
    return bool((cells.shape <= beside).any()) or any(
        _fill(spec.cells, spec.corner_cells, [cells], [0], 0.0, [0.0])
    )


def arrange(measured: Layout, on_progress: Progress = lambda _done, _total: None) -> Layout:
    """Find a place for every object on few plates; objects are moved, never turned.

    What lies on a plate is in its middle. The same input gives the same layout; progress counts objects
    placed over all attempts.
    """
    spec, pieces = measured.spec, measured.pieces
    # Plates that are filled to the last bit are not one more.
    least = math.ceil(sum(piece.area_mm2 for piece in pieces) / spec.area_mm2 - 1e-9)
    packed = pack([piece.cells for piece in pieces], spec.cells, least, on_progress, spec.corner_cells)
    cell_width_mm, cell_depth_mm = spec.cell_mm
    plates = []
    for spots in packed:
        corners_mm = np.array([(spot.column * cell_width_mm, spot.row * cell_depth_mm) for spot in spots])
        sizes_mm = np.array([pieces[spot.shape].outline.size_mm for spot in spots])
        # What lies there is moved to the middle: the bed is flattest and most evenly warm there.
        reach_mm = corners_mm.min(axis=0) + (corners_mm + sizes_mm).max(axis=0)
        middle_mm = corners_mm + (np.array(spec.sides_mm) - reach_mm) / 2
        placed = [
            _at(pieces[spot.shape], *place) for spot, place in zip(spots, middle_mm.tolist(), strict=True)
        ]
        if any(spec.corner_mm) and any(_is_in_corner(each, spec) for each in placed):
            corners_mm += spec.margin_mm
            placed = [
                _at(pieces[spot.shape], *place)
                for spot, place in zip(spots, corners_mm.tolist(), strict=True)
            ]
        plates.append(tuple(sorted(placed, key=lambda each: (each.y_mm, each.x_mm))))
    return replace(measured, plates=tuple(plates), least_plates=least)


def _at(piece: Placed, x_mm: float, y_mm: float) -> Placed:
    return replace(piece, x_mm=x_mm, y_mm=y_mm)


def _is_in_corner(placed: Placed, spec: PlateSpec) -> bool:
    """Return whether an object is nearer to the corner that a printer cannot use than the margin."""
    import manifold3d

    corner = manifold3d.CrossSection.square(np.add(spec.corner_mm, spec.margin_mm).tolist())
    section = placed.outline.footprint().section.translate((placed.x_mm, placed.y_mm))
    return not (section ^ corner).is_empty()


class Spot(NamedTuple):
    """Where a shape was put: its number in the order given, and the cell on which its first cell lies."""

    shape: int
    row: int
    column: int


# Dislike of positions far from the front edge, and the bonus of the largest shape, found by trial on the
# digits of ``printed_test``. Of some sets the second needs a plate less.
_TRIED_WEIGHTS = ((0.1, 0.3), (0.05, 0.6))
# How far around a shape neighbours count as touching. A wide rim also fills bays.
_RIM_CELLS = 12
# The time of a search grows with the square of the number of shapes: many are searched once, and only so many
# of the largest are tried at each step.
_MOST_SHAPES_FOR_ALL_WEIGHTS = 150
_TRIED_AT_ONCE = 100


def pack(
    shapes: Sequence[Bool],
    plate: tuple[int, int],
    least_plates: int = 1,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
    corner: tuple[int, int] = (0, 0),
) -> list[list[Spot]]:
    """Put every shape, none of which needs more than a plate, on a plate of so many rows and columns.

    No two have a cell in common, and none has one of so many first rows and columns in the ``corner``. The
    search ends when it reaches ``least_plates``, a known lower bound; progress counts shapes placed over all
    attempts. Returns one list per plate, the same for the same input.
    """
    attempts = _TRIED_WEIGHTS if len(shapes) <= _MOST_SHAPES_FOR_ALL_WEIGHTS else _TRIED_WEIGHTS[:1]
    total, done = len(attempts) * len(shapes), 0
    areas = [int(shape.sum()) for shape in shapes]
    largest_first = sorted(range(len(shapes)), key=lambda number: (-areas[number], number))
    found: list[list[list[Spot]]] = []
    for front, large in attempts:
        bonuses = [large * area / areas[largest_first[0]] for area in areas]
        left, plates = largest_first, list[list[Spot]]()
        while left:
            plates.append([])
            for spot in _fill(plate, corner, shapes, left, front, bonuses):
                plates[-1].append(spot)
                done += 1
                on_progress(done, total)
            placed = {spot.shape for spot in plates[-1]}
            left = [number for number in left if number not in placed]
        found.append(plates)
        if len(plates) <= least_plates:
            break
    on_progress(total, total)
    # Fewest plates, then fewest cells on the last one.
    return min(
        found,
        key=lambda plates: (len(plates), sum(areas[spot.shape] for last in plates[-1:] for spot in last)),
    )


def _fill(
    plate: tuple[int, int],
    corner: tuple[int, int],
    shapes: Sequence[Bool],
    numbers: Sequence[int],
    front: float,
    bonuses: Sequence[float],
) -> Iterator[Spot]:
    """Put down as many of the numbered shapes as have a position on one plate, and yield where."""
    # The edge counts as a neighbour: what lies against it wastes nothing.
    taken = np.pad(np.zeros(plate, np.float32), _RIM_CELLS, constant_values=1)
    taken[_RIM_CELLS:, _RIM_CELLS:][: corner[0], : corner[1]] = 1
    size = [fft.next_fast_len(side, real=True) for side in taken.shape]
    along_y, along_x = (np.arange(side, dtype=np.float32) / np.float32(side) for side in plate)
    # Ten times less for columns: plates fill up from the front.
    distance = np.asarray(front * (along_y[:, None] + 0.1 * along_x), np.float32)

    def transformed(number: int) -> tuple[list[NDArray[np.complex64]], np.float32]:
        body = np.pad(shapes[number], _RIM_CELLS)
        rim = (ndimage.distance_transform_cdt(~body, "taxicab") <= _RIM_CELLS) & ~body
        # Conjugate, for a correlation; a product of spectra as they are is a convolution.
        spectra = [np.conj(fft.rfft2(part.astype(np.float32), size)) for part in (body, rim)]
        return [spectrum.astype(np.complex64) for spectrum in spectra], np.float32(rim.sum())

    waiting = deque(numbers)
    tried: dict[int, tuple[list[NDArray[np.complex64]], np.float32]] = {}
    while waiting or tried:
        while waiting and len(tried) < _TRIED_AT_ONCE:
            number = waiting.popleft()
            tried[number] = transformed(number)
        spectrum = fft.rfft2(taken, size)
        scores: list[tuple[float, Spot]] = []
        for number, (spectra, rim_area) in tried.items():
            rows, columns = np.subtract(plate, shapes[number].shape) + 1
            # Integers again: the choice does not hang on the last bits of a transform.
            under, around = (
                np.asarray(np.rint(fft.irfft2(spectrum * each, size)[:rows, :columns]), np.float32)
                for each in spectra
            )
            score = np.where(under == 0, around / rim_area - distance[:rows, :columns], -np.inf)
            row, column = divmod(int(score.argmax()), int(columns))
            scores.append((float(score[row, column]) + bonuses[number], Spot(number, row, column)))
        # What has no position now will not find one later: the plate only gets fuller.
        fitting = [each for each in scores if each[0] > -np.inf]
        tried = {spot.shape: tried[spot.shape] for _, spot in fitting}
        if fitting:
            _, (number, row, column) = max(fitting, key=lambda each: each[0])
            del tried[number]
            rows, columns = shapes[number].shape
            taken[_RIM_CELLS + row :, _RIM_CELLS + column :][:rows, :columns] += shapes[number]
            yield Spot(number, row, column)
