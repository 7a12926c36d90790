"""Pen paths as runs of points, and the smooth, evenly sampled curves through them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from tactile_toolkit.value_types import Float64

Point = tuple[float, float]
"""x to the right, y down."""
Vary = Callable[[float, float], float]
"""(mean, spread) -> value for this writer and this digit."""
Run = list[Point]
Stroke = list[Run]
Shape = Callable[[Vary, float], list[Stroke]]
Allographs = tuple[tuple[tuple[Shape, float], ...], ...]
"""For each digit its shapes, and the share of writers who prefer them."""
Ring = tuple[Point, Point]
"""Centre and half axes."""
CLEAR = 0.06
"""Half width of the paper inside a ring, as a share of the height: thick pens write larger rings."""

# Samples of the curve between two points.
_STEPS = 8
_TINY = 1e-9


def lean(run: Run, slant: float, axis_y: float) -> Run:
    """Shear a run sideways by `slant` per unit of height above `axis_y`."""
    return [(x + slant * (axis_y - y), y) for x, y in run]


def arc(
    centre: Point, radii: Point, start_deg: float, stop_deg: float, number: int, egg: float = 0.0
) -> list[Point]:
    """Return `number` points on an elliptic arc, including both ends.

    0 degrees is right, 90 below, 180 left, 270 or -90 above; falling angles run anticlockwise on paper. `egg`
    widens the lower half by this share and narrows the upper half by as much.
    """
    points = []
    for index in range(number):
        turn = math.radians(start_deg + (stop_deg - start_deg) * index / (number - 1))
        # Rounded, because the last bit of a cosine depends on the platform.
        across, down = round(math.cos(turn), 9), round(math.sin(turn), 9)
        points.append((centre[0] + radii[0] * (1.0 + egg * down) * across, centre[1] + radii[1] * down))
    return points


def through(points: Sequence[Point]) -> Float64:
    """Return a centripetal Catmull-Rom curve, shape (N, 2), through at least two points.

    A centripetal curve neither loops nor overshoots between uneven points (Yuksel, Schaefer and Keyser 2011).
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
    before = gap[:-2]
    here = gap[1:-1]
    after = gap[2:]
    chord_in = slope[:-2]
    chord = slope[1:-1]
    chord_out = slope[2:]
    leave = here * (chord_in * here + chord * before) / (before + here)
    arrive = here * (chord * after + chord_out * here) / (here + after)
    # Hermite's cubic between neighbours, from the slopes at which it leaves and arrives.
    t = (np.arange(_STEPS) / _STEPS)[None, :, None]
    start, end = inner[:-1, None], inner[1:, None]
    rise = t * t * (3.0 - 2.0 * t)
    out = t * (1.0 - t) * (1.0 - t)
    into = t * t * (t - 1.0)
    curve = start + (end - start) * rise + leave[:, None] * out + arrive[:, None] * into
    return np.concatenate([curve.reshape(-1, 2), inner[-1:]])


def resample(path: Float64, spacing: float) -> Float64:
    """Resample a path about every `spacing`, in its unit: at least two samples, both ends kept."""
    step = path[1:] - path[:-1]
    walked = np.concatenate([[0.0], np.cumsum(np.sqrt(step[:, 0] * step[:, 0] + step[:, 1] * step[:, 1]))])
    number = max(2, int(walked[-1] / spacing) + 1)
    marks = np.arange(number) * (walked[-1] / (number - 1))
    return np.stack([np.interp(marks, walked, path[:, 0]), np.interp(marks, walked, path[:, 1])], axis=1)


def smooth_path(path: Float64, rounds: int) -> Float64:
    """Round the corners of an evenly sampled path; both ends stay.

    Each round averages every sample with its neighbours.
    """
    path = path.copy()
    for _ in range(rounds):
        path[1:-1] = 0.5 * path[1:-1] + 0.25 * (path[:-2] + path[2:])
    return path
