"""Response of an elastic layer to loads on its surface, in numba: convolutions by Fourier transforms.

Each operation is an IEEE one in a fixed order, so results do not depend on the processor. Fields have shape
(1 or 2, R * W): y grows with the R rows, and W is a multiple of 32. Two real fields, or the two halves of
one, are transformed as one complex field: along y at first, LANES columns at once, then along x, LANES wave
numbers at once. Transforms are done in place: frequencies come out in the order of their reversed digits, and
go in so.

Numba's cache on disk does not check this file when it loads ``elastic_kernels.py``: when this one changes,
change that one, too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tactile_sim import elastic_vectors as vectors
from tactile_toolkit.array_types import Float32, Int64
from tactile_toolkit.kernels import compiled

LANES = vectors.LANES

# Names of this module, which numba can read.
forward_2, forward_3, forward_4 = vectors.forward_2, vectors.forward_3, vectors.forward_4
backward_2, backward_3, backward_4 = vectors.backward_2, vectors.backward_3, vectors.backward_4
transpose, split_fields, join_fields = vectors.transpose, vectors.split_fields, vectors.join_fields
copy_vector, keep_apart = vectors.copy_vector, vectors.keep_apart


class Transform(NamedTuple):
    """Transform of one length: radices, twiddle factors of all stages, and where each frequency lies."""

    length: int
    radices: Int64
    twiddles: Float32
    places: Int64


class Layer(NamedTuple):
    """An elastic layer under a window of pixels.

    ``across`` and ``down`` are the transforms along x and y. Spectra of the kernels, in the order of the
    transform, (groups, length of ``across``, LANES): those of "xz" and "yz" without the factor -i. ``near``
    is the kernel "zz" in space, (2 R - 1, 2 W - 1), and ``own_shear`` the displacement of a pixel by its own
    traction.
    """

    across: Transform
    down: Transform
    zz: Float32
    xx: Float32
    yy: Float32
    xy: Float32
    xz: Float32
    yz: Float32
    near: Float32
    own_shear: float


class Workspace(NamedTuple):
    """Work arrays of a convolution, real and imaginary: field, spectrum along y, both axes, result."""

    field: Float32
    down: Float32
    both: Float32
    answer: Float32


@compiled
def _forward(re: Float32, im: Float32, plan: Transform, groups: int) -> None:
    """Transform along the middle axis of (groups, length, LANES), given flat."""
    keep_apart()
    for group in range(groups):
        start, length, twiddle = group * plan.length * LANES, plan.length, 0
        for radix in plan.radices:
            step = length // radix
            for block in range(start, start + plan.length * LANES, length * LANES):
                for number in range(step):
                    at, first = block + number * LANES, twiddle + 2 * (radix - 1) * number
                    if radix == 4:
                        forward_4(re, im, plan.twiddles, at, step * LANES, first)
                    elif radix == 3:
                        forward_3(re, im, plan.twiddles, at, step * LANES, first)
                    else:
                        forward_2(re, im, plan.twiddles, at, step * LANES, first)
            twiddle += 2 * (radix - 1) * step
            length = step


@compiled
def _backward(re: Float32, im: Float32, plan: Transform, groups: int) -> None:
    """Undo :func:`_forward`, but for the factor of the length."""
    keep_apart()
    for group in range(groups):
        start, step, twiddle = group * plan.length * LANES, 1, len(plan.twiddles)
        for radix in plan.radices[::-1]:
            length = step * radix
            twiddle -= 2 * (radix - 1) * step
            for block in range(start, start + plan.length * LANES, length * LANES):
                for number in range(step):
                    at, first = block + number * LANES, twiddle + 2 * (radix - 1) * number
                    if radix == 4:
                        backward_4(re, im, plan.twiddles, at, step * LANES, first)
                    elif radix == 3:
                        backward_3(re, im, plan.twiddles, at, step * LANES, first)
                    else:
                        backward_2(re, im, plan.twiddles, at, step * LANES, first)
            step = length


@compiled
def work_of(layer: Layer, width: int) -> Workspace:
    """Return arrays for convolutions of fields of a width."""
    keep_apart()
    kept = len(layer.zz) // layer.across.length  # wave numbers along y, a multiple of LANES
    return Workspace(
        np.empty((2, width * layer.down.length), np.float32),
        np.zeros((2, 2 * width * kept), np.float32),
        np.empty((2, 2 * len(layer.zz)), np.float32),
        np.empty((2, 2 * len(layer.zz)), np.float32),
    )


@compiled
def _spectra(load: Float32, layer: Layer, work: Workspace, width: int) -> None:
    """Transform one real field, its halves as one complex field, or two."""
    keep_apart()
    down, across, size = layer.down, layer.across, len(layer.zz)
    kept, fields, rows = size // across.length, len(load), load.shape[1] // width
    columns = width * fields // 2
    groups = columns // LANES
    for part in range(2):
        source, first = load[part * (fields - 1)], part * (2 - fields) * columns
        field = work.field[part]
        for group in range(groups):
            for row in range(rows):
                at, place = (group * down.length + row) * LANES, row * width + first + group * LANES
                copy_vector(source, field, place, at)
            start = group * down.length
            for place in range((start + rows) * LANES, (start + down.length) * LANES):
                field[place] = 0.0
    _forward(work.field[0], work.field[1], down, groups)
    for group in range(groups):
        start, a, b = group * down.length, group * kept, (groups + group) * kept
        for wave in range(down.length // 2 + 1):
            at, mirror = down.places[wave], down.places[(down.length - wave) % down.length]
            split_fields(
                work.field[0],
                work.field[1],
                work.down[0],
                work.down[1],
                (start + at) * LANES,
                (start + mirror) * LANES,
                (a + wave) * LANES,
                (b + wave) * LANES,
            )
    each = 2 * groups // fields
    for part in range(2):
        source, target = work.down[part], work.both[part]
        for number in range(fields):
            for waves in range(kept // LANES):
                to = number * size + waves * across.length * LANES
                for group in range(each):
                    at = ((number * each + group) * kept + waves * LANES) * LANES
                    transpose(source, target, at, to + group * LANES * LANES)
                for place in range(to + each * LANES * LANES, to + across.length * LANES):
                    target[place] = 0.0
    _forward(work.both[0], work.both[1], across, fields * (kept // LANES))


@compiled
def _fields(out: Float32, layer: Layer, work: Workspace, width: int) -> None:
    """Transform the spectra of the result back to one real field or two."""
    keep_apart()
    down, across, size = layer.down, layer.across, len(layer.zz)
    kept, fields, rows = size // across.length, len(out), out.shape[1] // width
    columns = width * fields // 2
    groups = columns // LANES
    _backward(work.answer[0], work.answer[1], across, fields * (kept // LANES))
    each = 2 * groups // fields
    for part in range(2):
        source, target = work.answer[part], work.down[part]
        for number in range(fields):
            for waves in range(kept // LANES):
                at = number * size + waves * across.length * LANES
                for group in range(each):
                    to = ((number * each + group) * kept + waves * LANES) * LANES
                    transpose(source, target, at + group * LANES * LANES, to)
    for group in range(groups):
        start, a, b = group * down.length, group * kept, (groups + group) * kept
        for wave in range(down.length // 2 + 1):
            at, mirror = down.places[wave], down.places[(down.length - wave) % down.length]
            join_fields(
                work.down[0],
                work.down[1],
                work.field[0],
                work.field[1],
                (start + at) * LANES,
                (start + mirror) * LANES,
                (a + wave) * LANES,
                (b + wave) * LANES,
            )
    _backward(work.field[0], work.field[1], down, groups)
    for part in range(2):
        target, first = out[part * (fields - 1)], part * (2 - fields) * columns
        source = work.field[part]
        for group in range(groups):
            for row in range(rows):
                at, place = (group * down.length + row) * LANES, row * width + first + group * LANES
                copy_vector(source, target, at, place)


@compiled
def _times(out: Float32, a: Float32, kernel: Float32, sign: float) -> None:
    factor = np.float32(sign)
    for place in range(len(kernel)):
        out[place] = factor * a[place] * kernel[place]


@compiled
def _weighted(out: Float32, a: Float32, one: Float32, b: Float32, two: Float32, sign: float) -> None:
    keep_apart()
    factor = np.float32(sign)
    for place in range(len(one)):
        out[place] = factor * (a[place] * one[place] + b[place] * two[place])


@compiled
def respond(load: Float32, out: Float32, layer: Layer, work: Workspace, width: int) -> None:
    """Write the displacements (metres) for loads (Pa): one field is along z, two are along x and y."""
    keep_apart()
    _spectra(load, layer, work, width)
    size = len(layer.zz)
    for part in range(2):
        source, crossed, answer = work.both[part], work.both[1 - part], work.answer[part]
        sign = 1.0 - 2.0 * part
        if len(load) == len(out) == 1:
            _times(answer, source, layer.zz, 1.0)
        elif len(load) == len(out):
            _weighted(answer, source, layer.xx, source[size:], layer.xy, 1.0)
            _weighted(answer[size:], source, layer.xy, source[size:], layer.yy, 1.0)
        elif len(load) == 1:  # times -i
            _times(answer, crossed, layer.xz, sign)
            _times(answer[size:], crossed, layer.yz, sign)
        else:  # the mirror image
            _weighted(answer, crossed, layer.xz, crossed[size:], layer.yz, -sign)
    _fields(out, layer, work, width)
