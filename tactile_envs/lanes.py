"""Eight pixels at a time: one instruction of LLVM for an operation on eight numbers.

numba does not make such instructions of the inner loop of drawing by itself. LLVM brings them to what the
processor has, be it lanes of four or of sixteen.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

__all__ = ["LANES", "raise_pixels"]

LANES = 8

_VECTOR = ir.VectorType(ir.FloatType(), LANES)
_INDEX = ir.IntType(32)


def _constant(values: list[float]) -> ir.Constant:
    return ir.Constant(_VECTOR, [ir.Constant(ir.FloatType(), value) for value in values])


def _raise_pixels(
    _typing: Any,
    heights: Any,
    at: Any,
    b: Any,
    c: Any,
    b_step: Any,
    c_step: Any,
    b_slack: Any,
    c_slack: Any,
    low: Any,
    b_rise: Any,
    c_rise: Any,
) -> tuple[Any, Any]:
    """Raise :data:`LANES` neighbouring pixels to a triangle, where it covers them.

    ``heights`` is contiguous, float32, and ``at`` the place of the first pixel in it. The rest, float32: the
    weights of the second and third corner there, what they grow by from pixel to pixel, how far below 0 they
    may be, the height of the first corner, and how much higher the other two are. In plain numba::

        for lane in range(LANES):
            b_here, c_here = b + b_step * lane, c + c_step * lane
            height = low + (b_here * b_rise + c_here * c_rise)
            inside = b_here + b_slack >= 0 and c_here + c_slack >= 0
            inside = inside and (1 + (b_slack + c_slack)) - (b_here + c_here) >= 0
            if inside and height > heights[at + lane]:
                heights[at + lane] = height
    """
    signature = types.void(heights, types.int64, *[types.float32] * 9)

    def build(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        pixels = context.make_array(signature.args[0])(context, builder, given[0])
        place = builder.bitcast(builder.gep(pixels.data, [given[1]]), _VECTOR.as_pointer())
        b, c, b_step, c_step, b_slack, c_slack, low, b_rise, c_rise = (
            _spread(builder, value) for value in given[2:]
        )
        lane = _constant([float(number) for number in range(LANES)])
        zero, one = _constant([0.0] * LANES), _constant([1.0] * LANES)
        b = builder.fadd(b, builder.fmul(b_step, lane))
        c = builder.fadd(c, builder.fmul(c_step, lane))
        height = builder.fadd(low, builder.fadd(builder.fmul(b, b_rise), builder.fmul(c, c_rise)))
        first = builder.fsub(builder.fadd(one, builder.fadd(b_slack, c_slack)), builder.fadd(b, c))
        held = builder.load(place, align=4)
        raised = builder.fcmp_ordered(">", height, held)
        for weight in (builder.fadd(b, b_slack), builder.fadd(c, c_slack), first):
            raised = builder.and_(raised, builder.fcmp_ordered(">=", weight, zero))
        builder.store(builder.select(raised, height, held), place, align=4)
        return context.get_dummy_value()

    return signature, build


raise_pixels: Any = intrinsic(_raise_pixels)


def _spread(builder: Any, value: Any) -> Any:
    """Put one number into all lanes."""
    empty = ir.Constant(_VECTOR, ir.Undefined)
    single = builder.insert_element(empty, value, ir.Constant(_INDEX, 0))
    return builder.shuffle_vector(single, empty, ir.Constant(ir.VectorType(_INDEX, LANES), [0] * LANES))
