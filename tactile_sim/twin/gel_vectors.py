"""Steps of the gel on vectors of numbers, in instructions of LLVM that numba does not emit by itself.

Each operation is one of IEEE 754, in the written order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from llvmlite import ir
from numba import types
from numba.core.typing.templates import Signature
from numba.extending import intrinsic

from tactile_sim.taxim_kernels import LANES, Build, Context, spread

_PIXELS = ir.VectorType(ir.FloatType(), LANES)
_COLOURS = ir.VectorType(ir.FloatType(), LANES // 4)


def _at(builder: ir.IRBuilder, values: ir.Value, place: ir.Value, kind: ir.VectorType = _PIXELS) -> ir.Value:
    return builder.bitcast(builder.gep(values, [place]), kind.as_pointer())


def _build_mix(
    context: Context, builder: ir.IRBuilder, signature: Signature, given: Sequence[ir.Value]
) -> ir.Value:
    """Build the code of :func:`_mix_entries`."""
    written, read, parts = (
        context.make_array(signature.args[n])(context, builder, given[n]).data for n in (0, 2, 6)
    )

    def number(place: int, kind: ir.VectorType) -> ir.Value:
        at = builder.add(given[7], builder.mul(given[8], ir.Constant(given[8].type, place)))
        return spread(builder, builder.load(builder.gep(parts, [at])), kind)

    def mixed(first: ir.Value, second: ir.Value, share: tuple[ir.Value, ir.Value]) -> ir.Value:
        return builder.fadd(builder.fmul(share[0], first), builder.fmul(share[1], second))

    def pair(place: ir.Value, share: tuple[ir.Value, ir.Value]) -> ir.Value:
        following = builder.add(place, ir.Constant(place.type, LANES))
        entries = [builder.load(_at(builder, read, each), align=4) for each in (place, following)]
        return mixed(entries[0], entries[1], share)

    one = ir.Constant(_PIXELS, [1.0] * LANES)
    far, steep, deep = (
        (builder.fsub(one, share), share) for share in (number(place, _PIXELS) for place in range(3))
    )
    here = builder.fadd(pair(given[3], steep), pair(given[4], deep))
    there = builder.fadd(
        pair(builder.add(given[3], given[5]), steep), pair(builder.add(given[4], given[5]), deep)
    )
    term = mixed(here, there, far)
    powers = []
    for power in range(3):
        lanes = [4 * power + colour for colour in range(4)]
        kind = ir.VectorType(ir.IntType(32), 4)
        powers.append(builder.shuffle_vector(term, term, ir.Constant(kind, lanes)))
    x = number(3, _COLOURS)
    total = builder.fadd(powers[1], builder.fmul(x, powers[2]))
    total = builder.fadd(powers[0], builder.fmul(x, total))
    builder.store(total, _at(builder, written, given[1], _COLOURS), align=4)
    return context.get_dummy_value()


def _mix_entries(
    _typing: object,
    out: types.Type,
    at: types.Type,
    table: types.Type,
    steep: types.Type,
    deep: types.Type,
    turn: types.Type,
    shares: types.Type,
    first: types.Type,
    apart: types.Type,
) -> tuple[Signature, Build]:
    """Write four colours of a pixel, the last one 0, from eight entries of a table, all float32 and flat.

    Entries have :data:`LANES` values: four colours without x, with x, with x^2, and four 0. The entries of a
    direction begin ``turn`` values before those of the next direction. From ``first`` on, every ``apart``-th
    value of ``shares`` is the share of the next direction, steepness and depth, and x. In plain numba::

        far, fi, fj, x = shares[first : first + 4 * apart : apart]
        term = np.empty(LANES, np.float32)
        for m in range(LANES):
            a, b = steep + m, deep + m
            here = ((1 - fi) * table[a] + fi * table[a + LANES]) + (
                (1 - fj) * table[b] + fj * table[b + LANES]
            )
            a, b = a + turn, b + turn
            there = ((1 - fi) * table[a] + fi * table[a + LANES]) + (
                (1 - fj) * table[b] + fj * table[b + LANES]
            )
            term[m] = (1 - far) * here + far * there
        for colour in range(4):
            out[at + colour] = term[colour] + x * (term[4 + colour] + x * term[8 + colour])
    """
    place = types.int64
    signature = types.void(out, place, table, place, place, place, shares, place, place)
    return signature, _build_mix


mix_entries: Callable[..., None] = intrinsic(_mix_entries)
