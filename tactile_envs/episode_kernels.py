"""Kernels of episodes, in numba: placing objects, aiming sensors, and scoring classes.

All of them lie in this one file, because numba's cache on disk checks only the file of a kernel.
"""

from __future__ import annotations

import math

import numpy as np

from tactile_toolkit.kernels import compiled
from tactile_toolkit.value_types import Bool, Float32, Float64, Int64


@compiled
def aim(
    actions: Float32,
    motion: Float64,
    sensors: Float64,
    targets: Float64,
    costs: Float32,
) -> None:
    """Turn actions (n, 3) into targets (n, 3), metres, and costs, (n,).

    An action is a fraction of the greatest distance, and shortened to length 1 if it is longer. ``motion``,
    shape (8,), has the lowest and the highest position, metres (6), the greatest distance, metres, and the
    cost factor. The precision of each step is that of the published environment.
    """
    longest = np.float32(1.0)
    price = np.float32(motion[7])
    for i in range(len(actions)):
        x, y, z = actions[i, 0], actions[i, 1], actions[i, 2]
        length = np.float32(math.sqrt((x * x + y * y) + z * z))
        for axis in range(3):
            fraction = actions[i, axis] / length if length > longest else actions[i, axis]
            aimed = sensors[i, axis] + np.float64(fraction) * motion[6]
            targets[i, axis] = min(max(aimed, motion[axis]), motion[axis + 3])
        costs[i] = ((-(x * x) * price + -(y * y) * price) + -(z * z) * price) / np.float32(3.0)


@compiled
def turn(actions: Float32, limits: Float64, price: float, axes: Float64, costs: Float32) -> None:
    """Turn sensors by actions (n, 3), and add the costs to ``costs``, (n,).

    Actions are rotation vectors in the cell's frame, as fractions of the widest turn, shortened to length 1;
    ``limits`` (2,) is that turn and the greatest tilt, radians. ``axes`` (n, 3, 3), in columns, are written.
    A z axis that is tilted too far is brought back towards upright, and the y axis follows; the sensor is not
    turned if that leaves no direction for y.
    """
    longest = np.float32(1.0)
    price_of = np.float32(price)
    for i in range(len(actions)):
        x, y, z = actions[i, 0], actions[i, 1], actions[i, 2]
        length = np.float32(math.sqrt((x * x + y * y) + z * z))
        costs[i] += ((-(x * x) * price_of + -(y * y) * price_of) + -(z * z) * price_of) / np.float32(3.0)
        angle_rad = np.float64(min(length, longest)) * limits[0]
        around = actions[i].astype(np.float64) / max(np.float64(length), 1e-12)
        upright, side = _turned(axes[i, :, 2], around, angle_rad), _turned(axes[i, :, 1], around, angle_rad)
        flat = math.hypot(upright[0], upright[1])
        most = math.sin(limits[1])
        if flat > most:
            upright[:2] *= most / flat
        upright[2] = math.sqrt(1.0 - (upright[0] ** 2 + upright[1] ** 2))
        side -= (side * upright).sum() * upright
        width = math.sqrt((side * side).sum())
        if width < 1e-6:
            continue
        side /= width
        axes[i, :, 0], axes[i, :, 1], axes[i, :, 2] = _cross(side, upright), side, upright


@compiled
def _turned(vector: Float64, around: Float64, angle_rad: float) -> Float64:
    """Turn a vector around a unit vector."""
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    along: Float64 = (vector * around).sum() * (1.0 - cosine) * around
    return cosine * vector + sine * _cross(around, vector) + along


@compiled
def _cross(left: Float64, right: Float64) -> Float64:
    product = np.empty(3)
    for axis in range(3):
        k, m = (axis + 1) % 3, (axis + 2) % 3
        product[axis] = left[k] * right[m] - left[m] * right[k]
    return product


@compiled
def place_objects(
    numbers: Int64,
    drawn: Float64,
    most_turn_rad: float,
    reach_m: Float64,
    hulls: Float32,
    grids: Float64,
    objects: Float64,
) -> None:
    """Place objects in their cells, inside ``reach_m`` (half of width and depth), by random numbers.

    ``drawn``, shape (n, 3), are from 0 to 1, for the turn and both coordinates; ``objects``, shape (n, 3), is
    written: metres, radians.
    """
    for i in range(len(numbers)):
        first, last = int(grids[numbers[i], 10]), int(grids[numbers[i], 11])
        turn_rad = (drawn[i, 0] * 2 - 1) * most_turn_rad
        least_x, least_y, most_x, most_y = spread_of_turned(
            hulls[first:last], math.cos(turn_rad), math.sin(turn_rad)
        )
        for axis in range(2):
            low = -reach_m[axis] - (least_x if axis == 0 else least_y)
            high = reach_m[axis] - (most_x if axis == 0 else most_y)
            if low > high:
                low = high = (low + high) / 2
            objects[i, axis] = drawn[i, axis + 1] * (high - low) + low
        objects[i, 2] = turn_rad


@compiled
def classify(logits: Float32, labels: Int64) -> tuple[Float64, Bool]:
    """Return cross-entropies of logits (n, classes), and whether the label has the first of the greatest."""
    entropies = np.empty(len(logits))
    is_right = np.empty(len(logits), np.bool_)
    for i in range(len(logits)):
        best = 0
        most = logits[i, 0]
        for k in range(1, logits.shape[1]):
            if logits[i, k] > most:
                best = k
                most = logits[i, k]
        total = 0.0
        for k in range(logits.shape[1]):
            total += math.exp(np.float64(logits[i, k]) - most)
        entropies[i] = math.log(total) - (np.float64(logits[i, labels[i]]) - most)
        is_right[i] = best == labels[i]
    return entropies, is_right


@compiled
def spread_of_turned(hull: Float32, cosine: float, sine: float) -> tuple[float, float, float, float]:
    """Return least and greatest x and y of turned points (n, 2)."""
    least_x = np.inf
    least_y = np.inf
    most_x = -np.inf
    most_y = -np.inf
    for point in range(len(hull)):
        x, y = np.float64(hull[point, 0]), np.float64(hull[point, 1])
        over = cosine * x - sine * y
        up = sine * x + cosine * y
        least_x, most_x = min(least_x, over), max(most_x, over)
        least_y, most_y = min(least_y, up), max(most_y, up)
    return least_x, least_y, most_x, most_y
