"""Kernels of the elastic gel, in numba: contact and friction on a layer.

Each operation is an IEEE one in a fixed order, so results do not depend on the processor. Columns of fields
beyond those of the window are never in contact; see :mod:`tactile_sim.elastic_response`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tactile_sim import elastic_vectors as vectors
from tactile_sim.elastic_response import Layer, Workspace, respond, work_of
from tactile_toolkit.array_types import Bool, Float32, Float64, Int64
from tactile_toolkit.kernels import compiled

_MAX_PASSES = 5  # of pressure and shear, each with the displacement that the other one makes
_FIRST_PASS = 10.0  # factor of the tolerance in the first pass, which only starts the others
_COUPLED = 0.3  # passes end when the coupled displacement changes by less, in tolerances
_MAX_STEPS = 300
_MAX_CHANGED = 40  # pixels that join or leave the contact; for more of them a convolution is cheaper
_OFF_BOUNDS = 0.01  # share of the tractions that may be off their limits before all are projected
_PROJECTED = 6  # steps after which tractions are projected onto their limits again
_STICKS = 1.0 - 1e-5  # share of the largest traction below which a pixel is not at its limit; float32
_FAR_M = 1e6

keep_apart = vectors.keep_apart


@compiled
def press(
    p: Float32,
    u: Float32,
    below: Float32,
    target: float,
    is_force: bool,
    layer: Layer,
    work: Workspace,
    width: int,
    tolerance: float,
) -> tuple[float, float, int]:
    """Solve for pressure, from ``p`` on: Polonsky and Keer, Wear 231, 1999, section 3.

    ``target`` is the sum of the pressure if ``is_force``, else the depth; ``below`` is how far the body is
    below its highest point. The displacement is written to ``u``. Returns the depth, the largest error of the
    gap relative to the depth, and the number of steps.
    """
    keep_apart()
    t, r, gap = np.zeros_like(p), np.empty_like(p), np.empty_like(p)
    old, keep, depth, error, step, is_stale = 1.0, 0.0, target, np.inf, 0, True
    while True:
        if is_stale:
            respond(p, u, layer, work, width)
        depth, square, error, lowest = _gaps(p[0], u[0], below[0], gap[0], target, is_force)
        if (error <= tolerance * depth and lowest >= -tolerance * depth) or step == _MAX_STEPS:
            break
        step += 1
        factor = np.float32(keep * square / old)
        old = square
        for place in range(p.size):
            t[0, place] = gap[0, place] + factor * t[0, place] if p[0, place] > 0.0 else np.float32(0.0)
        respond(t, r, layer, work, width)
        length = _step_length(p[0], gap[0], t[0], r[0], is_force)
        keep, is_stale = _take_step(p[0], u[0], gap[0], t[0], r[0], length, layer.near, width)
        if is_force:
            total = 0.0
            for value in p[0]:
                total += value
            scale = np.float32(target / total)
            for place in range(p.size):
                p[0, place] *= scale
                u[0, place] *= scale
    return depth, error / depth, step


@compiled
def _gaps(
    p: Float32, u: Float32, below: Float32, gap: Float32, target: float, is_force: bool
) -> tuple[float, float, float, float]:
    """Write the gaps; return the depth, sum of squares and largest gap in contact, least gap outside."""
    depth = target
    if is_force:
        total, count = 0.0, 0
        for place in range(len(p)):
            if p[place] > 0.0:
                total += u[place] + below[place]
                count += 1
        depth = total / count
    square, error, lowest = 0.0, 0.0, np.float32(0.0)
    near = np.float32(depth)
    for place in range(len(p)):
        value = (u[place] - near) + below[place]
        gap[place] = value
        if p[place] > 0.0:
            square += value * value
            error = max(error, abs(value))
        else:
            lowest = min(lowest, value)
    return depth, square, error, float(lowest)


@compiled
def _step_length(p: Float32, gap: Float32, t: Float32, r: Float32, is_force: bool) -> float:
    mean = 0.0
    if is_force:
        count = 0
        for place in range(len(p)):
            if p[place] > 0.0:
                mean += r[place]
                count += 1
        mean /= count
    along, bent = 0.0, 0.0
    for place in range(len(p)):
        if p[place] > 0.0:
            along += gap[place] * t[place]
            bent += (r[place] - mean) * t[place]
    # A contact of one pixel has no freedom at a given force.
    return along / bent if bent > 0.0 else 0.0


@compiled
def _take_step(
    p: Float32,
    u: Float32,
    gap: Float32,
    t: Float32,
    r: Float32,
    length: float,
    near: Float32,
    width: int,
) -> tuple[float, bool]:
    """Update pressure and displacement by a step.

    Returns 1 if no pixel joined the contact, else 0, and whether the displacement is stale because too many
    pixels joined or left the contact.
    """
    keep_apart()
    changed, added = np.empty(_MAX_CHANGED, np.int64), np.empty(_MAX_CHANGED, np.float32)
    count, keep, tau = 0, 1.0, np.float32(length)
    # The first step of a contact of one pixel has length 0: pixels that overlap use their own compliance.
    joins = tau if tau > 0.0 else np.float32(1.0) / near[len(near) // 2]
    for place in range(len(p)):
        u[place] -= tau * r[place]
        new, wanted = np.float32(0.0), np.float32(0.0)
        if p[place] > 0.0:
            wanted = p[place] - tau * t[place]
            new = max(wanted, np.float32(0.0))
        if new == 0.0 and gap[place] < 0.0:
            new -= joins * gap[place]
            keep = 0.0
        p[place] = new
        if new != wanted:
            if count < _MAX_CHANGED:
                changed[count], added[count] = place, new - wanted
            count += 1
    if count > _MAX_CHANGED:
        return keep, True
    rows = len(p) // width
    for number in range(count):
        row, column = changed[number] // width, changed[number] % width
        for line in range(rows):
            first = (line - row + rows - 1) * (2 * width - 1) + width - 1 - column
            for place in range(width):
                u[line * width + place] += added[number] * near[first + place]
    return keep, False


class _Shear(NamedTuple):
    """State of the n pixels in contact; vectors have the shape (2, n), along x and y."""

    places: Int64  # (n,): indices in the field
    bound: Float32  # (n,): greatest traction
    wanted: Float32  # (2, n): wanted displacement
    q: Float32  # (2, n): traction
    rest: Float32  # (2, n): displacement that is still missing
    free: Float32  # (2, n): part of the rest that tractions can still produce
    last: Float32  # (2, n): free part in the step before
    steps: Float32  # (2, n): direction of the search
    curved: Float32  # (n,): curvature of the circle |q| = bound, as stiffness
    inverse: Float32  # (n,): inverse stiffness, by which the search is preconditioned
    out: Float32  # (2, n): direction of the traction of pixels that slip
    slips: Bool  # (n,)


@compiled
def _in_contact(bound: Float32) -> tuple[Int64, Float32]:
    """Return the indices of pixels with a bound above 0, and the bounds.

    Element by element, as everywhere in this file: numba takes seconds to compile operations on whole arrays.
    """
    count = 0
    for limit in bound:
        count += limit > 0.0
    places, bounds, number = np.empty(count, np.int64), np.empty(count, np.float32), 0
    for at in range(len(bound)):
        if bound[at] > 0.0:
            places[number], bounds[number] = at, bound[at]
            number += 1
    return places, bounds


@compiled
def shear(
    q: Float32,
    bound: Float32,
    wanted: Float32,
    slips: Bool,
    layer: Layer,
    work: Workspace,
    width: int,
    tolerance: float,
) -> int:
    """Solve for the tractions ``q`` of least energy with |q| <= ``bound``, beginning with those given.

    Projected conjugate gradients. A pixel at its limit that would slide further can only move along the
    circle |q| = bound, which is curved: multiplier / bound is added to the stiffness (Nocedal and Wright,
    Numerical Optimization, 2006, section 12.5). Returns the number of steps; the mask of pixels at their
    limit is written to ``slips``.
    """
    keep_apart()
    places, bounds = _in_contact(bound)
    count = len(places)
    pairs, kind = (2, count), np.float32
    state = _Shear(
        places,
        bounds,
        np.empty(pairs, kind),
        np.empty(pairs, kind),
        np.empty(pairs, kind),
        np.empty(pairs, kind),
        np.zeros(pairs, kind),
        np.zeros(pairs, kind),
        np.zeros(count, kind),
        np.zeros(count, kind),
        np.empty(pairs, kind),
        np.zeros(count, np.bool_),
    )
    for number in range(count):
        at = places[number]
        for axis in range(2):
            state.wanted[axis, number], state.q[axis, number] = wanted[axis, at], q[axis, at]
    largest = 0.0
    for number in range(count):
        _project(state.q, state.bound, number, state.slips[number])
        x, y = state.wanted[0, number], state.wanted[1, number]
        largest = max(largest, x * x + y * y)
    for at in range(len(bound)):
        q[0, at], q[1, at], slips[at] = 0.0, 0.0, False
    bend, old, step, since, is_stale = np.empty_like(q), 1.0, 0, 0, True
    while True:
        if is_stale:
            _put(state.q, q, state.places)
            respond(q, bend, layer, work, width)
            _rest(state, bend)
            since = 0
        is_done = _free_part(state, layer.own_shear) <= tolerance * math.sqrt(largest) or step == _MAX_STEPS
        if is_done and since == 0:
            break
        off = 0.0
        if not is_done:
            step, since = step + 1, since + 1
            old = _direction(state, old)
            _put(state.steps, q, state.places)
            respond(q, bend, layer, work, width)
            off = _move(state, bend)
        is_stale = is_done or off > _OFF_BOUNDS or since == _PROJECTED
        if is_stale:
            for number in range(count):
                _project(state.q, state.bound, number, state.slips[number])
    _put(state.q, q, state.places)
    for number in range(count):
        slips[places[number]] = state.slips[number]
    return step


@compiled
def _put(values: Float32, field: Float32, places: Int64) -> None:
    for number in range(len(places)):
        field[0, places[number]], field[1, places[number]] = values[0, number], values[1, number]


@compiled
def _project(q: Float32, bound: Float32, number: int, is_limit: bool) -> None:
    """Shorten a traction to its bound; with ``is_limit``, also lengthen it to the bound."""
    size = np.float32(math.sqrt(q[0, number] * q[0, number] + q[1, number] * q[1, number]))
    if size > bound[number] or (is_limit and size > 0.0):
        q[0, number] *= bound[number] / size
        q[1, number] *= bound[number] / size


@compiled
def _rest(state: _Shear, bend: Float32) -> None:
    """Write the displacement that pixels in contact still lack."""
    for number in range(len(state.places)):
        for axis in range(2):
            state.rest[axis, number] = state.wanted[axis, number] - bend[axis, state.places[number]]


@compiled
def _free_part(state: _Shear, own: float) -> float:
    """Write the free part of the missing displacement, and which pixels slip.

    ``own`` is the stiffness of a pixel. Returns the root mean square of the free part.
    """
    keep_apart()
    left, inverse = 0.0, np.float32(1.0 / own)
    for number in range(len(state.places)):
        q_x, q_y, limit = state.q[0, number], state.q[1, number], np.float32(_STICKS) * state.bound[number]
        rest_x, rest_y, square = state.rest[0, number], state.rest[1, number], q_x * q_x + q_y * q_y
        state.slips[number], state.curved[number], state.inverse[number] = False, 0.0, inverse
        if square >= limit * limit and rest_x * q_x + rest_y * q_y > 0.0:
            size = np.float32(math.sqrt(square))
            out_x, out_y = q_x / size, q_y / size
            outward = rest_x * out_x + rest_y * out_y
            state.out[0, number], state.out[1, number], state.slips[number] = out_x, out_y, True
            state.curved[number] = outward / state.bound[number]
            state.inverse[number] = 1.0 / (own + state.curved[number])
            rest_x, rest_y = rest_x - outward * out_x, rest_y - outward * out_y
        state.free[0, number], state.free[1, number] = rest_x, rest_y
        left += rest_x * rest_x + rest_y * rest_y
    return math.sqrt(left / max(len(state.places), 1))


@compiled
def _direction(state: _Shear, old: float) -> float:
    """Write the next direction: preconditioned, conjugate to the last one (Polak and Ribiere)."""
    keep_apart()
    new, changed = 0.0, 0.0
    for number in range(len(state.places)):
        inverse = state.inverse[number]
        for axis in range(2):
            free = state.free[axis, number]
            new += inverse * free * free
            changed += inverse * free * (free - state.last[axis, number])
            state.last[axis, number] = free
    keep = np.float32(max(changed / old, 0.0))
    for number in range(len(state.places)):
        inverse, step_x, step_y = state.inverse[number], state.steps[0, number], state.steps[1, number]
        if state.slips[number]:
            out_x, out_y = state.out[0, number], state.out[1, number]
            outward = step_x * out_x + step_y * out_y
            step_x, step_y = step_x - outward * out_x, step_y - outward * out_y
        state.steps[0, number] = inverse * state.free[0, number] + keep * step_x
        state.steps[1, number] = inverse * state.free[1, number] + keep * step_y
    return new


@compiled
def _move(state: _Shear, bend: Float32) -> float:
    """Step to the least energy along the direction; return the share of tractions off their bounds."""
    keep_apart()
    along, bent = 0.0, 0.0
    for number in range(len(state.places)):
        at, curved = state.places[number], state.curved[number]
        step_x, step_y = state.steps[0, number], state.steps[1, number]
        along += state.free[0, number] * step_x + state.free[1, number] * step_y
        bent += (bend[0, at] + curved * step_x) * step_x + (bend[1, at] + curved * step_y) * step_y
    length, off, whole = np.float32(along / bent if bent > 0.0 else 0.0), 0.0, 0.0
    for number in range(len(state.places)):
        at = state.places[number]
        for axis in range(2):
            state.q[axis, number] += length * state.steps[axis, number]
        state.rest[0, number] -= length * bend[0, at]
        state.rest[1, number] -= length * bend[1, at]
        q_x, q_y = state.q[0, number], state.q[1, number]
        size = math.sqrt(q_x * q_x + q_y * q_y)
        whole += size
        if size > state.bound[number] or state.slips[number]:
            off += abs(size - state.bound[number])
    return off / whole if whole > 0.0 else 0.0


@compiled
def solve(
    below_m: Float64,
    pixel_m: tuple[float, float],
    target: float,
    is_force: bool,
    friction: float,
    motion: tuple[float, float, float],
    layer: Layer,
    width: int,
    start: float,
    tolerance: tuple[float, float],
) -> tuple[Float64, Bool, Bool, float, float, int]:
    """Press the body in, then move it along x and y and turn it; see :func:`tactile_sim.solve_contact`.

    ``below_m`` (R, C) is how far the body is below its highest point, row 0 at the greatest y; rows of
    fields are counted from the least y. ``start`` is the pressure per depth of the first guess, Pa / m.
    Returns pressure, traction and displacement (6, R, C), masks of contact and stick, depth, error and steps.
    """
    rows, columns = below_m.shape
    size, kind = rows * width, np.float32
    work = work_of(layer, width)
    below = np.full((1, size), _FAR_M, kind)
    for row in range(rows):
        for column in range(columns):
            below[0, row * width + column] = below_m[rows - 1 - row, column]
    one, two = (1, size), (2, size)
    p, u, lifted, before = np.zeros(one, kind), np.empty(one, kind), np.zeros(one, kind), np.zeros(one, kind)
    q, side, wanted = np.zeros(two, kind), np.empty(two, kind), np.empty(two, kind)
    bound, slips, lowered = np.zeros(size, kind), np.zeros(size, np.bool_), np.empty(one, kind)
    _first_guess(p[0], below[0], target, is_force, start)
    steps, depth, error = 0, 0.0, 0.0
    for number in range(_MAX_PASSES):
        looseness = _FIRST_PASS if number == 0 and friction > 0.0 else 1.0
        press_tolerance, shear_tolerance = looseness * tolerance[0], looseness * tolerance[1]
        for place in range(size):
            lowered[0, place] = below[0, place] + lifted[0, place]
        depth, error, count = press(p, u, lowered, target, is_force, layer, work, width, press_tolerance)
        steps += count
        respond(p, side, layer, work, width)
        if friction == 0.0:
            break
        for place in range(size):
            bound[place] = friction * p[0, place]
            x = (place % width - (columns - 1) / 2) * pixel_m[0]
            y = (place // width - (rows - 1) / 2) * pixel_m[1]
            wanted[0, place] = motion[0] - motion[2] * y - side[0, place]
            wanted[1, place] = motion[1] + motion[2] * x - side[1, place]
        steps += shear(q, bound, wanted, slips, layer, work, width, shear_tolerance)
        for place in range(size):
            before[0, place] = lifted[0, place]
        respond(q, lifted, layer, work, width)
        change = 0.0
        for place in range(size):
            if p[0, place] > 0.0:
                change = max(change, abs(lifted[0, place] - before[0, place]))
        if number > 0 and change <= _COUPLED * tolerance[0] * depth:
            break
    respond(p, u, layer, work, width)
    respond(q, wanted, layer, work, width)
    fields = np.empty((6, rows, columns))
    contact, stick = np.empty((rows, columns), np.bool_), np.empty((rows, columns), np.bool_)
    for row in range(rows):
        for column in range(columns):
            at, line = row * width + column, rows - 1 - row
            fields[0, line, column] = p[0, at]
            for axis in range(2):
                fields[1 + axis, line, column] = q[axis, at]
                fields[3 + axis, line, column] = wanted[axis, at] + side[axis, at]
            fields[5, line, column] = u[0, at] + lifted[0, at]
            contact[line, column] = p[0, at] > 0.0
            stick[line, column] = bound[at] > 0.0 and not slips[at]
    return fields, contact, stick, depth, error, steps


@compiled
def _first_guess(p: Float32, below: Float32, target: float, is_force: bool, start: float) -> None:
    """Write the pressure of a bed of springs with the stiffness ``start``, Pa / m."""
    keep_apart()
    depth = target
    if is_force:
        # Bisection of the depth, from 0 to 1 m.
        low, high = 0.0, 1.0
        for _ in range(24):
            depth, total = (low + high) / 2, 0.0
            for value in below:
                total += max(depth - value, 0.0)
            if total * start > target:
                high = depth
            else:
                low = depth
    total = 0.0
    for place in range(len(p)):
        p[place] = start * max(depth - below[place], 0.0)
        total += p[place]
    if is_force:
        for place in range(len(p)):
            p[place] *= target / total
