"""How pixels see the surface of a gel, in numba: its slopes, and places in the tables of a response."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tactile_toolkit.kernels import part
from tactile_toolkit.value_types import Float32

TURNS, STEPS = 18, 10
"""Directions of slopes, and entries along their steepness."""

STEEPEST = 0.6
"""Tangent of half of the angle of the steepest slope in the table: 62 degrees."""

_LEVEL = 1e-5
"""Slope below which the gel counts as at rest, as in Taxim."""

_NEAREST = 0.2
"""Least stretch of a seen map: where it is smaller, one part of the gel hides another one."""

_BOW = 0.273  # atan(ratio) is ratio * (pi / 4 + _BOW (1 - ratio)) within 0.004 for ratios up to 1


class SurfaceView(NamedTuple):
    """How a surface is seen.

    The fields are the size of a pixel, metres; the share of the image that is shown, along x and y; the
    radial term of the lens; the squared width of the image over its squared diagonal; one over the distance
    of the camera, 1 / metres; the distance of lamps from the middle, and the height of which theirs are
    multiples, metres; the share of their light that lamps do not send sideways; and how far above the middle
    of a lamp lies what hides half of it, metres.
    """

    pitch_x: float
    pitch_y: float
    span_x: float
    span_y: float
    lens: float
    across: float
    camera: float
    ring: float
    lamp_height: float
    lobe: float
    fade: float


@part
def column_x(column: int, columns: int, view: SurfaceView) -> np.float32:
    """Return how far a pixel lies to the right, -1 to 1 times the share of the image; single precision."""
    return np.float32(view.span_x * ((2.0 * column + 1.0) / columns - 1.0))


@part
def row_y(row: int, rows: int, view: SurfaceView) -> np.float32:
    """Return how far a pixel lies above the middle, -1 to 1 times the share of the image."""
    return np.float32(view.span_y * (1.0 - (2.0 * row + 1.0) / rows))


@part
def bend_at(u: np.float32, v: np.float32, lens: np.float32, across: np.float32) -> np.float32:
    """Return how much farther from the middle than without a lens lies what a pixel sees, as a factor."""
    unit = np.float32(1.0)
    return unit + lens * (across * u * u + (unit - across) * v * v)


@part
def turn_of(x: np.float32, y: np.float32) -> np.float32:
    """Return the direction of a slope, in steps of the table."""
    zero, unit = np.float32(0.0), np.float32(1.0)
    quarter = np.float32(0.25 * math.pi)
    wide, high = abs(x), abs(y)
    small, large = (wide, high) if wide < high else (high, wide)
    ratio = small / (large + np.float32(1e-12))
    angle = ratio * (quarter + np.float32(_BOW) * (unit - ratio))
    angle = angle if wide > high else np.float32(0.5 * math.pi) - angle
    angle = angle if x > zero else np.float32(math.pi) - angle
    angle = angle if y > zero else np.float32(2.0 * math.pi) - angle
    # A whole turn would lie beyond the last direction.
    most = np.float32(TURNS - 1e-5)
    angle = angle * np.float32(TURNS / (2.0 * math.pi))
    return angle if angle < most else most


@part
def row_positions(positions: Float32, soft: Float32, row: int, view: SurfaceView) -> None:
    """Write where in the tables the pixels of a row lie, and slopes: (4, W).

    The rows are direction, steepness, and the slopes along x and y. Directions are -1 where the gel is
    level. Slopes are those on the gel, not those that the camera sees. Single precision and no branches:
    several pixels are computed at once.
    """
    rows, columns = soft.shape
    unit, two = np.float32(1.0), np.float32(2.0)
    least = np.float32(_LEVEL * _LEVEL)
    last = np.float32(STEPS - 1.0)
    per_steep = np.float32(1.0 / STEEPEST)
    most = np.float32(STEPS - 1.0001)
    above = soft[max(row - 1, 0)]
    line = soft[row]
    below = soft[min(row + 1, rows - 1)]
    per_y = np.float32(1.0 / (view.pitch_y * (min(row + 1, rows - 1) - max(row - 1, 0))))
    per_x = np.float32(0.5 / view.pitch_x)
    v = row_y(row, rows, view)
    across = np.float32(view.across)
    down = np.float32(1.0 - view.across)
    both = np.float32(math.sqrt(view.across * (1.0 - view.across)))
    lens, camera = np.float32(view.lens), np.float32(view.camera)
    from_left, width = np.float32(0.5 - 0.5 * columns), np.float32(view.pitch_x)
    up = np.float32(view.pitch_y * (0.5 * rows - row - 0.5))
    nearest = np.float32(_NEAREST)
    turns, steeps = positions[0], positions[1]
    for column in range(1, columns - 1):
        steeps[column] = (line[column + 1] - line[column - 1]) * per_x
    steeps[0] = (line[1] - line[0]) * per_x * two
    steeps[columns - 1] = (line[columns - 1] - line[columns - 2]) * per_x * two
    for column in range(columns):
        x = steeps[column]
        y = (above[column] - below[column]) * per_y
        u = column_x(column, columns, view)
        bend = bend_at(u, v, lens, across)
        xx, yy = bend + two * lens * across * u * u, bend + two * lens * down * v * v
        xy = two * lens * both * u * v
        per_area = unit / (xx * yy - xy * xy)
        x, y = (yy * x - xy * y) * per_area, (xx * y - xy * x) * per_area
        # A point at (1 + height / distance) p is seen at p.
        stretch = unit + camera * (line[column] + bend * (width * (column + from_left) * x + up * y))
        stretch = unit / (stretch if stretch > nearest else nearest)
        x, y = x * stretch, y * stretch
        positions[2, column], positions[3, column] = x, y
        square = x * x + y * y
        turn = turn_of(x, y)
        turns[column] = turn if square > least else -unit
        tangent = math.sqrt(square) / (unit + math.sqrt(unit + square))
        steep = last * math.sqrt(tangent * per_steep)
        steeps[column] = steep if steep < most else most
