"""Blocks of pixels that a triangle covers, four rows of eight pixels at a time, as instructions for LLVM.

numba does not vectorise the loop that draws triangles. Its vector instructions are therefore given to LLVM,
which fits them to the lanes of the processor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeAlias

from llvmlite import ir
from numba import types
from numba.core.typing.templates import Signature
from numba.extending import intrinsic

LANES = 8
"""Neighbouring pixels of a row that are drawn at once."""

ROWS = 4
"""Rows that are drawn at once; most triangles lie within this many."""

_FLOAT, _INDEX = ir.FloatType(), ir.IntType(32)

Context: TypeAlias = Any
"""A context of numba, which is not typed."""

Build: TypeAlias = Callable[[Context, ir.IRBuilder, Signature, Sequence[ir.Value]], ir.Value]
"""Writes the instructions of a function for LLVM."""


def _raise_block(
    _typing: object,
    heights: types.Type,
    places: types.Type,
    b: types.Type,
    c: types.Type,
    b_up: types.Type,
    c_up: types.Type,
    b_step: types.Type,
    c_step: types.Type,
    b_slack: types.Type,
    c_slack: types.Type,
    low: types.Type,
    b_rise: types.Type,
    c_rise: types.Type,
) -> tuple[Signature, Build]:
    """Raise :data:`ROWS` rows of :data:`LANES` neighbouring pixels to a triangle, where it covers them.

    ``heights`` is contiguous, float32; ``places`` are the indices at which rows begin. ``b`` and ``c``, the
    weights of the second and third corner there, and their steps per row are float64. Float32 are the steps
    per pixel, tolerances below 0, the height of the first corner, and the heights of the others above it. In
    plain numba::

        for row in range(ROWS):
            for lane in range(LANES):
                b_here, c_here = float32(b) + b_step * lane, float32(c) + c_step * lane
                height = low + (b_here * b_rise + c_here * c_rise)
                inside = b_here + b_slack >= 0 and c_here + c_slack >= 0
                inside = inside and (1 + (b_slack + c_slack)) - (b_here + c_here) >= 0
                if inside and height > heights[places[row] + lane]:
                    heights[places[row] + lane] = height
            b, c = b + b_up, c + c_up
    """
    signature = types.void(heights, places, *[types.float64] * 4, *[types.float32] * 7)

    def build(
        context: Context, builder: ir.IRBuilder, signature: Signature, given: Sequence[ir.Value]
    ) -> ir.Value:
        pixels = context.make_array(signature.args[0])(context, builder, given[0])
        rows = [
            builder.bitcast(
                builder.gep(pixels.data, [builder.extract_value(given[1], row)]), _vector(LANES).as_pointer()
            )
            for row in range(ROWS)
        ]
        weights = []
        for weight, up in ((given[2], given[4]), (given[3], given[5])):
            each = [weight]
            for _ in range(ROWS - 1):
                each.append(builder.fadd(each[-1], up))
            weights.append(_spread(builder, [builder.fptrunc(one, _FLOAT) for one in each], LANES))
        rest = [_spread(builder, [value], ROWS * LANES) for value in given[6:]]
        held = _joined(builder, [builder.load(row, align=4) for row in rows])
        lanes = _constant([float(number % LANES) for number in range(ROWS * LANES)])
        raised = _raised(builder, held, weights, rest, lanes)
        for number, row in enumerate(rows):
            chosen = _indices(range(number * LANES, (number + 1) * LANES))
            builder.store(builder.shuffle_vector(raised, raised, chosen), row, align=4)
        return context.get_dummy_value()

    return signature, build


raise_block: Callable[..., None] = intrinsic(_raise_block)


def _raised(
    builder: ir.IRBuilder, held: ir.Value, weights: ir.Value, rest: ir.Value, lanes: ir.Value
) -> ir.Value:
    """Return the heights of a triangle at pixels that it covers and raises, else the heights held there."""
    b_step, c_step, b_slack, c_slack, low, b_rise, c_rise = rest
    zero, one = (_constant([value] * held.type.count) for value in (0.0, 1.0))
    b = builder.fadd(weights[0], builder.fmul(b_step, lanes))
    c = builder.fadd(weights[1], builder.fmul(c_step, lanes))
    height = builder.fadd(low, builder.fadd(builder.fmul(b, b_rise), builder.fmul(c, c_rise)))
    first = builder.fsub(builder.fadd(one, builder.fadd(b_slack, c_slack)), builder.fadd(b, c))
    raised = builder.fcmp_ordered(">", height, held)
    for weight in (builder.fadd(b, b_slack), builder.fadd(c, c_slack), first):
        raised = builder.and_(raised, builder.fcmp_ordered(">=", weight, zero))
    return builder.select(raised, height, held)


def _vector(lanes: int) -> ir.VectorType:
    return ir.VectorType(_FLOAT, lanes)


def _constant(values: list[float]) -> ir.Constant:
    return ir.Constant(_vector(len(values)), [ir.Constant(_FLOAT, value) for value in values])


def _indices(numbers: Iterable[int]) -> ir.Constant:
    chosen = list(numbers)
    return ir.Constant(ir.VectorType(_INDEX, len(chosen)), chosen)


def _spread(builder: ir.IRBuilder, values: list[ir.Value], times: int) -> ir.Value:
    """Repeat each number in ``times`` lanes."""
    lanes = ir.Constant(_vector(len(values)), ir.Undefined)
    for number, value in enumerate(values):
        lanes = builder.insert_element(lanes, value, ir.Constant(_INDEX, number))
    chosen = _indices(number // times for number in range(len(values) * times))
    return builder.shuffle_vector(lanes, lanes, chosen)


def _joined(builder: ir.IRBuilder, parts: list[ir.Value]) -> ir.Value:
    """Concatenate vectors of equal lengths."""
    while len(parts) > 1:
        both = _indices(range(2 * parts[0].type.count))
        parts = [
            builder.shuffle_vector(one, other, both)
            for one, other in zip(parts[::2], parts[1::2], strict=True)
        ]
    return parts[0]
