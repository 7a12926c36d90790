"""Kernels of the elastic gel, in numba: convolution by Fourier transforms, contact, friction.

Vectors of :data:`LANES` numbers go through LLVM's vector instructions, which numba does not use by itself.
Each operation is an IEEE one in a fixed order, so results do not depend on the processor. All kernels lie in
this one file, because numba's cache on disk looks at the file of a kernel only.

Fields have shape (R, W): y grows with the rows, W is a multiple of 32, and columns beyond those of the window
are never in contact. Two real fields, or the two halves of one, are transformed as one complex field:
along y at first, LANES columns at once, then along x, LANES wave numbers at once. Transforms are done in
place: frequencies come out in the order of their digits reversed, and go in so.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from tactile_sim.taxim_kernels import spread
from tactile_toolkit.array_types import Bool, Float32, Int64
from tactile_toolkit.compiled import compiled

LANES = 16
"""Numbers that are computed at once."""

_SINE_60 = math.sqrt(0.75)
_PASSES = 2  # of pressure and shear, each with the displacement that the other one makes
_MOST_STEPS = 300
_MOST_CHANGED = 40  # pixels that join or leave the contact; for more of them a convolution is cheaper
_STICKS = 1.0 - 1e-5  # share of the largest traction below which a pixel is not at its limit; float32

Vector: TypeAlias = Any
Complex: TypeAlias = tuple[Vector, Vector]


class Transform(NamedTuple):
    """Transform of one length: radices, twiddle factors of all stages, and where each frequency lies."""

    length: int
    radices: Int64
    twiddles: Float32
    places: Int64


class Layer(NamedTuple):
    """An elastic layer under a window of pixels.

    ``across`` and ``down`` are the transforms along x and y. Spectra of the kernels, in the order of the
    transform, (groups, length of ``across``, LANES): those of "xz" and "yz" without the factor -i. ``near`` is
    the kernel "zz" in space, (2 R - 1, 2 W - 1).
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


class _Lanes:
    """Vectors of an array, and sums and products of complex ones, while code is built."""

    def __init__(self, context: Any, builder: Any, kinds: Any, arrays: Any) -> None:
        self.builder = builder
        self.kind = ir.VectorType(context.get_data_type(kinds[0].dtype), LANES)
        self.arrays = [
            context.make_array(kind)(context, builder, array).data
            for kind, array in zip(kinds, arrays, strict=True)
        ]

    def _pointer(self, array: int, place: Any) -> Any:
        builder: Any = self.builder
        return builder.bitcast(builder.gep(self.arrays[array], [place]), self.kind.as_pointer())

    def load(self, array: int, place: Any) -> Vector:
        return self.builder.load(self._pointer(array, place), align=4)

    def store(self, vector: Vector, array: int, place: Any) -> None:
        self.builder.store(vector, self._pointer(array, place), align=4)

    def number(self, array: int, place: Any) -> Vector:
        return spread(
            self.builder, self.builder.load(self.builder.gep(self.arrays[array], [place])), self.kind
        )

    def constant(self, value: float) -> Vector:
        return ir.Constant(self.kind, [value] * LANES)

    def add(self, a: Complex, b: Complex) -> Complex:
        return self.builder.fadd(a[0], b[0]), self.builder.fadd(a[1], b[1])

    def subtract(self, a: Complex, b: Complex) -> Complex:
        return self.builder.fsub(a[0], b[0]), self.builder.fsub(a[1], b[1])

    def scale(self, a: Complex, factor: Vector) -> Complex:
        return self.builder.fmul(a[0], factor), self.builder.fmul(a[1], factor)

    def turn(self, a: Complex, sign: int) -> Complex:
        """Multiply by i or -i."""
        zero = self.constant(-0.0)
        if sign > 0:
            return self.builder.fsub(zero, a[1]), a[0]
        return a[1], self.builder.fsub(zero, a[0])

    def multiply(self, a: Complex, b: Complex, is_conjugate: bool) -> Complex:
        build: Any = self.builder
        real, cross = build.fmul(a[0], b[0]), build.fmul(a[1], b[1])
        first, second = build.fmul(a[1], b[0]), build.fmul(a[0], b[1])
        if is_conjugate:
            return build.fadd(real, cross), build.fsub(first, second)
        return build.fsub(real, cross), build.fadd(first, second)


def _small_transform(lanes: _Lanes, x: list[Complex], sign: int) -> list[Complex]:
    """Transform 2, 3 or 4 numbers, with exp(sign * i ...)."""
    if len(x) == 2:
        return [lanes.add(x[0], x[1]), lanes.subtract(x[0], x[1])]
    if len(x) == 3:
        both = lanes.add(x[1], x[2])
        middle = lanes.subtract(x[0], lanes.scale(both, lanes.constant(0.5)))
        side = lanes.turn(lanes.scale(lanes.subtract(x[1], x[2]), lanes.constant(_SINE_60)), sign)
        return [lanes.add(x[0], both), lanes.add(middle, side), lanes.subtract(middle, side)]
    even, odd = lanes.add(x[0], x[2]), lanes.add(x[1], x[3])
    less, side = lanes.subtract(x[0], x[2]), lanes.turn(lanes.subtract(x[1], x[3]), sign)
    return [
        lanes.add(even, odd),
        lanes.add(less, side),
        lanes.subtract(even, odd),
        lanes.subtract(less, side),
    ]


def _butterfly(radix: int, sign: int) -> Any:
    """Return a step of a transform: ``radix`` vectors, ``step`` apart from ``at`` on, in place.

    Forward (sign -1) the results are multiplied by twiddle factors, backward the numbers before.
    """

    def typed(
        _typing: Any, re: Any, im: Any, twiddles: Any, at: Any, step: Any, first: Any
    ) -> tuple[Any, Callable[..., Any]]:
        place = types.int64

        def build(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            lanes = _Lanes(context, builder, signature.args[:3], given[:3])
            places = [given[3]]
            for _ in range(radix - 1):
                places.append(builder.add(places[-1], given[4]))
            x = [(lanes.load(0, here), lanes.load(1, here)) for here in places]
            one = ir.Constant(given[5].type, 1)
            factors, here = [], given[5]
            for _ in range(radix - 1):
                pair = []
                for _ in range(2):
                    pair.append(lanes.number(2, here))
                    here = builder.add(here, one)
                factors.append((pair[0], pair[1]))
            if sign > 0:
                x[1:] = [lanes.multiply(a, b, True) for a, b in zip(x[1:], factors, strict=True)]
            y = _small_transform(lanes, x, sign)
            if sign < 0:
                y[1:] = [lanes.multiply(a, b, False) for a, b in zip(y[1:], factors, strict=True)]
            for (real, imaginary), here in zip(y, places, strict=True):
                lanes.store(real, 0, here)
                lanes.store(imaginary, 1, here)
            return context.get_dummy_value()

        return types.void(re, im, twiddles, place, place, place), build

    return intrinsic(typed)


forward_2, forward_3, forward_4 = (_butterfly(radix, -1) for radix in (2, 3, 4))
backward_2, backward_3, backward_4 = (_butterfly(radix, 1) for radix in (2, 3, 4))


def _transpose(_typing: Any, source: Any, target: Any, at: Any, to: Any) -> tuple[Any, Callable[..., Any]]:
    """Transpose LANES x LANES numbers, contiguous from ``at`` on, to ``to``."""

    def build(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        lanes = _Lanes(context, builder, signature.args[:2], given[:2])
        kind = given[2].type

        def row(start: Any, number: int) -> Any:
            return builder.add(start, ir.Constant(kind, number * LANES))

        rows = [lanes.load(0, row(given[2], number)) for number in range(LANES)]
        # Rows that lie half of their number apart are merged, four times over: a perfect shuffle each time.
        low, high = (
            ir.Constant(
                ir.VectorType(ir.IntType(32), LANES),
                [(LANES * (number % 2) + number // 2 + start) for number in range(LANES)],
            )
            for start in (0, LANES // 2)
        )
        for _ in range(LANES.bit_length() - 1):
            merged = []
            for number in range(LANES // 2):
                pair = (rows[number], rows[number + LANES // 2])
                merged += [builder.shuffle_vector(*pair, low), builder.shuffle_vector(*pair, high)]
            rows = merged
        for number, vector in enumerate(rows):
            lanes.store(vector, 1, row(given[3], number))
        return context.get_dummy_value()

    return types.void(source, target, types.int64, types.int64), build


transpose: Any = intrinsic(_transpose)


def _split(
    _typing: Any, re: Any, im: Any, out_re: Any, out_im: Any, at: Any, mirror: Any, first: Any, second: Any
) -> tuple[Any, Callable[..., Any]]:
    """Write twice the spectra of the two real fields of a complex one: at k, from k and -k."""

    def build(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        lanes = _Lanes(context, builder, signature.args[:4], given[:4])
        here, there = ((lanes.load(0, place), lanes.load(1, place)) for place in given[4:6])
        both, less = lanes.add(here, there), lanes.subtract(here, there)
        lanes.store(both[0], 2, given[6])
        lanes.store(less[1], 3, given[6])
        lanes.store(both[1], 2, given[7])
        lanes.store(builder.fsub(there[0], here[0]), 3, given[7])
        return context.get_dummy_value()

    place = types.int64
    return types.void(re, im, out_re, out_im, place, place, place, place), build


split_fields: Any = intrinsic(_split)


def _join(
    _typing: Any, re: Any, im: Any, out_re: Any, out_im: Any, at: Any, mirror: Any, first: Any, second: Any
) -> tuple[Any, Callable[..., Any]]:
    """Write the spectrum of a complex field at k and -k, of the spectra of its two real ones at k."""

    def build(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        lanes = _Lanes(context, builder, signature.args[:4], given[:4])
        a, b = ((lanes.load(0, place), lanes.load(1, place)) for place in given[6:8])
        lanes.store(builder.fsub(a[0], b[1]), 2, given[4])
        lanes.store(builder.fadd(a[1], b[0]), 3, given[4])
        lanes.store(builder.fadd(a[0], b[1]), 2, given[5])
        lanes.store(builder.fsub(b[0], a[1]), 3, given[5])
        return context.get_dummy_value()

    place = types.int64
    return types.void(re, im, out_re, out_im, place, place, place, place), build


join_fields: Any = intrinsic(_join)


@compiled
def _forward(re: Float32, im: Float32, plan: Transform, groups: int) -> None:
    """Transform along the middle axis of (groups, length, LANES), given flat."""
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


class _Work(NamedTuple):
    """Arrays that convolutions use: complex fields, their two spectra along y, both along x, and products."""

    field_re: Float32
    field_im: Float32
    down_re: Float32
    down_im: Float32
    re: Float32
    im: Float32
    mixed_re: Float32
    mixed_im: Float32


@compiled
def _work_of(layer: Layer, width: int) -> _Work:
    field = width * layer.down.length
    kept = len(layer.zz) // layer.across.length  # wave numbers along y, a multiple of LANES
    down, both = 2 * width * kept, 2 * len(layer.zz)
    empty = np.float32
    return _Work(
        np.empty(field, empty),
        np.empty(field, empty),
        np.zeros(down, empty),
        np.zeros(down, empty),
        np.empty(both, empty),
        np.empty(both, empty),
        np.empty(both, empty),
        np.empty(both, empty),
    )


@compiled
def _load(field: Float32, out: Float32, first: int, width: int, columns: int, length: int) -> None:
    """Copy columns of a field to (groups, length, LANES), rows below it 0."""
    rows = len(field) // width
    for group in range(columns // LANES):
        for row in range(rows):
            at, source = (group * length + row) * LANES, row * width + first + group * LANES
            for lane in range(LANES):
                out[at + lane] = field[source + lane]
        out[(group * length + rows) * LANES : (group + 1) * length * LANES] = 0.0


@compiled
def _unload(source: Float32, field: Float32, first: int, width: int, columns: int, length: int) -> None:
    rows = len(field) // width
    for group in range(columns // LANES):
        for row in range(rows):
            at, to = (group * length + row) * LANES, row * width + first + group * LANES
            for lane in range(LANES):
                field[to + lane] = source[at + lane]


@compiled
def _spectra(layer: Layer, work: _Work, groups: int, fields: int) -> None:
    """Transform the complex field of ``work`` to the spectra of one real field, its halves, or of two."""
    down, across = layer.down, layer.across
    _forward(work.field_re, work.field_im, down, groups)
    size = len(layer.zz)
    kept = size // across.length
    for group in range(groups):
        start, a, b = group * down.length, group * kept, (groups + group) * kept
        for wave in range(down.length // 2 + 1):
            split_fields(
                work.field_re,
                work.field_im,
                work.down_re,
                work.down_im,
                (start + down.places[wave]) * LANES,
                (start + down.places[(down.length - wave) % down.length]) * LANES,
                (a + wave) * LANES,
                (b + wave) * LANES,
            )
    each = 2 * groups // fields
    for field in range(fields):
        for waves in range(kept // LANES):
            to = field * size + waves * across.length * LANES
            for group in range(each):
                at = ((field * each + group) * kept + waves * LANES) * LANES
                transpose(work.down_re, work.re, at, to + group * LANES * LANES)
                transpose(work.down_im, work.im, at, to + group * LANES * LANES)
            work.re[to + each * LANES * LANES : to + across.length * LANES] = 0.0
            work.im[to + each * LANES * LANES : to + across.length * LANES] = 0.0
    _forward(work.re, work.im, across, fields * (kept // LANES))


@compiled
def _fields(layer: Layer, work: _Work, groups: int, fields: int) -> None:
    """Undo :func:`_spectra` for the products in ``work``."""
    down, across = layer.down, layer.across
    size = len(layer.zz)
    kept = size // across.length
    _backward(work.mixed_re, work.mixed_im, across, fields * (kept // LANES))
    each = 2 * groups // fields
    for field in range(fields):
        for waves in range(kept // LANES):
            at = field * size + waves * across.length * LANES
            for group in range(each):
                to = ((field * each + group) * kept + waves * LANES) * LANES
                transpose(work.mixed_re, work.down_re, at + group * LANES * LANES, to)
                transpose(work.mixed_im, work.down_im, at + group * LANES * LANES, to)
    for group in range(groups):
        start, a, b = group * down.length, group * kept, (groups + group) * kept
        for wave in range(down.length // 2 + 1):
            join_fields(
                work.down_re,
                work.down_im,
                work.field_re,
                work.field_im,
                (start + down.places[wave]) * LANES,
                (start + down.places[(down.length - wave) % down.length]) * LANES,
                (a + wave) * LANES,
                (b + wave) * LANES,
            )
    _backward(work.field_re, work.field_im, down, groups)


@compiled
def _one_field(field: Float32, layer: Layer, work: _Work, width: int) -> None:
    half, length = width // 2, layer.down.length
    _load(field, work.field_re, 0, width, half, length)
    _load(field, work.field_im, half, width, half, length)
    _spectra(layer, work, half // LANES, 1)


@compiled
def _two_fields(x: Float32, y: Float32, layer: Layer, work: _Work, width: int) -> None:
    _load(x, work.field_re, 0, width, width, layer.down.length)
    _load(y, work.field_im, 0, width, width, layer.down.length)
    _spectra(layer, work, width // LANES, 2)


@compiled
def _to_one_field(out: Float32, layer: Layer, work: _Work, width: int) -> None:
    half, length = width // 2, layer.down.length
    _fields(layer, work, half // LANES, 1)
    _unload(work.field_re, out, 0, width, half, length)
    _unload(work.field_im, out, half, width, half, length)


@compiled
def _to_two_fields(x: Float32, y: Float32, layer: Layer, work: _Work, width: int) -> None:
    _fields(layer, work, width // LANES, 2)
    _unload(work.field_re, x, 0, width, width, layer.down.length)
    _unload(work.field_im, y, 0, width, width, layer.down.length)


@compiled
def _times(out: Float32, a: Float32, kernel: Float32) -> None:
    for place in range(len(kernel)):
        out[place] = a[place] * kernel[place]


@compiled
def _weighted(out: Float32, a: Float32, one: Float32, b: Float32, two: Float32) -> None:
    for place in range(len(one)):
        out[place] = a[place] * one[place] + b[place] * two[place]


@compiled
def _negated(values: Float32) -> None:
    for place in range(len(values)):
        values[place] = -values[place]


@compiled
def sink(pressure: Float32, out: Float32, layer: Layer, work: _Work, width: int) -> None:
    """Displacement along z by pressure."""
    _one_field(pressure, layer, work, width)
    _times(work.mixed_re, work.re, layer.zz)
    _times(work.mixed_im, work.im, layer.zz)
    _to_one_field(out, layer, work, width)


@compiled
def drag(
    x: Float32, y: Float32, out_x: Float32, out_y: Float32, layer: Layer, work: _Work, width: int
) -> None:
    """Displacement along x and y by tractions."""
    _two_fields(x, y, layer, work, width)
    size = len(layer.zz)
    for mixed, plane in ((work.mixed_re, work.re), (work.mixed_im, work.im)):
        _weighted(mixed, plane, layer.xx, plane[size:], layer.xy)
        _weighted(mixed[size:], plane, layer.xy, plane[size:], layer.yy)
    _to_two_fields(out_x, out_y, layer, work, width)


@compiled
def squeeze(pressure: Float32, out_x: Float32, out_y: Float32, layer: Layer, work: _Work, width: int) -> None:
    """Displacement along x and y by pressure."""
    _one_field(pressure, layer, work, width)
    size = len(layer.zz)
    for start, kernel in ((0, layer.xz), (size, layer.yz)):
        # Times -i.
        _times(work.mixed_re[start:], work.im, kernel)
        _times(work.mixed_im[start:], work.re, kernel)
        _negated(work.mixed_im[start : start + size])
    _to_two_fields(out_x, out_y, layer, work, width)


@compiled
def lift(x: Float32, y: Float32, out: Float32, layer: Layer, work: _Work, width: int) -> None:
    """Displacement along z by tractions: the mirror image of :func:`squeeze`."""
    _two_fields(x, y, layer, work, width)
    size = len(layer.zz)
    _weighted(work.mixed_re, work.im, layer.xz, work.im[size:], layer.yz)
    _negated(work.mixed_re[:size])
    _weighted(work.mixed_im, work.re, layer.xz, work.re[size:], layer.yz)
    _to_one_field(out, layer, work, width)


@compiled
def press(
    p: Float32,
    u: Float32,
    below: Float32,
    target: float,
    is_force: bool,
    layer: Layer,
    work: _Work,
    width: int,
    tolerance: float,
) -> tuple[float, float, int]:
    """Solve for pressure, from ``p`` on: Polonsky and Keer, Wear 231, 1999, section 3.

    ``target`` is the sum of the pressure, or the depth; ``below`` how far the body lies below its highest
    point. ``u`` gets the displacement. Returned are depth, largest error of the gap relative to it, and steps.
    """
    t, r, gap = np.zeros_like(p), np.empty_like(p), np.empty_like(p)
    old, keep, depth, error, step = 1.0, 0.0, target, np.inf, 0
    sink(p, u, layer, work, width)
    while True:
        depth, square, error, lowest = _gaps(p, u, below, gap, target, is_force)
        if (error <= tolerance * depth and lowest >= -tolerance * depth) or step == _MOST_STEPS:
            break
        step += 1
        factor = np.float32(keep * square / old)
        old = square
        for place in range(len(p)):
            t[place] = gap[place] + factor * t[place] if p[place] > 0.0 else np.float32(0.0)
        sink(t, r, layer, work, width)
        length = _step_length(p, gap, t, r, is_force)
        keep = _take_step(p, u, gap, t, r, length, layer, work, width)
        if is_force:
            total = 0.0
            for value in p:
                total += value
            scale = np.float32(target / total)
            for place in range(len(p)):
                p[place] *= scale
                u[place] *= scale
    return depth, error / depth, step


@compiled
def _gaps(
    p: Float32, u: Float32, below: Float32, gap: Float32, target: float, is_force: bool
) -> tuple[float, float, float, float]:
    """Write the gaps; return the depth, their sum of squares and largest in the contact, lowest outside."""
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
    return depth, square, error, lowest


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
    layer: Layer,
    work: _Work,
    width: int,
) -> float:
    """Change pressure and displacement; return 1 if no pixel joined the contact, 0 otherwise."""
    changed, added = np.empty(_MOST_CHANGED, np.int64), np.empty(_MOST_CHANGED, np.float32)
    count, keep, tau = 0, 1.0, np.float32(length)
    # The first step of a contact of one pixel has no length: what overlaps joins with that of its own.
    joins = tau if tau > 0.0 else np.float32(1.0) / layer.near[len(layer.near) // 2]
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
            if count < _MOST_CHANGED:
                changed[count], added[count] = place, new - wanted
            count += 1
    if count > _MOST_CHANGED:
        sink(p, u, layer, work, width)
        return keep
    rows = len(p) // width
    for number in range(count):
        row, column = changed[number] // width, changed[number] % width
        for line in range(rows):
            first = (line - row + rows - 1) * (2 * width - 1) + width - 1 - column
            _add_scaled(u, line * width, layer.near, first, width, added[number])
    return keep


@compiled
def _add_scaled(out: Float32, at: int, values: Float32, first: int, count: int, factor: float) -> None:
    for place in range(count):
        out[at + place] += factor * values[first + place]


class _Shear(NamedTuple):
    """State of the pixels in contact, by their number: traction, what is left to move, direction, bound."""

    places: Int64
    bound: Float32
    wanted: Float32
    q: Float32
    rest: Float32
    free: Float32
    last: Float32
    steps: Float32
    curved: Float32
    slips: Bool


@compiled
def shear(
    x: Float32,
    y: Float32,
    bound: Float32,
    wanted_x: Float32,
    wanted_y: Float32,
    slips: Bool,
    layer: Layer,
    work: _Work,
    width: int,
    tolerance: float,
) -> int:
    """Solve for the tractions ``x`` and ``y``, from those given on: least energy with |q| <= ``bound``.

    Projected conjugate gradients. A pixel at its limit that would slide on has only the direction along the
    circle |q| = bound, which is curved: multiplier / bound is added to the stiffness (Nocedal and Wright,
    Numerical Optimization, 2006, section 12.5). Returned is the number of steps; ``slips`` gets the pixels
    at their limit.
    """
    places = np.nonzero(bound > 0.0)[0]
    count = len(places)
    pairs = (2, count)
    kind = np.float32
    state = _Shear(
        places,
        bound[places],
        np.empty(pairs, kind),
        np.empty(pairs, kind),
        np.empty(pairs, kind),
        np.empty(pairs, kind),
        np.zeros(pairs, kind),
        np.zeros(pairs, kind),
        np.zeros(count, kind),
        np.zeros(count, np.bool_),
    )
    for number in range(count):
        at = places[number]
        state.wanted[0, number], state.wanted[1, number] = wanted_x[at], wanted_y[at]
        state.q[0, number], state.q[1, number] = x[at], y[at]
    largest = 0.0
    for number in range(count):
        _project(state.q, state.bound, number, False)
        largest = max(largest, math.hypot(state.wanted[0, number], state.wanted[1, number]))
    x[:], y[:] = 0.0, 0.0
    bend_x, bend_y = np.empty_like(x), np.empty_like(y)
    _rest(state, x, y, bend_x, bend_y, layer, work, width)
    old, step = 1.0, 0
    while step < _MOST_STEPS:
        left, is_same = _free_part(state)
        if left <= tolerance * largest:
            break
        step += 1
        new = _direction(state, layer.own_shear, old, is_same)
        for number in range(count):
            x[places[number]], y[places[number]] = state.steps[0, number], state.steps[1, number]
        drag(x, y, bend_x, bend_y, layer, work, width)
        _move(state, bend_x, bend_y)
        _rest(state, x, y, bend_x, bend_y, layer, work, width)
        old = new
    slips[:] = False
    for number in range(count):
        x[places[number]], y[places[number]] = state.q[0, number], state.q[1, number]
        slips[places[number]] = state.slips[number]
    return step


@compiled
def _project(q: Float32, bound: Float32, number: int, is_limit: bool) -> None:
    """Shorten a traction to its bound, or give it that length."""
    size = np.float32(math.sqrt(q[0, number] * q[0, number] + q[1, number] * q[1, number]))
    if size > bound[number] or (is_limit and size > 0.0):
        q[0, number] *= bound[number] / size
        q[1, number] *= bound[number] / size


@compiled
def _rest(
    state: _Shear,
    x: Float32,
    y: Float32,
    bend_x: Float32,
    bend_y: Float32,
    layer: Layer,
    work: _Work,
    width: int,
) -> None:
    """Write how far the pixels in contact still have to move."""
    for number in range(len(state.places)):
        x[state.places[number]], y[state.places[number]] = state.q[0, number], state.q[1, number]
    drag(x, y, bend_x, bend_y, layer, work, width)
    for number in range(len(state.places)):
        at = state.places[number]
        state.rest[0, number] = state.wanted[0, number] - bend_x[at]
        state.rest[1, number] = state.wanted[1, number] - bend_y[at]


@compiled
def _free_part(state: _Shear) -> tuple[float, bool]:
    """Write the part of what is left that tractions may still follow; return its largest, and whether the
    same pixels slip as before."""
    left, is_same = 0.0, True
    for number in range(len(state.places)):
        bound = state.bound[number]
        out_x, out_y = state.q[0, number] / bound, state.q[1, number] / bound
        rest_x, rest_y = state.rest[0, number], state.rest[1, number]
        outward = rest_x * out_x + rest_y * out_y
        slips = outward > 0.0 and out_x * out_x + out_y * out_y >= _STICKS
        is_same = is_same and slips == state.slips[number]
        state.slips[number] = slips
        state.curved[number] = outward / bound if slips else np.float32(0.0)
        if slips:
            rest_x, rest_y = rest_x - outward * out_x, rest_y - outward * out_y
        state.free[0, number], state.free[1, number] = rest_x, rest_y
        left = max(left, math.sqrt(rest_x * rest_x + rest_y * rest_y))
    return left, is_same


@compiled
def _direction(state: _Shear, own: float, old: float, is_same: bool) -> float:
    """Write the next direction: preconditioned, conjugate to the last one (Polak and Ribiere)."""
    new, changed = 0.0, 0.0
    for number in range(len(state.places)):
        inverse = 1.0 / (own + state.curved[number])
        for axis in range(2):
            free = state.free[axis, number]
            new += inverse * free * free
            changed += inverse * free * (free - state.last[axis, number])
            state.last[axis, number] = free
    keep = 0.0
    if is_same:
        keep = max(changed / old, 0.0)
    for number in range(len(state.places)):
        inverse, bound = 1.0 / (own + state.curved[number]), state.bound[number]
        step_x, step_y = state.steps[0, number], state.steps[1, number]
        if state.slips[number]:
            out_x, out_y = state.q[0, number] / bound, state.q[1, number] / bound
            outward = step_x * out_x + step_y * out_y
            step_x, step_y = step_x - outward * out_x, step_y - outward * out_y
        state.steps[0, number] = inverse * state.free[0, number] + keep * step_x
        state.steps[1, number] = inverse * state.free[1, number] + keep * step_y
    return new


@compiled
def _move(state: _Shear, bend_x: Float32, bend_y: Float32) -> None:
    """Go along the direction to the least energy, and back to the bounds."""
    along, bent = 0.0, 0.0
    for number in range(len(state.places)):
        at, curved = state.places[number], state.curved[number]
        step_x, step_y = state.steps[0, number], state.steps[1, number]
        along += state.free[0, number] * step_x + state.free[1, number] * step_y
        bent += (bend_x[at] + curved * step_x) * step_x + (bend_y[at] + curved * step_y) * step_y
    length = np.float32(along / bent if bent > 0.0 else 0.0)
    for number in range(len(state.places)):
        state.q[0, number] += length * state.steps[0, number]
        state.q[1, number] += length * state.steps[1, number]
        _project(state.q, state.bound, number, state.slips[number])


@compiled
def solve(
    below_m: Any,
    pixel_m: tuple[float, float],
    target: float,
    is_force: bool,
    friction: float,
    motion: tuple[float, float, float],
    layer: Layer,
    width: int,
    start: float,
    tolerance: tuple[float, float],
) -> Any:
    """Press, then move along x and y and turn; see :func:`tactile_sim.solve_contact`.

    ``below_m`` (R, C) is how far the body lies below its highest point, row 0 at the greatest y; pixels of
    fields are counted from the least y. ``start`` is the pressure per depth of the first guess.
    """
    rows, columns = below_m.shape
    size = rows * width
    kind = np.float32
    work = _work_of(layer, width)
    below, lifted = np.full(size, 1e6, kind), np.zeros(size, kind)
    for row in range(rows):
        for column in range(columns):
            below[row * width + column] = below_m[rows - 1 - row, column]
    p, u, x, y = np.zeros(size, kind), np.empty(size, kind), np.zeros(size, kind), np.zeros(size, kind)
    side_x, side_y, slips = np.zeros(size, kind), np.zeros(size, kind), np.zeros(size, np.bool_)
    wanted_x, wanted_y, bound = np.zeros(size, kind), np.zeros(size, kind), np.zeros(size, kind)
    _first_guess(p, below, target, is_force, start)
    steps, depth, error = 0, 0.0, 0.0
    for number in range(_PASSES if friction > 0.0 else 1):
        surface = below + lifted
        depth, error, count = press(p, u, surface, target, is_force, layer, work, width, tolerance[0])
        steps += count
        squeeze(p, side_x, side_y, layer, work, width)
        if friction > 0.0:
            for place in range(size):
                bound[place] = friction * p[place]
                at_x = (place % width - (columns - 1) / 2) * pixel_m[0]
                at_y = (place // width - (rows - 1) / 2) * pixel_m[1]
                wanted_x[place] = motion[0] - motion[2] * at_y - side_x[place]
                wanted_y[place] = motion[1] + motion[2] * at_x - side_y[place]
            steps += shear(x, y, bound, wanted_x, wanted_y, slips, layer, work, width, tolerance[1])
            lift(x, y, lifted, layer, work, width)
    sink(p, u, layer, work, width)
    drag(x, y, wanted_x, wanted_y, layer, work, width)
    fields = np.empty((rows, columns, 6), np.float64)
    contact, stick = np.empty((rows, columns), np.bool_), np.empty((rows, columns), np.bool_)
    for row in range(rows):
        for column in range(columns):
            at, out = row * width + column, fields[rows - 1 - row, column]
            out[0], out[1], out[2] = p[at], x[at], y[at]
            out[3], out[4] = wanted_x[at] + side_x[at], wanted_y[at] + side_y[at]
            out[5] = u[at] + lifted[at]
            contact[rows - 1 - row, column] = p[at] > 0.0
            stick[rows - 1 - row, column] = bound[at] > 0.0 and not slips[at]
    return fields, contact, stick, depth, error, steps


@compiled
def _first_guess(p: Float32, below: Float32, target: float, is_force: bool, start: float) -> None:
    """Write the pressure of a bed of springs, ``start`` Pa per metre."""
    depth = target
    if is_force:
        # The depth lies between those of one pixel and of all.
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


@compiled
def product(left: Any, right: Any) -> Any:
    """Return a matrix product, added up in the order of the numbers."""
    out = np.zeros((left.shape[0], right.shape[1]))
    for row in range(left.shape[0]):
        for inner in range(left.shape[1]):
            factor = left[row, inner]
            for column in range(right.shape[1]):
                out[row, column] += factor * right[inner, column]
    return out


@compiled
def bessel_integrals(radii: Any, waves: Any, integrands: Any) -> Any:
    """Return sums over waves of four integrands, with J0, J0, J1 and J2 of wave times radius.

    Bessel functions follow from their recurrence downwards (Miller; Abramowitz and Stegun, 9.12).
    """
    out = np.zeros((4, len(radii)))
    for number in range(len(radii)):
        for wave in range(len(waves)):
            phase = radii[number] * waves[wave]
            values = (1.0, 0.5 * phase, 0.125 * phase * phase)
            if phase > 1e-6:
                values = _bessel(phase)
            out[0, number] += integrands[0, wave] * values[0]
            out[1, number] += integrands[1, wave] * values[0]
            out[2, number] += integrands[2, wave] * values[1]
            out[3, number] += integrands[3, wave] * values[2]
    return out


@compiled
def _bessel(phase: float) -> tuple[float, float, float]:
    order = 2 * int((phase + 4.0 * math.sqrt(phase) + 24.0) / 2.0)
    above, here, second, total, inverse = 0.0, 1e-280, 0.0, 0.0, 2.0 / phase
    while order > 0:
        if order == 2:
            second = here
        if order % 2 == 0:
            total += 2.0 * here
        above, here = here, order * inverse * here - above
        order -= 1
        if abs(here) > 1e200:
            above, here, second, total = above * 1e-200, here * 1e-200, second * 1e-200, total * 1e-200
    total += here
    return here / total, above / total, second / total


@compiled
def block_means(heights: Any, block_px: int) -> Any:
    """Return means over blocks of pixels, (H / block_px, W / block_px)."""
    rows, columns = heights.shape[0] // block_px, heights.shape[1] // block_px
    out = np.zeros((rows, columns))
    for row in range(rows):
        for line in range(row * block_px, (row + 1) * block_px):
            for column in range(columns):
                for place in range(column * block_px, (column + 1) * block_px):
                    out[row, column] += heights[line, place]
    return out / (block_px * block_px)


@compiled
def bring_up(fields: Any, is_contact: Any, is_stick: Any, block_px: int) -> Any:
    """Return fields (H, W, 6) and masks of blocks in the size of their pixels, linear between their centres."""
    rows, columns, count = fields.shape
    tall, wide = rows * block_px, columns * block_px
    out = np.empty((tall, wide, count))
    contact, stick = np.empty((tall, wide), np.bool_), np.empty((tall, wide), np.bool_)
    line = np.empty((columns, count + 2))
    for row in range(tall):
        place = min(max((row + 0.5) / block_px - 0.5, 0.0), rows - 1.0)
        above = min(int(place), max(rows - 2, 0))
        low, part = min(above + 1, rows - 1), place - above
        for column in range(columns):
            for field in range(count):
                first, second = fields[above, column, field], fields[low, column, field]
                line[column, field] = first + part * (second - first)
            touches, sticks = float(is_contact[above, column]), float(is_stick[above, column])
            line[column, count] = touches + part * (float(is_contact[low, column]) - touches)
            line[column, count + 1] = sticks + part * (float(is_stick[low, column]) - sticks)
        for column in range(wide):
            place = min(max((column + 0.5) / block_px - 0.5, 0.0), columns - 1.0)
            left = min(int(place), max(columns - 2, 0))
            right, part = min(left + 1, columns - 1), place - left
            for field in range(count):
                first = line[left, field]
                out[row, column, field] = first + part * (line[right, field] - first)
            contact[row, column] = (1 - part) * line[left, count] + part * line[right, count] > 0.5
            stick[row, column] = (1 - part) * line[left, count + 1] + part * line[right, count + 1] > 0.5
    return out, contact, stick


@compiled
def follow_body(fields: Any, is_contact: Any, body_m: Any) -> None:
    """Put the surface on the body, (H, W), where they touch, and nowhere into it."""
    rows, columns = body_m.shape
    for row in range(rows):
        for column in range(columns):
            surface = fields[row, column, 5]
            if is_contact[row, column] or body_m[row, column] > surface:
                fields[row, column, 5] = body_m[row, column]
                is_contact[row, column] = True


@compiled
def resultants(
    fields: Any, pixel_m: tuple[float, float]
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return the force (N) and the torque (N m) about the centre of pressures and tractions (Pa)."""
    rows, columns = fields.shape[:2]
    area = pixel_m[0] * pixel_m[1]
    force_x, force_y, force_z, about_x, about_y, about_z = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for row in range(rows):
        y = ((rows - 1) / 2 - row) * pixel_m[1]
        for column in range(columns):
            x = (column - (columns - 1) / 2) * pixel_m[0]
            p, q_x, q_y = fields[row, column, 0], fields[row, column, 1], fields[row, column, 2]
            force_x, force_y, force_z = force_x + q_x, force_y + q_y, force_z + p
            about_x, about_y, about_z = about_x + y * p, about_y - x * p, about_z + (x * q_y - y * q_x)
    return (
        (force_x * area, force_y * area, force_z * area),
        (about_x * area, about_y * area, about_z * area),
    )
