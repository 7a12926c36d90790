"""Loops for which numpy would need many passes, compiled by numba (:mod:`tactile_toolkit.kernels`).

Floating-point operations run in the order in which they are written, so results do not depend on the
processor. Arrays are made by numpy, and kernels have plain loops over single elements: for numba, making or
slicing an array in a kernel takes longer than all operations on it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.kernels import compiled
from tactile_toolkit.value_types import Bool, Float32, Float64, Int32, Int64

_ROOT_2 = 2**0.5


def signed_distance_px(mask: Bool, inside_px: float, outside_px: float) -> Float32:
    """Return the distance of each pixel centre from the outline of the ink, pixels, positive inside.

    The outline runs between pixels, half a pixel from the centres on either side. The edge of the image is
    not an outline. Distances are exact up to ``inside_px`` and ``outside_px``, both below 127, and are cut
    off there. They are found along the rows, then over the offsets of the columns, as by Felzenszwalb and
    Huttenlocher (2012); for short distances, plain passes over small integers are faster than their lower
    envelope.
    """
    # Largest distances between centres; the outline is half a pixel from a centre.
    inside_px, outside_px = inside_px + 0.5, outside_px + 0.5
    # Squared distances within each row: of ink, 0 on paper, and the reverse. They are below 128^2 and fit
    # into 16 bits, so that sixteen at a time are processed.
    paper, inked = np.zeros((2, *mask.shape), np.int16)
    ink = -mask.astype(np.int16)  # all bits, or none
    _distances_in_rows(ink, math.ceil(inside_px), math.ceil(outside_px), paper, inked)
    distances_px = np.empty(mask.shape, np.float32)
    least = np.empty(mask.shape[1], np.int16)
    far = max(math.ceil(inside_px), math.ceil(outside_px))
    _distances(ink, paper, inked, far, np.float32(inside_px), np.float32(outside_px), least, distances_px)
    return distances_px


@compiled("(int16[:,::1], int64, int64, int16[:,::1], int16[:,::1])")
def _distances_in_rows(
    ink: NDArray[np.int16], inside: int, outside: int, paper: NDArray[np.int16], inked: NDArray[np.int16]
) -> None:
    """Write the squared distances of paper from ink, and of ink from paper, within each row."""
    height, width = ink.shape
    far = max(inside, outside)
    for row in range(height):
        begin = -far
        for column in range(width + 1):
            if column == width or (column and ink[row, column] != ink[row, column - 1]):
                is_ink = ink[row, column - 1] != 0
                end = column
                if column == width:
                    end = width + far
                reach = inside if is_ink else outside
                for pixel in range(max(begin, 0), column):
                    nearest = min(min(pixel - begin + 1, end - pixel), reach)
                    if is_ink:
                        inked[row, pixel] = nearest * nearest
                    else:
                        paper[row, pixel] = nearest * nearest
                begin = column


@compiled(
    "(int16[:,::1], int16[:,::1], int16[:,::1], int64, float32, float32, int16[::1], float32[:,::1])",
)
def _distances(
    ink: NDArray[np.int16],
    paper: NDArray[np.int16],
    inked: NDArray[np.int16],
    far: int,
    inside_px: np.float32,
    outside_px: np.float32,
    least: NDArray[np.int16],
    distances_px: Float32,
) -> None:
    """Write the signed distances, from the squared ones within rows; ``least`` is a scratch row."""
    height, width = ink.shape
    half = np.float32(0.5)
    for row in range(height):
        most = np.int16(0)
        for column in range(width):
            squared = np.int16(paper[row, column] + inked[row, column])
            least[column] = squared
            most = squared if squared > most else most
        for offset in range(1, far):
            added = np.int16(offset * offset)
            if added >= most:
                break
            for side in range(2):
                near_row = row + offset if side else row - offset
                if 0 <= near_row < height:
                    for column in range(width):
                        own = ink[row, column]
                        nearest = (inked[near_row, column] & own) | (paper[near_row, column] & ~own)
                        there = np.int16(nearest + added)
                        here = least[column]
                        least[column] = there if there < here else here
        for column in range(width):
            away = np.sqrt(np.float32(least[column]))
            if ink[row, column]:
                distances_px[row, column] = (inside_px if inside_px < away else away) - half
            else:
                distances_px[row, column] = half - (outside_px if outside_px < away else away)


def narrow_pixels(distance: Float32, wide_px: float, reach: int) -> Int64:
    """Return rows and columns, shape (2, N), of narrow ink and paper: necks, gaps, whiskers and notches.

    A pixel is narrow if the square around it, ``reach`` pixels to each side, has no pixel of the same kind
    that is at least ``wide_px`` from the outline.
    """
    pixels = np.empty((2, distance.size), np.int64)
    return pixels[:, : _narrow_pixels(distance, wide_px, reach, pixels)]


@compiled("(float32[:,::1], float64, int64, int64[:,::1])")
def _narrow_pixels(distance: Float32, wide_px: float, reach: int, pixels: Int64) -> int:
    height, width = distance.shape
    count = 0
    for row in range(height):
        for column in range(width):
            here = distance[row, column]
            if abs(here) >= wide_px:
                continue
            sign = np.float32(1 if here > 0 else -1)
            near = False
            for near_row in range(max(row - reach, 0), min(row + reach + 1, height)):
                for near_column in range(max(column - reach, 0), min(column + reach + 1, width)):
                    near |= sign * distance[near_row, near_column] >= wide_px
                if near:
                    break
            if not near:
                pixels[0, count], pixels[1, count] = row, column
                count += 1
    return count


def blurred(
    values: Float32,
    rows: Float64,
    columns: Float64,
    sigma_per_pitch: float,
    bell_reach: float,
    weight_grain: float,
    factor_grain: float,
) -> Float64:
    """Blur values along both axes, in proportion to the distance of the nodes; return those at nodes.

    The weights are twice a bell minus a wider one, rounded to multiples of ``weight_grain``. They keep waves
    that one bell would damp, so that tips, notches and ridges lose less than half as much, and still remove
    what the lattice cannot represent. A bell is close to a Gaussian, but is computed by products and sums
    only, because exponentials differ between processors. A node one pixel from the next is not blurred.
    Between the axes, values are rounded to multiples of ``factor_grain``, a power of two.
    """

    def blur_rows(levels: Float64, nodes: Float64) -> Float64:
        at_nodes = np.zeros((len(nodes), levels.shape[1]))
        weights = np.empty((2, len(levels)))
        _blur_axis(levels, nodes, sigma_per_pitch, bell_reach, weight_grain, weights, at_nodes)
        return at_nodes

    halfway = np.round(blur_rows(values.astype(np.float64), rows) / factor_grain) * factor_grain
    return blur_rows(np.ascontiguousarray(halfway.T), columns).T


@compiled("(float64[:,::1], float64[::1], float64, float64, float64, float64[:,::1], float64[:,::1])")
def _blur_axis(
    values: Float64,
    nodes: Float64,
    sigma_per_pitch: float,
    bell_reach: float,
    grain: float,
    weights: Float64,
    at_nodes: Float64,
) -> None:
    count, width = at_nodes.shape
    for node in range(count):
        # Pitches differ along an axis: each node is blurred for the finer of its two sides.
        here = nodes[node]
        before = max(node, 1)
        after = min(node + 1, count - 1)
        pitch = min(nodes[before] - nodes[before - 1], nodes[after] - nodes[after - 1])
        sigma = sigma_per_pitch * pitch if pitch > 1 else 0.0
        narrow = max(bell_reach * sigma, 0.5)
        wide = max(bell_reach * (_ROOT_2 * sigma), 0.5)
        first = max(math.ceil(here - wide), 0)
        last = min(math.floor(here + wide), len(values) - 1)
        for bell in range(2):
            radius = wide if bell else narrow
            total = 0.0
            for pixel in range(first, last + 1):
                away = here - pixel
                weight = max(1 - away * away / (radius * radius), 0.0)
                weight *= weight
                weights[bell, pixel] = weight * weight
                total += weight * weight
            for pixel in range(first, last + 1):
                weights[bell, pixel] /= total
        for pixel in range(first, last + 1):
            weight = np.rint((2 * weights[0, pixel] - weights[1, pixel]) / grain) * grain
            if weight != 0:
                for column in range(width):
                    at_nodes[node, column] += weight * values[pixel, column]


def runs_of(mask: Bool) -> tuple[Int64, Int64]:
    """Return the runs of marked pixels and the pairs of runs that touch.

    Runs have the shape (N, 3): row, first column, and the column after the last. Pairs have the shape (2, M).
    """
    height, width = mask.shape
    runs = np.empty((height * (width // 2 + 1), 3), np.int64)
    pairs = np.empty((2, 2 * len(runs)), np.int64)
    count, touching = _runs_of(mask, runs, pairs)
    return runs[:count], pairs[:, :touching]


@compiled("(boolean[:,::1], int64[:,::1], int64[:,::1])")
def _runs_of(mask: Bool, runs: Int64, pairs: Int64) -> tuple[int, int]:
    height, width = mask.shape
    count = touching = above = 0
    for row in range(height):
        first, begin = count, -1
        for column in range(width + 1):
            if column < width and mask[row, column]:
                begin = column if begin < 0 else begin
            elif begin >= 0:
                runs[count, 0], runs[count, 1], runs[count, 2] = row, begin, column
                while above < first and runs[above, 2] <= begin:
                    above += 1
                beside = above
                while beside < first and runs[beside, 1] < column:
                    pairs[0, touching], pairs[1, touching] = count, beside
                    touching += 1
                    beside += 1
                # The last one may touch the next run, too.
                above = max(above, beside - 1)
                count = count + 1
                begin = -1
        above = first
    return count, touching


def smoothed(vertices: Float32, faces: Int32, flat: Int64, step_factors: Float32) -> Float32:
    """Move vertices towards the mean of their neighbours, by each share of the way in turn.

    Vertices marked in ``flat`` keep their z. An edge counts once for each of its triangles. Neighbours are
    added from the last to the first: the order decides the last bit.
    """
    ends = np.zeros(len(vertices) + 1, np.int64)
    np.cumsum(2 * np.bincount(faces.ravel(), minlength=len(vertices)), out=ends[1:])
    beside = np.empty(ends[-1], np.int32)
    weights = np.empty(ends[-1], np.float32)
    filled = ends[:-1].copy()
    _find_neighbours(faces, ends, filled, beside, weights)
    for step_factor in step_factors:
        moved = np.empty_like(vertices)
        _pull(vertices, flat, step_factor, ends, filled, beside, weights, moved)
        vertices = moved
    return vertices


@compiled("(int32[:,::1], int64[::1], int64[::1], int32[::1], float32[::1])")
def _find_neighbours(faces: Int32, ends: Int64, filled: Int64, beside: Int32, weights: Float32) -> None:
    """Write the neighbours of vertices, each once, from the last to the first, and how often each occurs."""
    for face in range(len(faces)):
        for k in range(6):
            corner = faces[face, k % 3]
            neighbour = faces[face, (k % 3 + k // 3 + 1) % 3]
            first, slot = ends[corner], filled[corner]
            while slot > first and beside[slot - 1] < neighbour:
                slot -= 1
            if slot > first and beside[slot - 1] == neighbour:
                weights[slot - 1] += np.float32(1)
                continue
            for later in range(filled[corner], slot, -1):
                beside[later], weights[later] = beside[later - 1], weights[later - 1]
            beside[slot], weights[slot] = neighbour, np.float32(1)
            filled[corner] += 1


@compiled(
    "(float32[:,::1], int64[::1], float32, int64[::1], int64[::1], int32[::1], float32[::1], float32[:,::1])"
)
def _pull(
    vertices: Float32,
    flat: Int64,
    share: np.float32,
    ends: Int64,
    filled: Int64,
    beside: Int32,
    weights: Float32,
    moved: Float32,
) -> None:
    """Write the vertices after they moved by a share of the way to the mean of their neighbours."""
    for vertex in range(len(vertices)):
        part = np.float32(1) / np.float32(ends[vertex + 1] - ends[vertex])
        x, y, z = np.float32(0), np.float32(0), np.float32(0)
        for slot in range(ends[vertex], filled[vertex]):
            weight = weights[slot] * part
            neighbour = beside[slot]
            x += weight * vertices[neighbour, 0]
            y += weight * vertices[neighbour, 1]
            z += weight * vertices[neighbour, 2]
        moved[vertex, 0] = vertices[vertex, 0] + share * (x - vertices[vertex, 0])
        moved[vertex, 1] = vertices[vertex, 1] + share * (y - vertices[vertex, 1])
        moved[vertex, 2] = vertices[vertex, 2]
        if not flat[vertex]:
            moved[vertex, 2] += share * (z - vertices[vertex, 2])
