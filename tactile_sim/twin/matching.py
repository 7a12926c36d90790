"""Finds where touches without poses were.

A grid of turns and places is searched for slopes of the solid where the image changes, by normalised cross-
correlation. Colours decide between the best places of a touch: a coarse response is fitted to the clearest
touches, and each touch takes the place at which it is rendered best; in turns, until nothing changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tactile_sim.sensor_models import SensorModel
from tactile_sim.twin.fitting import Fit, shrunk
from tactile_sim.twin.recordings import Recordings
from tactile_sim.twin.relief import Relief
from tactile_sim.twin.rounds_of_fit import set_levels, start_fit
from tactile_toolkit.array_types import Bool, Float32, Float64

_WIDTH_PX = 40  # of the images that are compared
_TURNS = 72
_PLACES = 8  # of a touch that are compared by colours
_APART_PX, _APART_TURNS = 3, 2  # places that are closer than this are one
_SMOOTH_PX = 1.5
_ROUNDS = 6
_LIKELY, _MISFIT = 0.45, 2.0  # least correlation; times the median error
_EMPTY = 1e-6


@dataclass(frozen=True, slots=True)
class _Place:
    """A place on a solid: x and y, metres, turn, and how well its slopes agree with an image."""

    x_m: float
    y_m: float
    turn_rad: float
    agreement: float


def matched_places(recordings: Recordings, start: SensorModel) -> tuple[Float64, Bool]:
    """Return points under the sensor with turns (N, 3), and which of them are likely (N,)."""
    zeros = np.zeros((len(recordings), 3))
    fit = start_fit(recordings, zeros, None, start)
    fit.look(max(1, recordings.size_px[0] // _WIDTH_PX))
    candidates = [_candidates(fit, touch, start) for touch in range(len(recordings))]
    clearness = np.array([each[0].agreement for each in candidates])
    chosen = np.zeros(len(recordings), np.int64)
    fit.used = clearness >= np.quantile(clearness, 0.6)
    for number in range(_ROUNDS):
        _take(fit, candidates, chosen, start)
        fit.coefficients[:] = 0
        fit.step()
        fit.step()
        errors = [_errors(fit, touch, candidates[touch], start) for touch in range(len(recordings))]
        best = np.array([int(np.argmin(each)) for each in errors])
        least = np.array([each[at] for each, at in zip(errors, best, strict=True)])
        if number and (best == chosen).all():
            break
        chosen = best
        fit.used = least <= np.quantile(least, 0.6 if number == 0 else 0.9)
    _take(fit, candidates, chosen, start)
    agreement = np.array([each[at].agreement for each, at in zip(candidates, chosen, strict=True)])
    likely = (agreement >= _LIKELY) & (least <= _MISFIT * np.median(least))
    return fit.poses[:, :3].copy(), likely


def _take(fit: Fit, candidates: list[list[_Place]], chosen: np.ndarray, start: SensorModel) -> None:
    for touch, places in enumerate(candidates):
        place = places[chosen[touch]]
        fit.poses[touch] = place.x_m, place.y_m, place.turn_rad, 0.0
    set_levels(fit, np.arange(len(candidates)), start)


def _errors(fit: Fit, touch: int, places: list[_Place], start: SensorModel) -> list[float]:
    """Return how far off a touch is rendered at each of its places, levels."""
    held, level_m = fit.poses[touch].copy(), float(fit.level_m[touch])
    found = []
    for place in places:
        fit.poses[touch] = place.x_m, place.y_m, place.turn_rad, 0.0
        set_levels(fit, np.array([touch]), start)
        _, left, _ = fit.residual(touch)
        found.append(float(np.median(np.abs(left)) + np.abs(left).mean()))
    fit.poses[touch], fit.level_m[touch] = held, level_m
    return found


def _candidates(fit: Fit, touch: int, start: SensorModel) -> list[_Place]:
    """Return the places at which the slopes of a solid agree best with where an image changes."""
    from scipy import ndimage  # takes a tenth of a second to import

    image, _ = fit.image(touch)
    change = ndimage.gaussian_filter(np.abs(image - fit.behind).mean(axis=-1), 1.0)
    change = change - change.mean()
    change /= max(float(np.linalg.norm(change)), _EMPTY)
    relief = fit.reliefs[int(fit.recordings.object_ids[touch])]
    pitch_m = float(fit.pitch_m(fit.shape).mean())
    small = _on_pitch(relief, pitch_m)
    press_m = start.gel_mm / 1e3 - start.press_m
    found: list[_Place] = []
    for turn in np.arange(_TURNS) * (2 * np.pi / _TURNS):
        found += _best_of_turn(small, relief, change, float(turn), pitch_m, press_m)
    found.sort(key=lambda each: -each.agreement)
    kept: list[_Place] = []
    for each in found:
        if not any(_alike(each, other, pitch_m) for other in kept):
            kept.append(each)
    return kept[:_PLACES]


def _alike(one: _Place, other: _Place, pitch_m: float) -> bool:
    turn = abs((one.turn_rad - other.turn_rad + np.pi) % (2 * np.pi) - np.pi)
    away_m = np.hypot(one.x_m - other.x_m, one.y_m - other.y_m)
    return bool(away_m < _APART_PX * pitch_m and turn < (_APART_TURNS + 0.5) * 2 * np.pi / _TURNS)


def _on_pitch(relief: Relief, pitch_m: float) -> Float32:
    """Return a relief with about the pitch of the images that are compared."""
    return shrunk(relief.heights_m, max(1, round(pitch_m / relief.corner[2])))


def _best_of_turn(
    small: Float32, relief: Relief, change: Float32, turn: float, pitch_m: float, press_m: float
) -> list[_Place]:
    """Return the two best places of a turn."""
    from scipy import ndimage, signal  # take a tenth of a second to import

    rows, columns = change.shape
    high, wide = relief.heights_m.shape
    middle_m = relief.corner[:2] + relief.corner[2:] * [wide - 1, high - 1] / 2
    reach = int(np.hypot(wide, high) * relief.corner[2] / pitch_m / 2)
    half_x, half_y = reach + columns // 2, reach + rows // 2
    # Where pixels of the image's frame, y downwards, lie in the frame of the solid.
    y, x = np.mgrid[-half_y : half_y + 1, -half_x : half_x + 1] * pitch_m
    cosine, sine = np.cos(turn), np.sin(turn)
    at_x, at_y = cosine * x - sine * y, -sine * x - cosine * y
    scale = len(small) / high / relief.corner[2]
    centre = [(small.shape[0] - 1) / 2, (small.shape[1] - 1) / 2]
    heights = ndimage.map_coordinates(small, [at_y * scale + centre[0], at_x * scale + centre[1]], order=1)
    top = ndimage.maximum_filter(heights, (rows, columns))
    reached = ndimage.gaussian_filter(np.maximum(heights - (top - press_m), 0), _SMOOTH_PX)
    slopes = np.hypot(*np.gradient(reached))
    score = signal.fftconvolve(slopes, change[::-1, ::-1], mode="same")
    mean = ndimage.uniform_filter(slopes, (rows, columns), mode="constant")
    square = ndimage.uniform_filter(slopes**2, (rows, columns), mode="constant")
    score = score / np.sqrt(np.maximum(square - mean**2, _EMPTY * square.max()) * rows * columns)
    found = []
    for _ in range(2):
        down, across = np.unravel_index(int(np.argmax(score)), score.shape)
        at = (int(down), int(across))
        place = middle_m + np.array([at_x[at], at_y[at]])
        found.append(_Place(float(place[0]), float(place[1]), turn, float(score[at])))
        score[max(at[0] - 4, 0) : at[0] + 5, max(at[1] - 4, 0) : at[1] + 5] = -1
    return found
