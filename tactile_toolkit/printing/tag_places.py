"""Where a tag lies: nearer to its own object than to any other, where it makes both least larger."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from scipy.signal import correlate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tactile_toolkit.printing.outlines import Outline
    from tactile_toolkit.printing.plate_spec import PlateSpec

__all__ = ["place_tag"]

Point: TypeAlias = "NDArray[np.float64]"

_FIRST, _SPREAD = 60, 240
"""Places tried of a list: so many of its best ones, and so many from all over the rest."""
_FOUND = 24
"""The best of so many is taken."""
_STEPS = 12
_EXACT_MM = 1e-6


def place_tag(outline: Outline, tag: Outline, spec: PlateSpec) -> tuple[float, float] | None:
    """Find a place for a tag at just its distance from its object.

    Others keep a whole gap from both, so the tag is nearest to its own object whatever the gap.

    Parameters
    ----------
    outline : Outline
        Of the object.
    tag : Outline
        An upright rectangle.
    spec : PlateSpec
        The plate, on which both together have to fit.

    Returns
    -------
    tuple of float, or None
        Lower left corner of the tag, mm from that of the object; None where no place was found.
    """
    body = _Body(outline, tag, spec)
    found: list[tuple[tuple[float, float], Point]] = []
    for places in (*_places_on_grid(outline, tag, spec), _places_at_sides(outline, tag, spec)):
        settled = (body.settled(place) for place in places)
        fitting = (place for place in settled if place is not None)
        found += ((body.cost(place), place) for place in itertools.islice(fitting, _FOUND))
        if found:
            _, best = min(found, key=lambda entry: entry[0])
            return float(best[0]), float(best[1])
    return None


class _Body:
    """An object that a tag is slid up to."""

    def __init__(self, outline: Outline, tag: Outline, spec: PlateSpec) -> None:
        self._size = np.array(outline.size_mm)
        self._tag = np.array(tag.size_mm)
        self._room = np.array([spec.width_mm, spec.depth_mm]) + _EXACT_MM
        self._apart_mm = spec.tag_gap_mm + _EXACT_MM
        self._section, self._tag_section = outline.grown(0.0), tag.grown(0.0)
        self._starts = np.concatenate(outline.rings)
        self._steps = np.concatenate([np.roll(ring, -1, axis=0) - ring for ring in outline.rings])
        self._squares = np.maximum((self._steps**2).sum(axis=1), 1e-18)

    def settled(self, place: Point) -> Point | None:
        """Slide a tag along the shortest way until it is at its distance; None where it cannot be."""
        for _ in range(_STEPS):
            way = self._way(place)
            distance_mm = float(np.hypot(*way))
            if distance_mm < _EXACT_MM:
                return None
            if abs(distance_mm - self._apart_mm) < _EXACT_MM / 2:
                return place if self._fits(place) and self._is_beside(place) else None
            place = place + way * (1 - self._apart_mm / distance_mm)
        return None

    def cost(self, place: Point) -> tuple[float, float]:
        """Return what object and tag need together, then how far the tag is from the middle."""
        middle = place + (self._tag - self._size) / 2
        # Rounded: no choice hangs on the last bits.
        return round(float(np.prod(self._extent(place))), 3), round(float(middle @ middle), 3)

    def _extent(self, place: Point) -> Point:
        return np.asarray(np.maximum(self._size, place + self._tag) - np.minimum(0.0, place))

    def _fits(self, place: Point) -> bool:
        return bool((self._extent(place) <= self._room).all())

    def _is_beside(self, place: Point) -> bool:
        return bool((self._section ^ self._tag_section.translate(tuple(place))).is_empty())

    def _way(self, low: Point) -> Point:
        """Return the shortest way from the tag's rim to the object's: corner to edge on one or the other."""
        high = low + self._tag
        to_corners = self._starts - np.clip(self._starts, low, high)
        corners = np.array([low, (low[0], high[1]), (high[0], low[1]), high])[:, None]
        share = ((corners - self._starts) * self._steps).sum(axis=2) / self._squares
        to_edges = self._starts + np.clip(share, 0, 1)[..., None] * self._steps - corners
        ways = np.concatenate([to_corners, to_edges.reshape(-1, 2)])
        return np.asarray(ways[np.argmin((ways**2).sum(axis=1))])


def _places_on_grid(outline: Outline, tag: Outline, spec: PlateSpec) -> Iterator[Iterator[Point]]:
    """Give places about a gap from the object, then all others that are clear of it."""
    grid = spec.grid
    # Cells alone cannot tell what lies between touching and a whole gap apart.
    clear = ~_touching(grid.cells_of(outline, 0.0), grid.cells_of(tag, 0.0))
    near = _touching(grid.cells_of(outline), grid.cells_of(tag))
    for free in (clear & near, clear & ~near):
        yield _sampled(_ranked(free, outline, tag, spec))


def _places_at_sides(outline: Outline, tag: Outline, spec: PlateSpec) -> Iterator[Point]:
    """Give places beside the bounding box: where a plate is hardly larger, cells are too coarse."""
    size, small = np.array(outline.size_mm), np.array(tag.size_mm)
    for axis, share in itertools.product((1, 0), (0.5, 0.0, 1.0)):
        for across in (-small[axis] - spec.tag_gap_mm, size[axis] + spec.tag_gap_mm):
            place = share * (size - small)
            place[axis] = across
            yield place


def _ranked(free: NDArray[np.bool_], outline: Outline, tag: Outline, spec: PlateSpec) -> NDArray[np.float64]:
    """List places by how little larger they make the piece, then from the middle outwards."""
    grid = spec.grid
    rows = grid.cells_of(tag).shape
    place = (np.argwhere(free) - rows)[:, ::-1] * np.array(grid.cell_mm)
    size, small = np.array(outline.size_mm), np.array(tag.size_mm)
    extent = np.maximum(size, place + small) - np.minimum(0.0, place)
    away = ((place + (small - size) / 2) ** 2).sum(axis=1)
    order = np.lexsort((away.round(3), extent.prod(axis=1).round(3)))
    # A tag may still slide by a gap.
    fits = (extent <= np.array([spec.width_mm, spec.depth_mm]) + spec.gap_mm).all(axis=1)
    return np.asarray(place[order[fits[order]]])


def _sampled(places: NDArray[np.float64]) -> Iterator[Point]:
    yield from places[:_FIRST]
    rest = places[_FIRST:]
    yield from rest[:: max(1, len(rest) // _SPREAD)]


def _touching(cells: NDArray[np.bool_], small: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tell where a small shape shares cells with another one.

    Returns
    -------
    ndarray of bool
        One entry per place of the small shape, from the one that ends before the other's first cell on.
    """
    around = np.pad(cells, [(side, side) for side in small.shape])
    return np.asarray(np.rint(correlate(around.astype(float), small.astype(float), "valid", "fft")) > 0)
