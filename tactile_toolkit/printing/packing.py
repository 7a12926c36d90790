"""Packing shapes of cells onto as few plates as a patient greedy search finds.

Plates are filled one after another. At each step every shape that is left (or the largest of them) is tried
at every place of the plate, by correlation in the frequency domain, and the one that lies most snugly is put
down: by the share of its rim that is taken already, and a bonus for large shapes, which only get harder to
place. Shapes are moved by whole cells and never turned.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import fft, ndimage

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Spot", "Temper", "pack"]

Cells = "NDArray[np.bool_]"
Spectrum = "NDArray[np.complex64]"


@dataclass(frozen=True, slots=True, order=True)
class Spot:
    """Where a shape was put.

    Attributes
    ----------
    shape : int
        Its number in the order given.
    row, column : int
        Cell of the plate on which its first cell lies.
    """

    shape: int
    row: int
    column: int


@dataclass(frozen=True, slots=True)
class Temper:
    """What the search prefers. Found by trial on the digits of ``printed_test``.

    Attributes
    ----------
    rim_cells : int
        How far around a shape neighbours count as touching. A wide rim also fills bays.
    front : float
        Dislike of places far from the front edge.
    large : float
        Bonus of the largest shape.
    """

    rim_cells: int = 12
    front: float = 0.1
    large: float = 0.3


TEMPERS = (Temper(), Temper(12, 0.05, 0.6), Temper(8, 0.2, 0.3))
_TRIED_AT_ONCE = 100
_MOST_FOR_ALL_TEMPERS = 150


@dataclass(frozen=True, slots=True, eq=False)
class _Shape:
    number: int
    cells: NDArray[np.bool_]
    area: int
    rim_area: int
    body_spectrum: NDArray[np.complex64]
    rim_spectrum: NDArray[np.complex64]


def pack(
    shapes: Sequence[NDArray[np.bool_]],
    plate: tuple[int, int],
    least_plates: int = 1,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> list[list[Spot]]:
    """Put every shape on a plate, none on another's cells.

    Parameters
    ----------
    shapes : sequence of ndarray of bool
        Cells that each needs; none larger than the plate.
    plate : tuple of int
        Rows and columns of a plate.
    least_plates : int
        Known lower bound: the search ends when it is reached.
    on_progress : callable
        Told shapes placed and in all, over all attempts.

    Returns
    -------
    list of list of Spot
        One list per plate; the same input always gives the same list.
    """
    tempers = TEMPERS if len(shapes) <= _MOST_FOR_ALL_TEMPERS else TEMPERS[:1]
    best: list[list[Spot]] = []
    for attempt, temper in enumerate(tempers):
        tell = _Teller(on_progress, attempt * len(shapes), len(tempers) * len(shapes))
        found = _attempt(shapes, plate, temper, tell)
        best = min(best or found, found, key=lambda plates: _cost(plates, shapes))
        if len(best) <= least_plates:
            break
    on_progress(len(tempers) * len(shapes), len(tempers) * len(shapes))
    return best


def _cells(spots: Sequence[Spot], shapes: Sequence[NDArray[np.bool_]]) -> int:
    return int(sum(shapes[spot.shape].sum() for spot in spots))


def _largest_first(numbers: Iterable[int], shapes: Sequence[NDArray[np.bool_]]) -> list[int]:
    return sorted(numbers, key=lambda number: (-int(shapes[number].sum()), number))


@dataclass(slots=True)
class _Teller:
    on_progress: Callable[[int, int], None]
    done: int
    total: int

    def placed(self) -> None:
        self.done += 1
        self.on_progress(self.done, self.total)


def _cost(plates: list[list[Spot]], shapes: Sequence[NDArray[np.bool_]]) -> tuple[int, int]:
    """Count plates, then cells on the last one."""
    return len(plates), sum(_cells(plate, shapes) for plate in plates[-1:])


def _attempt(
    shapes: Sequence[NDArray[np.bool_]], plate: tuple[int, int], temper: Temper, tell: _Teller
) -> list[list[Spot]]:
    left = _largest_first(range(len(shapes)), shapes)
    largest = int(shapes[left[0]].sum()) if left else 0
    plates = []
    while left:
        filling = _Filling(plate, temper, largest)
        plates.append(_fill(filling, left, shapes, tell.placed))
        done = {spot.shape for spot in plates[-1]}
        left = [number for number in left if number not in done]
    return plates


def _fill(
    filling: _Filling,
    left: Sequence[int],
    shapes: Sequence[NDArray[np.bool_]],
    tell: Callable[[], None],
) -> list[Spot]:
    waiting = list(left)
    tried: list[_Shape] = []
    spots: list[Spot] = []
    while waiting or tried:
        while waiting and len(tried) < _TRIED_AT_ONCE:
            tried.append(filling.prepare(waiting[0], shapes[waiting.pop(0)]))
        best, tried = filling.best_of(tried)
        if best is not None:
            filling.put(best, shapes[best.shape])
            tried = [shape for shape in tried if shape.number != best.shape]
            spots.append(best)
            tell()
    return spots


class _Filling:
    """One plate while it is filled."""

    def __init__(self, plate: tuple[int, int], temper: Temper, largest: int) -> None:
        rim = temper.rim_cells
        self._plate = plate
        self._temper = temper
        self._largest = largest
        self._free = plate[0] * plate[1]
        # The edge counts as a neighbour: what lies against it wastes nothing.
        self._taken = np.pad(np.zeros(plate, np.float32), rim, constant_values=1)
        rows, columns = self._taken.shape
        self._size = (fft.next_fast_len(rows, real=True), fft.next_fast_len(columns, real=True))
        self._spectrum = fft.rfft2(self._taken, self._size)

    def prepare(self, number: int, cells: NDArray[np.bool_]) -> _Shape:
        """Transform a shape and its rim."""
        body = np.pad(cells, self._temper.rim_cells)
        near = ndimage.distance_transform_cdt(~body, "taxicab") <= self._temper.rim_cells
        rim = near & ~body
        spectra = (
            np.conj(fft.rfft2(part.astype(np.float32), self._size)).astype(np.complex64)
            for part in (body, rim)
        )
        return _Shape(number, cells, int(cells.sum()), int(rim.sum()), *spectra)

    def best_of(self, tried: list[_Shape]) -> tuple[Spot | None, list[_Shape]]:
        """Return the best shape and place, and the shapes that still have a place."""
        best: tuple[float, Spot] | None = None
        fitting = []
        for shape in tried:
            found = self._best_place(shape)
            if found is None:
                continue
            fitting.append(shape)
            if best is None or found[0] > best[0]:
                best = found
        return (None if best is None else best[1]), fitting

    def put(self, spot: Spot, cells: NDArray[np.bool_]) -> None:
        """Take the cells of a shape."""
        rim = self._temper.rim_cells
        rows, columns = cells.shape
        view = self._taken[rim + spot.row :, rim + spot.column :][:rows, :columns]
        view += cells
        self._free -= int(cells.sum())
        self._spectrum = fft.rfft2(self._taken, self._size)

    def _best_place(self, shape: _Shape) -> tuple[float, Spot] | None:
        if shape.area > self._free:
            return None
        free = self._counts(shape.body_spectrum, shape) == 0
        if not free.any():
            return None
        snug = self._counts(shape.rim_spectrum, shape) / np.float32(shape.rim_area)
        score = np.where(free, snug - self._distance(shape), -np.inf)
        row, column = divmod(int(score.argmax()), score.shape[1])
        bonus = self._temper.large * shape.area / self._largest
        return float(score[row, column]) + bonus, Spot(shape.number, row, column)

    def _counts(self, spectrum: NDArray[np.complex64], shape: _Shape) -> NDArray[np.float32]:
        """Count taken cells under a shape or its rim, for every place of the shape."""
        rows, columns = (side - cells + 1 for side, cells in zip(self._plate, shape.cells.shape, strict=True))
        counts = fft.irfft2(self._spectrum * spectrum, self._size)[:rows, :columns]
        # Whole numbers again: places do not hang on the last bits of a transform.
        return np.asarray(np.rint(counts), np.float32)

    def _distance(self, shape: _Shape) -> NDArray[np.float32]:
        rows, columns = (
            np.arange(side - cells + 1, dtype=np.float32)
            for side, cells in zip(self._plate, shape.cells.shape, strict=True)
        )
        away = rows[:, None] / np.float32(self._plate[0]) + 0.1 * columns / np.float32(self._plate[1])
        return np.asarray(self._temper.front * away, np.float32)
