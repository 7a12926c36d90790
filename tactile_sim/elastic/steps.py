"""Steps of the solver in numba, and fields in the size of an image.

Fields are flat, in rows of a ``width``, with a border of one pixel, which is not loaded. A step multiplies
the error of the displacement by a stencil, which estimates the load that is missing, and by a share, whose
next value follows from the change of the error (Barzilai and Borwein, IMA Journal of Numerical Analysis 8,
1988). The share is halved when the error has doubled: with limits on the load, convergence is not guaranteed
(Dai and Fletcher, Numerische Mathematik 100, 2005).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tactile_toolkit.kernels import compiled, part
from tactile_toolkit.value_types import Bool, Float32, Float64

FIRST_CONTROL = (0.3, 0.0, math.inf)
"""State of the steps of one load: share, product of last step and error, last error."""

_MIN_SHARE, _MAX_SHARE = 0.01, 10.0
_STICKS = 1.0 - 1e-5  # share of the largest traction below which a pixel is not at its limit; float32


class PressFields(NamedTuple):
    """Fields of a press: pressure, the displacement by it, how far the body is below its highest point.

    ``error`` and ``step`` are those of the last step.
    """

    p: Float32
    u: Float32
    below: Float32
    error: Float32
    step: Float32


class ShearFields(NamedTuple):
    """Fields of a shear, (2, n): traction, the displacement by it, and the one that it has to make.

    ``bound`` (n,) is the greatest traction, which is reached where ``slips`` (n,); ``damping`` (n,) shortens
    steps there. ``error`` and ``step``, (2, n), are those of the last step.
    """

    q: Float32
    bend: Float32
    motion: Float32
    bound: Float32
    slips: Bool
    damping: Float32
    error: Float32
    step: Float32


@part
def _next_share(control: Float64, product: float, error: float) -> float:
    """Update the control; ``product`` is that of the last step and the present error."""
    if control[1] > 0.0:
        change = control[1] - product
        factor = control[1] / change if change > 0.0 else _MAX_SHARE
        control[0] = min(max(control[0] * factor, _MIN_SHARE), _MAX_SHARE)
    if error > 2.0 * control[2]:
        control[0] *= 0.5
    control[2] = error
    return float(control[0])


@part
def _missing(error: Float32, at: int, width: int, stencil: Float32) -> np.float32:
    """Return the load that a stencil estimates from the error of the displacement."""
    beside = error[at - 1] + error[at + 1]
    along = error[at - width] + error[at + width]
    across = error[at - width - 1] + error[at - width + 1] + error[at + width - 1] + error[at + width + 1]
    load: np.float32 = stencil[0] * error[at] + stencil[1] * beside + stencil[2] * along + stencil[3] * across
    return load


@part
def _mean_depth(p: Float32, u: Float32, below: Float32) -> float:
    """Return the depth of the press, as a mean over the contact."""
    total = 0.0
    count = 0
    for at in range(len(p)):
        if p[at] > 0.0:
            total += u[at] + below[at]
            count += 1
    return total / count


@compiled
def press_step(
    fields: PressFields,
    width: int,
    stencil: Float32,
    control: Float64,
    target: float,
    is_force: bool,
    tolerance: float,
) -> tuple[float, float]:
    """Change the pressure by a step, unless the error is within the tolerance, relative to the depth.

    ``target`` is the sum of the pressure if ``is_force``, else the depth. Returns the depth and the greatest
    error, of gaps in the contact and of overlaps beside it, both of the pressure before the step.
    """
    p, u, below, error, step = fields
    depth = target
    if is_force:
        depth = _mean_depth(p, u, below)
    worst = 0.0
    product = 0.0
    for at in range(len(p)):
        missing = np.float32(depth) - below[at] - u[at]
        if p[at] == 0.0:
            missing = max(missing, np.float32(0.0))
        worst = max(worst, float(abs(missing)))
        product += step[at] * missing
        error[at] = missing
    if worst <= tolerance * abs(depth):
        return depth, worst
    share = np.float32(_next_share(control, product, worst))
    total = 0.0
    count = 0
    for at in range(len(p)):
        step[at] = 0.0
        if p[at] > 0.0 or error[at] > 0.0:
            step[at] = _missing(error, at, width, stencil)
            total += step[at]
            count += 1
    mean = np.float32(total / count if is_force else 0.0)
    total = 0.0
    product = 0.0
    for at in range(len(p)):
        if p[at] > 0.0 or error[at] > 0.0:
            step[at] -= mean
            product += step[at] * error[at]
            p[at] = max(p[at] + share * step[at], np.float32(0.0))
            total += p[at]
    control[1] = product
    if is_force:
        scale = np.float32(target / total)
        for at in range(len(p)):
            p[at] *= scale
    return depth, worst


@part
def _shear_errors(fields: ShearFields, own: float) -> tuple[float, float]:
    """Write the errors of the displacement; return the relative one, and the product of step and errors."""
    q, bend, motion, bound, slips, damping, error, step = fields
    left = 0.0
    largest = 0.0
    product = 0.0
    count = 0
    for at in range(len(bound)):
        if bound[at] > 0.0:
            x, y = motion[0, at] - bend[0, at], motion[1, at] - bend[1, at]
            q_x, q_y = q[0, at], q[1, at]
            size = np.float32(math.sqrt(q_x * q_x + q_y * q_y))
            outward = x * q_x + y * q_y
            slips[at] = size >= np.float32(_STICKS) * bound[at] and outward > 0.0
            damping[at] = 1.0
            if slips[at]:
                outward /= size
                x -= outward * q_x / size
                y -= outward * q_y / size
                damping[at] = math.sqrt(own / (own + outward / bound[at]))
            left += x * x + y * y
            largest = max(largest, motion[0, at] ** 2 + motion[1, at] ** 2)
            count += 1
            product += step[0, at] * x + step[1, at] * y
            error[0, at] = damping[at] * x
            error[1, at] = damping[at] * y
    relative = math.sqrt(left / (largest * count)) if left > 0.0 else 0.0
    return relative, product


@compiled
def shear_step(
    fields: ShearFields,
    width: int,
    stencils: Float32,
    own: float,
    control: Float64,
    tolerance: float,
) -> float:
    """Change the traction by a step, unless the error is within the tolerance; return the error.

    Errors are root mean squares over the contact, relative to the largest displacement to be made. A pixel
    at its bound that would slide further can only move along the circle |q| = bound, which is curved:
    multiplier / bound is added to the stiffness (Nocedal and Wright, Numerical Optimization, 2006, section
    12.5). ``own`` is the displacement of a pixel by its own traction.
    """
    relative, product = _shear_errors(fields, own)
    if relative <= tolerance:
        return relative
    q, _, _, bound, slips, damping, error, step = fields
    share = np.float32(_next_share(control, product, relative))
    product = 0.0
    for at in range(len(bound)):
        if bound[at] > 0.0:
            q_x, q_y = q[0, at], q[1, at]
            x = damping[at] * _missing(error[0], at, width, stencils[0])
            y = damping[at] * _missing(error[1], at, width, stencils[1])
            if slips[at]:
                outward = (x * q_x + y * q_y) / (q_x * q_x + q_y * q_y)
                x -= outward * q_x
                y -= outward * q_y
            step[0, at] = x
            step[1, at] = y
            product += (x * error[0, at] + y * error[1, at]) / damping[at]
            q_x += share * x
            q_y += share * y
            size = np.float32(math.sqrt(q_x * q_x + q_y * q_y))
            shorter = bound[at] / size if size > bound[at] else np.float32(1.0)
            q[0, at] = shorter * q_x
            q[1, at] = shorter * q_y
    control[1] = product
    return relative


@compiled
def bring_up(fields: Float64, block_px: int) -> Float64:
    """Return fields (n, h, w) of blocks in the size of their pixels, linear between the centres of blocks."""
    count, rows, columns = fields.shape
    out = np.empty((count, rows * block_px, columns * block_px))
    line = np.empty(columns + 1)
    for field in range(count):
        for row in range(rows * block_px):
            above, down = _between(row, rows, block_px)
            first = fields[field, above]
            second = fields[field, min(above + 1, rows - 1)]
            for column in range(columns):
                line[column] = first[column] + down * (second[column] - first[column])
            line[columns] = line[columns - 1]
            target = out[field, row]
            for column in range(block_px):
                # The same fraction of the distance between two blocks in all blocks.
                position = (column + 0.5) / block_px - 0.5
                before = 1 if position < 0.0 else 0
                across = position + before
                target[column] = line[0] + (1 - before) * across * (line[1] - line[0])
                for block in range(before, columns):
                    value = line[block - before]
                    next_value = line[block - before + 1]
                    target[block * block_px + column] = value + across * (next_value - value)
    return out


@part
def _between(pixel: int, blocks: int, block_px: int) -> tuple[int, float]:
    """Return the block before a pixel, and the fraction of the distance to the next block."""
    position = min(max((pixel + 0.5) / block_px - 0.5, 0.0), blocks - 1.0)
    return int(position), position - int(position)
