"""The surface of the gel of a twin, in numba: how it follows a solid, whose relief is sampled, and is seen.

Numbers have single precision: heights are right to about a ten-millionth of the press depth.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tactile_sim.optics import taxim_kernels
from tactile_toolkit.kernels import compiled, part
from tactile_toolkit.value_types import Float32, Float64, Floating

_SUBSTITUTIONS = 3  # by which positions that a pinhole sees are right to a hundredth of a pixel
_RUN = 3  # pixels from which the slope at an edge is computed


class Blur(NamedTuple):
    """How often a map is halved before it is blurred, and half kernels across and down, middle first."""

    halvings: int
    across: Float32
    down: Float32


@compiled
def sample_relief(
    out: Float64, relief: Float32, corner: Float64, affine: Float64, span: Float64, level: float
) -> None:
    """Write how far a relief rises above a level, 0 where it does not.

    ``out``, shape (H, W), first row at the greatest y; ``relief``, shape (rows, columns), heights in metres,
    first row at the least y, with the values of its edge repeated outside; ``corner`` x and y of its first
    point and the distances of its points along x and y, metres. Pixels lie at -1 to 1 across the image, times
    ``span``, which is less than 1 for a part of it and more with a margin, with y upwards. ``affine``, shape
    (2, 3), maps a position to x and y.
    """
    rows, columns = out.shape
    high, wide = relief.shape
    per_x, per_y = 1.0 / corner[2], 1.0 / corner[3]
    for row in range(rows):
        v = span[1] * (1.0 - (2.0 * row + 1.0) / rows)
        for column in range(columns):
            u = span[0] * ((2.0 * column + 1.0) / columns - 1.0)
            x = (affine[0, 0] * u + affine[0, 1] * v + affine[0, 2] - corner[0]) * per_x
            y = (affine[1, 0] * u + affine[1, 1] * v + affine[1, 2] - corner[1]) * per_y
            x, y = min(max(x, 0.0), wide - 1.0), min(max(y, 0.0), high - 1.0)
            i, j = min(int(x), wide - 2), min(int(y), high - 2)
            fx, fy = x - i, y - j
            height = (1.0 - fy) * ((1.0 - fx) * relief[j, i] + fx * relief[j, i + 1]) + fy * (
                (1.0 - fx) * relief[j + 1, i] + fx * relief[j + 1, i + 1]
            )
            out[row, column] = height - level if height > level else 0.0


@compiled
def extend(depth: Float64, level: float, margin: int) -> Float32:
    """Return how far a solid reaches beyond a level of depth, with ``margin`` pixels more on each side.

    The margin continues the slopes at the edge. Its values are limited to 0 and the maximum of the map.
    """
    rows, columns = depth.shape
    out = np.empty((rows + 2 * margin, columns + 2 * margin), np.float32)
    zero = np.float32(0.0)
    run = np.float32(_RUN)
    tops = np.zeros(columns, np.float32)
    for row in range(rows):
        line = depth[row]
        wide = out[row + margin]
        middle = wide[margin:]
        for column in range(columns):
            value = np.float32(level - line[column])
            value = value if value > zero else zero
            middle[column] = value
            tops[column] = value if value > tops[column] else tops[column]
        first = (middle[_RUN] - middle[0]) / run
        end = columns - 1
        last = (middle[end] - middle[end - _RUN]) / run
        for far in range(1, margin + 1):
            wide[margin - far] = middle[0] - np.float32(far) * first
            middle[end + far] = middle[end] + np.float32(far) * last
    greatest = tops.max()
    top = out[margin]
    bottom = out[margin + rows - 1]
    inner_top = out[margin + _RUN]
    inner_bottom = out[margin + rows - 1 - _RUN]
    for far in range(1, margin + 1):
        above = out[margin - far]
        below = out[margin + rows - 1 + far]
        distance = np.float32(far)
        for column in range(len(top)):
            above[column] = top[column] - distance * ((inner_top[column] - top[column]) / run)
            below[column] = bottom[column] + distance * ((bottom[column] - inner_bottom[column]) / run)
    for row in range(len(out)):
        line = out[row]
        for column in range(len(line)):
            value = line[column] if line[column] > zero else zero
            line[column] = value if value < greatest else greatest
    return out


@compiled
def press_gel(
    indentation: Floating,
    margin: int,
    blurs: tuple[Blur, ...],
    insets: tuple[int, ...],
    around: Blur,
    rise: float,
    share: float,
    edge: float,
) -> Float32:
    """Return the surface of the gel, metres, from the ``indentation`` (H, W) by a solid, margin included.

    Contact begins at a ``share`` of the greatest indentation inside the margin, over a range of ``edge``
    metres; larger indentations are reduced to the greatest one. After each of the ``blurs`` but the last one,
    the gel takes the shape of the solid where it is in contact. Each blur leaves out an edge as wide as its
    inset, which is not seen. After the first one, the gel rises by the share ``rise`` of the volume pressed
    in, spread by the blur ``around``.
    """
    held = np.empty(indentation.shape, np.float32)
    greatest = _turn_over(held, indentation, margin)
    begin = 0.5 * edge - share * greatest
    last = len(blurs) - 1
    soft = np.empty_like(held)
    soften(soft, held, blurs[0], 0)
    if rise:
        raised = np.empty_like(held)
        soften(raised, held, around, 0)
        _subtract(soft, raised, rise)
    _hold(soft, held, 0, begin, 1.0 / edge)
    for level in range(1, last):
        soften(soft, soft, blurs[level], insets[level])
        _hold(soft, held, insets[level], begin, 1.0 / edge)
    soften(soft, soft, blurs[last], insets[last])
    return soft


@part
def _subtract(soft: Float32, raised: Float32, times: float) -> None:
    """Subtract a map from another one, times a factor."""
    factor = np.float32(times)
    for row in range(len(soft)):
        line, other = soft[row], raised[row]
        for column in range(len(line)):
            line[column] -= factor * other[column]


@part
def _hold(soft: Float32, held: Float32, inset: int, begin: float, per_edge: float) -> None:
    """Give the gel the shape of the solid where it is in contact, except for an edge of ``inset`` pixels.

    Contact begins below the height ``begin``, metres, and grows from 0 to 1 by ``per_edge`` for each metre.
    """
    zero = np.float32(0.0)
    unit = np.float32(1.0)
    level = np.float32(begin)
    growth = np.float32(per_edge)
    for row in range(inset, len(soft) - inset):
        line, target = soft[row, inset:], held[row, inset:]
        for column in range(len(line) - inset):
            share = (level - target[column]) * growth
            share = share if share > zero else zero
            share = share if share < unit else unit
            line[column] += share * (target[column] - line[column])


@part
def _turn_over(held: Float32, indentation: Floating, margin: int) -> float:
    """Write the height that the gel has in contact; return the greatest indentation inside the margin."""
    rows, columns = indentation.shape
    tops = np.zeros(columns - 2 * margin, np.float32)
    for row in range(margin, rows - margin):
        into = indentation[row, margin:]
        for column in range(len(tops)):
            value = np.float32(into[column])
            tops[column] = value if value > tops[column] else tops[column]
    greatest: np.float32 = tops.max()
    for row in range(rows):
        target, into = held[row], indentation[row]
        for column in range(columns):
            value = np.float32(into[column])
            target[column] = -value if value < greatest else -greatest
    return float(greatest)


@compiled
def soften(out: Float32, source: Float32, blur: Blur, inset: int) -> None:
    """Write a blurred map, except for an edge of ``inset`` pixels.

    Wide blurs are done on a smaller map. Halving and doubling use binomials of four weights, which are part
    of the Gaussian.
    """
    if blur.halvings == 0:
        taxim_kernels.blur(source, blur.across, blur.down, 1, None, out, inset)
        return
    small = halved(source)
    for _ in range(blur.halvings - 1):
        small = halved(small)
    taxim_kernels.blur(small, blur.across, blur.down, 1, None, small)
    for left in range(blur.halvings - 1, 0, -1):
        size = 1 << left
        larger = np.empty(((len(out) + size - 1) // size, (out.shape[1] + size - 1) // size), np.float32)
        double(larger, small)
        small = larger
    double(out, small)


@compiled
def halved(wide: Float32) -> Float32:
    """Return a map of half the size, averaged with the weights 1, 3, 3, 1; the edge is repeated."""
    rows, columns = wide.shape
    high, across = (rows + 1) // 2, (columns + 1) // 2
    out = np.empty((high, across), np.float32)
    line = np.empty(columns + 3, np.float32)
    three = np.float32(3.0)
    part = np.float32(1.0 / 64.0)
    middle = line[1:]
    for row in range(high):
        a = wide[max(2 * row - 1, 0)]
        b = wide[2 * row]
        c, d = wide[min(2 * row + 1, rows - 1)], wide[min(2 * row + 2, rows - 1)]
        for column in range(columns):
            middle[column] = ((a[column] + d[column]) + three * (b[column] + c[column])) * part
        line[0] = middle[0]
        middle[columns], middle[columns + 1] = middle[columns - 1], middle[columns - 1]
        target = out[row]
        for column in range(across):
            at = 2 * column
            target[column] = (line[at] + line[at + 3]) + three * (line[at + 1] + line[at + 2])
    return out


@part
def double(out: Float32, small: Float32) -> None:
    """Write a map of twice the size, bilinearly; if a side is odd, the last pixel is left out."""
    rows, columns = out.shape
    high, wide = small.shape
    three = np.float32(3.0)
    part = np.float32(1.0 / 16.0)
    line = np.empty(wide + 2, np.float32)
    middle = line[1:]
    for row in range(rows):
        at = row // 2
        near = small[at]
        far = small[min(at + 1, high - 1) if row % 2 else max(at - 1, 0)]
        for column in range(wide):
            middle[column] = (three * near[column] + far[column]) * part
        line[0], middle[wide] = middle[0], middle[wide - 1]
        target = out[row]
        for column in range(columns // 2):
            target[2 * column] = three * middle[column] + line[column]
            target[2 * column + 1] = three * middle[column] + middle[column + 1]
        if columns % 2:
            target[columns - 1] = three * middle[wide - 1] + line[wide - 1]


@compiled
def bend_surface(
    out: Float32, surface: Floating, span: Float64, margin: int, lens: float, camera: float, across: float
) -> None:
    """Write a surface as a pinhole sees it through a lens, bilinearly.

    ``surface`` has ``margin`` pixels more on each side than ``out``. ``camera`` is one over the distance of
    the pinhole: pixels see points of the height h at (1 + camera h) times their own positions, which follow
    from repeated substitution. ``across`` is the squared width of the image over its squared diagonal.
    """
    rows, columns = out.shape
    high, wide = surface.shape
    pixels = np.empty(columns, np.int32)
    parts = np.empty((2, columns), np.float32)
    zero = 0.0
    unit = np.float32(1.0)
    down = 1.0 - across
    flat = surface.reshape(surface.size)
    most_x = wide - 1.0
    most_y = high - 1.0
    right = np.int32(wide - 2)
    below = np.int32(high - 2)
    for row in range(rows):
        v = span[1] * (1.0 - (2.0 * row + 1.0) / rows)
        from_middle = row + 0.5 - 0.5 * rows
        target = out[row]
        target[:] = np.float32(0.0)
        for _ in range(_SUBSTITUTIONS if camera else 1):
            for column in range(columns):
                u = span[0] * ((2.0 * column + 1.0) / columns - 1.0)
                bend = lens * (across * u * u + down * v * v)
                bend = bend + camera * target[column] * (1.0 + bend)
                x = column + margin + bend * (column + 0.5 - 0.5 * columns)
                y = row + margin + bend * from_middle
                x, y = (x if x > zero else zero), (y if y > zero else zero)
                x, y = (x if x < most_x else most_x), (y if y < most_y else most_y)
                i, j = np.int32(x), np.int32(y)
                i, j = (i if i < right else right), (j if j < below else below)
                pixels[column] = j * np.int32(wide) + i
                parts[0, column], parts[1, column] = x - i, y - j
            for column in range(columns):
                at = pixels[column]
                fx = parts[0, column]
                fy = parts[1, column]
                target[column] = (unit - fy) * ((unit - fx) * flat[at] + fx * flat[at + 1]) + fy * (
                    (unit - fx) * flat[at + wide] + fx * flat[at + wide + 1]
                )


@compiled
def lay_over(out: Float32, response: Float32, behind: Float32) -> None:
    """Write the shades, 0 to 1, (H, W, 3), of a response over a background; both are in levels."""
    flat, change, below = out.reshape(out.size), response.reshape(out.size), behind.reshape(out.size)
    zero = np.float32(0.0)
    unit = np.float32(1.0)
    part = np.float32(1.0 / 255.0)
    for at in range(len(flat)):
        shade = (change[at] + below[at]) * part
        shade = shade if shade > zero else zero
        flat[at] = shade if shade < unit else unit
