"""Finds where touches without poses were.

A grid of turns and places is searched by normalised cross-correlation: first for slopes of the solid where
the image changes, then, once the clearest touches tell which colours stand for which slopes, for their
directions. Straight strokes look alike in many places: a touch counts if one place is better than all others.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from tactile_sim.sensor_models import SensorModel
from tactile_sim.twin.fitting import Fit, shrunk
from tactile_sim.twin.recordings import Recordings
from tactile_sim.twin.rounds_of_fit import set_levels, start_fit
from tactile_toolkit.array_types import Bool, Float32, Float64

_WIDTH_PX = 40  # of the images that are compared
_TURNS = 72
_APART_M, _APART_RAD = 2e-3, 0.3  # places that are closer than this are one
_SMOOTH_PX = 1.0
_ROUNDS = 3  # of directions of slopes
_CLEAREST = 0.15  # share of the touches that colours are taken from, for each round so far
_LIKELY, _CLEAR = 0.6, 0.03  # least correlation, and how far it is above that of any other place
_EMPTY = 1e-9

Maps: TypeAlias = list[Float64]


@dataclass(frozen=True, slots=True)
class _Place:
    """A place on a solid: x and y, metres, turn, and how well its slopes agree with an image."""

    x_m: float
    y_m: float
    turn_rad: float
    agreement: float


def matched_places(recordings: Recordings, start: SensorModel) -> tuple[Float64, Bool]:
    """Return points under the sensor with turns (N, 3), and which of them are likely (N,)."""
    fit = start_fit(recordings, np.zeros((len(recordings), 3)), None, start)
    fit.look(max(1, recordings.size_px[0] // _WIDTH_PX))
    changes = [_smooth(fit.image(each)[0] - fit.behind) for each in range(len(recordings))]
    wanted = [[np.linalg.norm(each, axis=-1)] for each in changes]
    wanted = [[each - each.mean()] for (each,) in wanted]
    best, margins = _search(fit, wanted, start, is_signed=False)
    for number in range(_ROUNDS):
        share = _CLEAREST * (1 + number)
        clear = np.flatnonzero(margins >= np.quantile(margins, 1 - share))
        for touch, place in enumerate(best):
            fit.poses[touch] = place.x_m, place.y_m, place.turn_rad, 0.0
        set_levels(fit, clear, start)
        slopes = np.concatenate([np.stack(_slopes_of(fit, int(each)), -1).reshape(-1, 2) for each in clear])
        shown = np.concatenate([changes[each].reshape(-1, 3) for each in clear])
        colours = np.linalg.lstsq(slopes, shown, rcond=None)[0]
        back = np.linalg.pinv(colours)
        wanted = [list(np.moveaxis(each @ back, -1, 0)) for each in changes]
        best, margins = _search(fit, wanted, start, is_signed=True)
    places = np.array([[each.x_m, each.y_m, each.turn_rad] for each in best])
    agreement = np.array([each.agreement for each in best])
    return places, (agreement >= _LIKELY) & (margins >= _CLEAR)


def _smooth(image: Float32) -> Float64:
    from scipy import ndimage  # takes a tenth of a second to import

    return np.asarray(ndimage.gaussian_filter(image.astype(np.float64), (_SMOOTH_PX, _SMOOTH_PX, 0)))


def _slopes_of(fit: Fit, touch: int) -> Maps:
    """Return the slopes of the solid down and across the image at the pose of a touch."""
    return _slopes(fit.indentation(touch, fit.poses[touch], fit.shape))


def _slopes(reached: Float64) -> Maps:
    from scipy import ndimage  # takes a tenth of a second to import

    return list(np.gradient(ndimage.gaussian_filter(reached, 1.5 * _SMOOTH_PX)))


def _search(
    fit: Fit, wanted: list[Maps], start: SensorModel, *, is_signed: bool
) -> tuple[list[_Place], Float64]:
    """Return the best place of each touch, and how far its agreement is above that of any other place."""
    ids = fit.recordings.object_ids
    found: list[list[_Place]] = [[] for _ in wanted]
    for key in fit.reliefs:
        for turn in np.arange(_TURNS) * (2 * np.pi / _TURNS):
            grid = _Grid.of(fit, key, float(turn), start)
            maps = grid.slopes if is_signed else [np.hypot(*grid.slopes)]
            energy = sum(grid.window_mean(each**2) for each in maps)
            if not is_signed:
                energy = energy - grid.window_mean(maps[0]) ** 2
            for touch in np.flatnonzero(ids == key):
                found[touch] += grid.best(maps, wanted[touch], np.asarray(energy))
    best, margins = [], []
    for places in found:
        places.sort(key=lambda each: -each.agreement)
        others = [each.agreement for each in places if not _alike(each, places[0])]
        best.append(places[0])
        margins.append(places[0].agreement - max(others, default=0.0))
    return best, np.array(margins)


def _alike(one: _Place, other: _Place) -> bool:
    turn = abs((one.turn_rad - other.turn_rad + np.pi) % (2 * np.pi) - np.pi)
    return bool(np.hypot(one.x_m - other.x_m, one.y_m - other.y_m) < _APART_M and turn < _APART_RAD)


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    """Slopes of a turned solid on the pixels of images that are shifted over it, of the size (H, W)."""

    slopes: Maps
    x_m: Float64
    y_m: Float64
    turn_rad: float
    size: tuple[int, int]

    @classmethod
    def of(cls, fit: Fit, key: int, turn: float, start: SensorModel) -> _Grid:
        """Press all of a solid into the gel, everywhere as deep as usual."""
        from scipy import ndimage  # takes a tenth of a second to import

        relief, pitch_m = fit.reliefs[key], float(fit.pitch_m(fit.shape).mean())
        small = shrunk(relief.heights_m, max(1, round(pitch_m / relief.corner[2])))
        sides_m = relief.corner[2:] * relief.heights_m.shape[::-1]
        middle_m = relief.corner[:2] + sides_m / 2
        reach = int(np.hypot(*sides_m) / pitch_m / 2)
        half_x, half_y = reach + fit.size[1] // 2, reach + fit.size[0] // 2
        # Rows of an image go down.
        down, across = np.mgrid[-half_y : half_y + 1, -half_x : half_x + 1] * pitch_m
        cosine, sine = np.cos(turn), np.sin(turn)
        x_m, y_m = cosine * across - sine * down, -sine * across - cosine * down
        per_m = np.array(small.shape[::-1]) / sides_m
        at = [y_m * per_m[1] + (small.shape[0] - 1) / 2, x_m * per_m[0] + (small.shape[1] - 1) / 2]
        heights = ndimage.map_coordinates(small.astype(np.float64), at, order=1)
        top = ndimage.maximum_filter(heights, fit.size)
        press_m = start.gel_mm / 1e3 - start.press_m
        slopes = _slopes(np.maximum(heights - (top - press_m), 0))
        return cls(slopes, middle_m[0] + x_m, middle_m[1] + y_m, turn, fit.size)

    def window_mean(self, values: Float64) -> Float64:
        """Return means over images around each place."""
        from scipy import ndimage  # takes a tenth of a second to import

        return np.asarray(ndimage.uniform_filter(values, self.size, mode="constant"))

    def best(self, maps: Maps, wanted: Maps, energy: Float64) -> list[_Place]:
        """Return the two best places of an image, by the correlation of its maps with those of the solid."""
        from scipy import signal  # takes a tenth of a second to import

        size = np.sqrt(sum(float((each**2).sum()) for each in wanted)) + _EMPTY
        score = sum(
            signal.fftconvolve(one, other[::-1, ::-1], mode="same")
            for one, other in zip(maps, wanted, strict=True)
        )
        least = 0.02 * float(energy.max())
        score = np.asarray(score) / np.sqrt(np.maximum(energy, least) * wanted[0].size) / size
        found = []
        for _ in range(2):
            row, column = (int(each) for each in np.unravel_index(int(np.argmax(score)), score.shape))
            place = float(self.x_m[row, column]), float(self.y_m[row, column])
            found.append(_Place(*place, self.turn_rad, float(score[row, column])))
            score[max(row - 4, 0) : row + 5, max(column - 4, 0) : column + 5] = -1
        return found
