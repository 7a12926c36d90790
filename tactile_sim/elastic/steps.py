"""Steps of the solver in numba, and fields in the size of an image.

Fields have a border of one pixel, which is not loaded. A step multiplies the error of the displacement by a
stencil, which estimates the load that is missing, and by a share, whose next value follows from the change of
the error (Barzilai and Borwein, IMA Journal of Numerical Analysis 8, 1988). A step halves the share when the
error has doubled: with limits on the load, convergence is not guaranteed (Dai and Fletcher, Numerische
Mathematik 100, 2005).
"""

from __future__ import annotations

import math

import numpy as np

from tactile_toolkit.array_types import Bool, Float32, Float64
from tactile_toolkit.kernels import compiled, part

FIRST_CONTROL = (0.3, 0.0, math.inf)
"""State of the steps of one load: share, product of last step and error, last error."""

_MIN_SHARE, _MAX_SHARE = 0.01, 10.0
_STICKS = 1.0 - 1e-5  # share of the largest traction below which a pixel is not at its limit; float32


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
def _missing(error: Float32, row: int, column: int, stencil: Float32) -> np.float32:
    """Return the load that a stencil estimates from the error of the displacement."""
    beside = error[row, column - 1] + error[row, column + 1]
    along = error[row - 1, column] + error[row + 1, column]
    across = error[row - 1, column - 1] + error[row - 1, column + 1]
    across += error[row + 1, column - 1] + error[row + 1, column + 1]
    load: np.float32 = (
        stencil[0] * error[row, column] + stencil[1] * beside + stencil[2] * along + stencil[3] * across
    )
    return load


@compiled
def press_step(
    p: Float32,
    u: Float32,
    below: Float32,
    error: Float32,
    step: Float32,
    stencil: Float32,
    control: Float64,
    target: float,
    is_force: bool,
    tolerance: float,
) -> tuple[float, float]:
    """Change the pressure ``p`` by a step, unless the error is within the tolerance, relative to the depth.

    ``target`` is the sum of the pressure if ``is_force``, else the depth; ``u`` is the displacement, and
    ``below`` how far the body is below its highest point. Returns the depth and the greatest error, of gaps
    in the contact and of overlaps beside it, both of the pressure before the step.
    """
    rows, columns = p.shape
    depth = target
    if is_force:
        total, count = 0.0, 0
        for row in range(1, rows - 1):
            for column in range(1, columns - 1):
                if p[row, column] > 0.0:
                    total += u[row, column] + below[row, column]
                    count += 1
        depth = total / count
    worst, product = 0.0, 0.0
    for row in range(1, rows - 1):
        for column in range(1, columns - 1):
            missing = np.float32(depth) - below[row, column] - u[row, column]
            if p[row, column] == 0.0:
                missing = max(missing, np.float32(0.0))
            worst = max(worst, float(abs(missing)))
            product += step[row, column] * missing
            error[row, column] = missing
    if worst <= tolerance * abs(depth):
        return depth, worst
    share = np.float32(_next_share(control, product, worst))
    total, count = 0.0, 0
    for row in range(1, rows - 1):
        for column in range(1, columns - 1):
            step[row, column] = 0.0
            if p[row, column] > 0.0 or error[row, column] > 0.0:
                step[row, column] = _missing(error, row, column, stencil)
                total += step[row, column]
                count += 1
    mean = np.float32(total / count if is_force else 0.0)
    total, product = 0.0, 0.0
    for row in range(1, rows - 1):
        for column in range(1, columns - 1):
            if p[row, column] > 0.0 or error[row, column] > 0.0:
                step[row, column] -= mean
                product += step[row, column] * error[row, column]
                p[row, column] = max(p[row, column] + share * step[row, column], np.float32(0.0))
                total += p[row, column]
    control[1] = product
    if is_force:
        scale = np.float32(target / total)
        for row in range(1, rows - 1):
            for column in range(1, columns - 1):
                p[row, column] *= scale
    return depth, worst


@compiled
def shear_step(
    q: Float32,
    bend: Float32,
    wanted: Float32,
    bound: Float32,
    slips: Bool,
    damping: Float32,
    error: Float32,
    step: Float32,
    stencils: Float32,
    own: float,
    control: Float64,
    tolerance: float,
) -> float:
    """Change the traction ``q`` by a step, unless the error is within the tolerance; return the error.

    Errors are root mean squares over the contact, relative to the largest wanted displacement. A pixel at
    its limit ``bound`` that would slide further (``slips``) can only move along the circle |q| = bound, which
    is curved: multiplier / bound is added to the stiffness (Nocedal and Wright, Numerical Optimization, 2006,
    section 12.5). ``bend`` is the displacement, ``own`` that of a pixel by its own traction.
    """
    rows, columns = bound.shape
    left, largest, product, count = 0.0, 0.0, 0.0, 0
    for row in range(1, rows - 1):
        for column in range(1, columns - 1):
            limit = bound[row, column]
            if limit > 0.0:
                wanted_x, wanted_y = wanted[0, row, column], wanted[1, row, column]
                x, y = wanted_x - bend[0, row, column], wanted_y - bend[1, row, column]
                q_x, q_y = q[0, row, column], q[1, row, column]
                size = np.float32(math.sqrt(q_x * q_x + q_y * q_y))
                outward = x * q_x + y * q_y
                slips[row, column] = size >= np.float32(_STICKS) * limit and outward > 0.0
                damping[row, column] = 1.0
                if slips[row, column]:
                    outward /= size
                    x -= outward * q_x / size
                    y -= outward * q_y / size
                    damping[row, column] = math.sqrt(own / (own + outward / limit))
                left += x * x + y * y
                largest = max(largest, wanted_x * wanted_x + wanted_y * wanted_y)
                count += 1
                product += step[0, row, column] * x + step[1, row, column] * y
                error[0, row, column] = damping[row, column] * x
                error[1, row, column] = damping[row, column] * y
    relative = math.sqrt(left / (largest * count)) if left > 0.0 else 0.0
    if relative <= tolerance:
        return relative
    share = np.float32(_next_share(control, product, relative))
    product = 0.0
    for row in range(1, rows - 1):
        for column in range(1, columns - 1):
            limit = bound[row, column]
            if limit > 0.0:
                q_x, q_y, damped = q[0, row, column], q[1, row, column], damping[row, column]
                x = damped * _missing(error[0], row, column, stencils[0])
                y = damped * _missing(error[1], row, column, stencils[1])
                if slips[row, column]:
                    outward = (x * q_x + y * q_y) / (q_x * q_x + q_y * q_y)
                    x -= outward * q_x
                    y -= outward * q_y
                step[0, row, column], step[1, row, column] = x, y
                product += (x * error[0, row, column] + y * error[1, row, column]) / damped
                q_x += share * x
                q_y += share * y
                size = np.float32(math.sqrt(q_x * q_x + q_y * q_y))
                shorter = limit / size if size > limit else np.float32(1.0)
                q[0, row, column], q[1, row, column] = shorter * q_x, shorter * q_y
    control[1] = product
    return relative


@compiled
def bring_up(fields: Float64, block_px: int) -> Float64:
    """Return fields (n, h, w) of blocks in the size of their pixels, linear between the centres of blocks."""
    count, rows, columns = fields.shape
    out, line = np.empty((count, rows * block_px, columns * block_px)), np.empty(columns)
    for field in range(count):
        for row in range(rows * block_px):
            above, down = _between(row, rows, block_px)
            first, second = fields[field, above], fields[field, min(above + 1, rows - 1)]
            for column in range(columns):
                line[column] = first[column] + down * (second[column] - first[column])
            for column in range(columns * block_px):
                left, across = _between(column, columns, block_px)
                value = line[left]
                out[field, row, column] = value + across * (line[min(left + 1, columns - 1)] - value)
    return out


@part
def _between(pixel: int, blocks: int, block_px: int) -> tuple[int, float]:
    """Return the block before a pixel, and the fraction of the distance to the next block."""
    position = min(max((pixel + 0.5) / block_px - 0.5, 0.0), blocks - 1.0)
    return int(position), position - int(position)
