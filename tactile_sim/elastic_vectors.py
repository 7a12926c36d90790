"""Steps of Fourier transforms on vectors of numbers, as vector instructions of LLVM, which numba lacks.

Each operation is one of IEEE 754, in the written order. Arrays are flat; a vector may start at any
index. Numba's cache on disk does not check this file: when it changes, change ``elastic_response.py`` and
``elastic_kernels.py``, too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TypeAlias

from llvmlite import ir
from numba import types
from numba.core.types import Array, Type
from numba.core.typing.templates import Signature
from numba.extending import intrinsic

from tactile_sim.taxim_kernels import Build, Context, spread

LANES = 16
"""Numbers that are computed at once."""

_SINE_60 = math.sqrt(0.75)

Vector: TypeAlias = ir.Value
Complex: TypeAlias = tuple[Vector, Vector]
Typed: TypeAlias = tuple[Signature, Build]
"""Signature of an intrinsic, and the function that writes its instructions."""

Intrinsic: TypeAlias = Callable[..., None]


class _Lanes:
    """Builds code that loads and stores vectors of arrays, and adds and multiplies complex ones."""

    def __init__(
        self,
        context: Context,
        builder: ir.IRBuilder,
        kinds: Sequence[Array],
        arrays: Sequence[ir.Value],
    ) -> None:
        self.builder = builder
        self.kind = ir.VectorType(context.get_data_type(kinds[0].dtype), LANES)
        self.arrays = [
            context.make_array(kind)(context, builder, array).data
            for kind, array in zip(kinds, arrays, strict=True)
        ]

    def _pointer(self, array: int, place: ir.Value) -> ir.Value:
        builder = self.builder
        return builder.bitcast(builder.gep(self.arrays[array], [place]), self.kind.as_pointer())

    def load(self, array: int, place: ir.Value) -> Vector:
        return self.builder.load(self._pointer(array, place), align=4)

    def store(self, vector: Vector, array: int, place: ir.Value) -> None:
        self.builder.store(vector, self._pointer(array, place), align=4)

    def number(self, array: int, place: ir.Value) -> Vector:
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
        build = self.builder
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
    difference, side = lanes.subtract(x[0], x[2]), lanes.turn(lanes.subtract(x[1], x[3]), sign)
    return [
        lanes.add(even, odd),
        lanes.add(difference, side),
        lanes.subtract(even, odd),
        lanes.subtract(difference, side),
    ]


def _butterfly(radix: int, sign: int) -> Intrinsic:
    """Return a step of a transform of ``radix`` vectors in place: from ``at`` on, ``step`` apart.

    A forward step (sign -1) multiplies its results by twiddle factors, a backward step its input.
    """

    def typed(
        _typing: Context,
        re: Type,
        im: Type,
        twiddles: Type,
        at: Type,
        step: Type,
        first: Type,
    ) -> Typed:
        place = types.int64

        def build(
            context: Context, builder: ir.IRBuilder, signature: Signature, given: Sequence[ir.Value]
        ) -> ir.Value:
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


def _copy(_typing: Context, source: Type, target: Type, at: Type, to: Type) -> Typed:
    """Copy LANES numbers from index ``at`` of ``source`` to index ``to`` of ``target``."""

    def build(
        context: Context, builder: ir.IRBuilder, signature: Signature, given: Sequence[ir.Value]
    ) -> ir.Value:
        lanes = _Lanes(context, builder, signature.args[:2], given[:2])
        lanes.store(lanes.load(0, given[2]), 1, given[3])
        return context.get_dummy_value()

    return types.void(source, target, types.int64, types.int64), build


copy_vector: Intrinsic = intrinsic(_copy)


def _transpose(_typing: Context, source: Type, target: Type, at: Type, to: Type) -> Typed:
    """Transpose LANES x LANES contiguous numbers from index ``at`` of ``source`` to ``to`` of ``target``."""

    def build(
        context: Context, builder: ir.IRBuilder, signature: Signature, given: Sequence[ir.Value]
    ) -> ir.Value:
        lanes = _Lanes(context, builder, signature.args[:2], given[:2])
        kind = given[2].type

        def row(start: ir.Value, number: int) -> ir.Value:
            return builder.add(start, ir.Constant(kind, number * LANES))

        rows = [lanes.load(0, row(given[2], number)) for number in range(LANES)]
        # Merging rows that are half their number apart is a perfect shuffle; log2(LANES) of them transpose.
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


transpose: Intrinsic = intrinsic(_transpose)


def _split(
    _typing: Context,
    re: Type,
    im: Type,
    out_re: Type,
    out_im: Type,
    at: Type,
    mirror: Type,
    first: Type,
    second: Type,
) -> Typed:
    """Write twice the spectra of the two real fields of a complex one at k, from its values at k and -k."""

    def build(
        context: Context, builder: ir.IRBuilder, signature: Signature, given: Sequence[ir.Value]
    ) -> ir.Value:
        lanes = _Lanes(context, builder, signature.args[:4], given[:4])
        here, there = ((lanes.load(0, place), lanes.load(1, place)) for place in given[4:6])
        total, difference = lanes.add(here, there), lanes.subtract(here, there)
        lanes.store(total[0], 2, given[6])
        lanes.store(difference[1], 3, given[6])
        lanes.store(total[1], 2, given[7])
        lanes.store(builder.fsub(there[0], here[0]), 3, given[7])
        return context.get_dummy_value()

    place = types.int64
    return types.void(re, im, out_re, out_im, place, place, place, place), build


split_fields: Intrinsic = intrinsic(_split)


def _join(
    _typing: Context,
    re: Type,
    im: Type,
    out_re: Type,
    out_im: Type,
    at: Type,
    mirror: Type,
    first: Type,
    second: Type,
) -> Typed:
    """Write the spectrum of a complex field at k and -k, from the spectra of its two real fields at k."""

    def build(
        context: Context, builder: ir.IRBuilder, signature: Signature, given: Sequence[ir.Value]
    ) -> ir.Value:
        lanes = _Lanes(context, builder, signature.args[:4], given[:4])
        a, b = ((lanes.load(0, place), lanes.load(1, place)) for place in given[6:8])
        lanes.store(builder.fsub(a[0], b[1]), 2, given[4])
        lanes.store(builder.fadd(a[1], b[0]), 3, given[4])
        lanes.store(builder.fadd(a[0], b[1]), 2, given[5])
        lanes.store(builder.fsub(b[0], a[1]), 3, given[5])
        return context.get_dummy_value()

    place = types.int64
    return types.void(re, im, out_re, out_im, place, place, place, place), build


join_fields: Intrinsic = intrinsic(_join)


def _keep_apart(_typing: Context) -> Typed:
    """Keep LLVM from inlining the calling function, which would make compilation much longer."""

    def build(
        context: Context, builder: ir.IRBuilder, _signature: Signature, _given: Sequence[ir.Value]
    ) -> ir.Value:
        builder.function.attributes.add("noinline")
        return context.get_dummy_value()

    return types.void(), build


keep_apart: Intrinsic = intrinsic(_keep_apart)
