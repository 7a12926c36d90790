"""Search a solid for poses that look like an image: a grid of turns, and all positions by correlation.

The whole solid is turned and pressed into the gel, everywhere to the usual depth. Sums of products over all
windows of the size of an image are computed by Fourier transforms. The image is compared with the one that
the solid would give (:func:`poses_by_images`) or, while the colours are unknown, with the mixture of the
slopes of the gel that explains it best (:func:`poses_by_slopes`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import scipy

from tactile_sim.twin import gel
from tactile_sim.twin.fitting import Fit
from tactile_sim.twin.recordings import shrunk
from tactile_toolkit.value_types import Bool, Float32, Float64

TURNS = 72
_SMOOTH_PX = 1.0
_PEAK_PX = 5
_PEAKS = 4  # that are kept of one turn
_MAX_POSES = 120
_APART_M, _APART_RAD = 8e-4, 0.15  # closer poses count as one
NEAR_M = 5e-3
"""Greatest distance from a stated pose at which a touch is searched, metres."""
_NEAR_RAD = 0.3  # greatest turn from it
_FAINT = 0.03  # of the strongest window: weaker ones, which show little of the solid, count less
_MIN_GAIN, _MAX_GAIN = 0.6, 1.6  # bounds of the strength of an image, relative to a rendered one

Changes: TypeAlias = Mapping[int, Float32]
"""How images differ from the gel at rest, (3, h, w), by the numbers of their touches."""

Paint: TypeAlias = Callable[[Float32, Float64], Float32]
"""Returns the change of an image (h, w, 3), from the surface of a gel (h, w) and the pixel size, metres."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseMatches:
    """Poses on a solid that look like one image, the best one first.

    ``at`` (n, 4) are x and y, metres, the turn, radians, and the press depth, metres. ``explained`` (n,) is
    the explained share of the change of the image. ``products`` (n, 2, 3) are the sums of products of slopes
    and image, and ``squares`` (n, 2, 2) those of slopes alone, both divided by the sum of squares of the
    change; zeros if slopes were not compared.
    """

    at: Float64
    explained: Float64
    products: Float64
    squares: Float64

    @property
    def margin(self) -> float:
        """Difference between the explained shares of the best pose and the next one."""
        best, *others = self.explained.tolist()
        return float(best - others[0]) if others else float(best)


@dataclass(frozen=True, slots=True, eq=False)
class _Turned:
    """A turned solid: the surface of the gel (R, C), and the centres and press depths of windows (r, c)."""

    surface: Float32
    x_m: Float64
    y_m: Float64
    press_m: Float64
    turn_rad: float

    def is_near(self, near: Float64 | None, touch: int) -> Bool | bool:
        """Return which windows are near the known pose of a touch; True if it is unknown."""
        if near is None or np.isnan(near[touch]).any():
            return True
        x_m, y_m, turn_rad = near[touch]
        turn = (self.turn_rad - turn_rad + np.pi) % (2 * np.pi) - np.pi
        if abs(turn) > _NEAR_RAD:
            return False
        return np.asarray(np.hypot(self.x_m - x_m, self.y_m - y_m) < NEAR_M)


def near_poses(poses: Float64, pose: Float64, apart: tuple[float, float] = (_APART_M, _APART_RAD)) -> Bool:
    """Return which poses (n, 3) are closer to a given one than a distance and a turn."""
    turn = np.abs((poses[:, 2] - pose[2] + np.pi) % (2 * np.pi) - np.pi)
    return np.asarray((np.hypot(*(poses[:, :2] - pose[:2]).T) < apart[0]) & (turn < apart[1]))


def changes_of(fit: Fit, touches: Iterable[int]) -> Changes:
    """Return how the images of touches differ from the gel at rest, smoothed."""
    changes = {}
    for touch in touches:
        change = _smooth(fit.image(touch)[0] - fit.behind)
        changes[touch] = np.ascontiguousarray(np.moveaxis(change, 2, 0), np.float32)
    return changes


def poses_by_slopes(
    fit: Fit, changes: Changes, press_m: float, near: Float64 | None
) -> dict[int, PoseMatches]:
    """Return the poses where slopes of the solids explain each image best, with any colours.

    ``near`` (N, 3) are the poses and turns near which each touch is searched; None if they are unknown.
    """
    candidates: dict[int, list[tuple[float, ...]]] = {touch: [] for touch in changes}
    for key, windows, spectra in _solids(fit, changes):
        for turned in _turns(fit, key, press_m):
            slopes = np.stack([*np.gradient(turned.surface, *fit.pitch_m(fit.shape)[::-1])])
            down, right = slopes
            squares = [windows.sums(product) for product in (down * down, down * right, right * right)]
            least = _FAINT * float((squares[0] + squares[2]).max())
            down_down = squares[0] + least
            down_right = squares[1]
            right_right = squares[2] + least
            spectrum = windows.spectrum(slopes)
            for touch, image in spectra.items():
                is_near = turned.is_near(near, touch)
                if not np.any(is_near):
                    continue
                products = windows.products(spectrum[:, None] * image)
                first, second = products
                total = right_right * first * first - 2 * down_right * first * second
                total = (total + down_down * second * second).sum(axis=0)
                determinant = down_down * right_right - down_right * down_right
                explained = total / determinant / _sum_of_squares(changes[touch])
                for row, column in _peaks(np.where(is_near, explained, -1.0)):
                    at = turned.x_m[row, column], turned.y_m[row, column], turned.turn_rad, press_m
                    of = products[:, :, row, column].ravel()
                    sums = squares[0][row, column], squares[1][row, column], squares[2][row, column]
                    candidates[touch].append((explained[row, column], *at, *of, *sums))
    return {touch: _best_matches(rows, _sum_of_squares(changes[touch])) for touch, rows in candidates.items()}


def poses_by_images(
    fit: Fit,
    changes: Changes,
    paint: Paint,
    presses_m: tuple[float, ...],
    most_m: float,
    near: Float64 | None,
) -> dict[int, PoseMatches]:
    """Return the poses where rendered images match each image best, of those pressed in at most ``most_m``.

    ``presses_m`` are depths below the highest point of the solid around each point. At the flank of a solid,
    this point lies outside the window.
    """
    candidates: dict[int, list[tuple[float, ...]]] = {touch: [] for touch in changes}
    for key, windows, spectra in _solids(fit, changes):
        for press_m in presses_m:
            for turned in _turns(fit, key, press_m):
                picture = _smooth(paint(turned.surface, fit.pitch_m(fit.shape)))
                energy = windows.sums((picture * picture).sum(axis=2))
                energy = energy + _FAINT * energy.max()
                allowed = turned.press_m <= most_m
                spectrum = windows.spectrum(np.moveaxis(picture, 2, 0))
                for touch, image in spectra.items():
                    is_near = turned.is_near(near, touch)
                    if not np.any(is_near):
                        continue
                    product = windows.products((spectrum * image).sum(axis=0))
                    gain = np.clip(product / energy, _MIN_GAIN, _MAX_GAIN)
                    explained = (2 * gain * product - gain * gain * energy) / _sum_of_squares(changes[touch])
                    explained = np.where(allowed & is_near, explained, -1.0)
                    for row, column in _peaks(explained):
                        at = turned.x_m[row, column], turned.y_m[row, column], turned.turn_rad
                        depth_m = turned.press_m[row, column]
                        candidates[touch].append((explained[row, column], *at, depth_m, *np.zeros(9)))
    return {touch: _best_matches(rows, _sum_of_squares(changes[touch])) for touch, rows in candidates.items()}


class _Windows:
    """Sums over all windows of the size (h, w) in maps (R, C)."""

    def __init__(self, shape: tuple[int, ...], size: tuple[int, int]) -> None:
        self._sides = [scipy.fft.next_fast_len(side, real=True) for side in shape]
        self._size = size
        self._count = tuple(side - less + 1 for side, less in zip(shape, size, strict=True))

    def spectrum(self, maps: Float64 | Float32) -> np.ndarray:
        """Return the transform of maps (..., R, C)."""
        return np.asarray(scipy.fft.rfft2(maps.astype(np.float32), self._sides))

    def products(self, spectrum: np.ndarray) -> Float32:
        """Return sums of products, whose transform is given, (..., r, c)."""
        rows, columns = self._count
        return np.asarray(scipy.fft.irfft2(spectrum, self._sides)[..., :rows, :columns])

    def sums(self, values: Float64) -> Float64:
        """Return the sums over windows, (r, c)."""
        height, width = self._size
        total = np.zeros((values.shape[0] + 1, values.shape[1] + 1))
        total[1:, 1:] = values.cumsum(axis=0).cumsum(axis=1)
        below = total[height:] - total[:-height]
        return np.asarray(below[:, width:] - below[:, :-width])


def _solids(fit: Fit, changes: Changes) -> Iterator[tuple[int, _Windows, dict[int, np.ndarray]]]:
    """Yield the id of each solid, its windows, and the transforms of the images of its touches."""
    for key in fit.reliefs:
        windows = _Windows(_map_shape(fit, key), fit.size)
        touches = [touch for touch in changes if fit.recordings.object_ids[touch] == key]
        if touches:
            yield key, windows, {touch: np.conj(windows.spectrum(changes[touch])) for touch in touches}


def _map_shape(fit: Fit, key: int) -> tuple[int, int]:
    relief = fit.reliefs[key]
    pitch_m = float(fit.pitch_m(fit.shape).min())
    sides_m = relief.corner[2:] * relief.heights_m.shape[::-1]
    reach = int(np.hypot(*sides_m) / pitch_m / 2)
    return 2 * (reach + fit.size[0] // 2) + 1, 2 * (reach + fit.size[1] // 2) + 1


def _turns(fit: Fit, key: int, press_m: float) -> Iterator[_Turned]:
    """Yield the whole solid in each turn, pressed into the gel by ``press_m`` everywhere."""
    relief = fit.reliefs[key]
    pitch_m = fit.pitch_m(fit.shape)
    small = shrunk(relief.heights_m, max(1, round(float(pitch_m.mean() / relief.corner[2])))).astype(
        np.float64
    )
    sides_m = relief.corner[2:] * relief.heights_m.shape[::-1]
    middle_m = relief.corner[:2] + sides_m / 2
    per_m = np.array(small.shape[::-1]) / sides_m
    rows, columns = _map_shape(fit, key)
    half_y = rows // 2
    half_x = columns // 2
    # Rows of an image go down.
    down, right = np.mgrid[-half_y : half_y + 1, -half_x : half_x + 1] * pitch_m[::-1, None, None]
    shape = gel.unbent(fit.shape)
    for turn in np.arange(TURNS) * (2 * np.pi / TURNS):
        cosine = np.cos(turn)
        sine = np.sin(turn)
        x_m = cosine * right - sine * down
        y_m = -sine * right - cosine * down
        at = [y_m * per_m[1] + (small.shape[0] - 1) / 2, x_m * per_m[0] + (small.shape[1] - 1) / 2]
        heights = scipy.ndimage.map_coordinates(small, at, order=1)
        top = scipy.ndimage.maximum_filter(heights, fit.size)
        pressed_m = np.maximum(heights - (top - press_m), 0)
        surface = gel.gel_surface(pressed_m, pitch_m, shape)
        x_m, y_m = (_middles(along_m, fit.size) for along_m in (x_m, y_m))
        deepest_m = _inner(scipy.ndimage.maximum_filter(pressed_m, fit.size), x_m.shape)
        yield _Turned(surface, middle_m[0] + x_m, middle_m[1] + y_m, deepest_m, float(turn))


def _inner(values: Float64, size: tuple[int, ...]) -> Float64:
    """Return the middle part of a map."""
    first = [(side - inner + 1) // 2 for side, inner in zip(values.shape, size, strict=True)]
    return values[first[0] : first[0] + size[0], first[1] : first[1] + size[1]]


def _middles(values: Float64, size: tuple[int, int]) -> Float64:
    """Return the values in the middle of each window of a map that grows evenly."""
    height, width = size
    rows = values.shape[0] - height + 1
    columns = values.shape[1] - width + 1
    return np.asarray((values[:rows, :columns] + values[height - 1 :, width - 1 :]) / 2)


def _smooth(image: Float32) -> Float64:
    return np.asarray(scipy.ndimage.gaussian_filter(image.astype(np.float64), (_SMOOTH_PX, _SMOOTH_PX, 0)))


def _sum_of_squares(change: Float32) -> float:
    return float((change * change).sum()) + 1e-9


def _peaks(explained: Float64) -> list[tuple[int, int]]:
    """Return the rows and columns of the highest peaks."""
    flat = np.flatnonzero(explained == scipy.ndimage.maximum_filter(explained, _PEAK_PX))
    best = flat[np.argsort(-explained.ravel()[flat])[:_PEAKS]]
    return [divmod(int(peak), explained.shape[1]) for peak in best]


def _best_matches(rows: list[tuple[float, ...]], square: float) -> PoseMatches:
    values = np.array(sorted(rows, key=lambda row: -row[0]))
    kept: list[int] = []
    left = np.ones(len(values), bool)
    while left.any() and len(kept) < _MAX_POSES:
        best = int(left.argmax())
        kept.append(best)
        left &= ~near_poses(values[:, 1:4], values[best, 1:4])
    values = values[kept]
    products = values[:, 5:11].reshape(-1, 2, 3) / square
    squares = values[:, [11, 12, 12, 13]].reshape(-1, 2, 2) / square
    return PoseMatches(values[:, 1:5], values[:, 0], products, squares)
