"""From a handful of points to a smooth path with evenly spaced samples."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["Point", "arc", "resample", "smooth", "through"]

Point = tuple[float, float]
"""x to the right, y down."""

_STEPS = 8
_TINY = 1e-9


def arc(
    centre: Point, radii: Point, start_deg: float, stop_deg: float, number: int, egg: float = 0.0
) -> list[Point]:
    """Return points on an ellipse.

    Parameters
    ----------
    centre, radii : Point
        Middle and half axes.
    start_deg, stop_deg : float
        0 is right, 90 is below, 180 left, 270 or -90 above; falling angles run anticlockwise on paper.
    number : int
        How many points, both ends included.
    egg : float
        Widens the lower half by this share and narrows the upper half as much.
    """
    points = []
    for index in range(number):
        turn = math.radians(start_deg + (stop_deg - start_deg) * index / (number - 1))
        # Rounded, because the last bit of a cosine is the platform's own.
        across, down = round(math.cos(turn), 9), round(math.sin(turn), 9)
        points.append((centre[0] + radii[0] * (1.0 + egg * down) * across, centre[1] + radii[1] * down))
    return points


def through(points: Sequence[Point]) -> NDArray[np.float64]:
    """Return a centripetal Catmull-Rom curve through `points`.

    Centripetal, because it neither loops nor overshoots when points lie unevenly (Yuksel, Schaefer and
    Keyser 2011).

    Parameters
    ----------
    points : sequence of Point
        At least two; consecutive ones differ.

    Returns
    -------
    ndarray of float64, shape (N, 2)
    """
    inner = np.asarray(points, dtype=np.float64)
    if len(inner) == 2:
        return inner
    first, last = 2.0 * inner[0] - inner[1], 2.0 * inner[-1] - inner[-2]
    knots = np.concatenate([first[None], inner, last[None]])
    step = knots[1:] - knots[:-1]
    length = np.sqrt(step[:, 0] * step[:, 0] + step[:, 1] * step[:, 1]) + _TINY
    gap = np.sqrt(length)[:, None]
    slope = step / gap
    before, here, after = gap[:-2], gap[1:-1], gap[2:]
    chord_in, chord, chord_out = slope[:-2], slope[1:-1], slope[2:]
    leave = here * (chord_in * here + chord * before) / (before + here)
    arrive = here * (chord * after + chord_out * here) / (here + after)
    return _hermite(inner, leave, arrive)


def _hermite(
    knots: NDArray[np.float64], leave: NDArray[np.float64], arrive: NDArray[np.float64]
) -> NDArray[np.float64]:
    t = (np.arange(_STEPS) / _STEPS)[None, :, None]
    start, end = knots[:-1, None], knots[1:, None]
    rise = t * t * (3.0 - 2.0 * t)
    out, into = t * (1.0 - t) * (1.0 - t), t * t * (t - 1.0)
    curve = start + (end - start) * rise + leave[:, None] * out + arrive[:, None] * into
    return np.concatenate([curve.reshape(-1, 2), knots[-1:]])


def resample(path: NDArray[np.float64], spacing: float) -> NDArray[np.float64]:
    """Return the path with samples about `spacing` apart, both ends kept.

    Parameters
    ----------
    path : ndarray of float64, shape (N, 2)
    spacing : float
        In the unit of `path`.

    Returns
    -------
    ndarray of float64, shape (M, 2), M >= 2
    """
    step = path[1:] - path[:-1]
    walked = np.concatenate([[0.0], np.cumsum(np.sqrt(step[:, 0] * step[:, 0] + step[:, 1] * step[:, 1]))])
    number = max(2, int(walked[-1] / spacing) + 1)
    marks = np.arange(number) * (walked[-1] / (number - 1))
    return np.stack([np.interp(marks, walked, path[:, 0]), np.interp(marks, walked, path[:, 1])], axis=1)


def smooth(path: NDArray[np.float64], rounds: int) -> NDArray[np.float64]:
    """Return an evenly sampled path with its corners rounded; both ends stay.

    Parameters
    ----------
    path : ndarray of float64, shape (N, 2)
    rounds : int
        Each averages a sample with its neighbours once.

    Returns
    -------
    ndarray of float64, shape (N, 2)
    """
    path = path.copy()
    for _ in range(rounds):
        path[1:-1] = 0.5 * path[1:-1] + 0.25 * (path[:-2] + path[2:])
    return path
