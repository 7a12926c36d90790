"""Loops for which numpy would need many passes, compiled by numba (:mod:`tactile_toolkit.compiled`).

Floating-point operations run in the order in which they are written, so that results do not depend on the
processor.
"""

from __future__ import annotations

import math

import numpy as np

from tactile_toolkit.array_types import Bool, Float32, Float64, Floating, Int32, Int64
from tactile_toolkit.compiled import compiled


@compiled
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
    height, width = mask.shape
    reaches = int(np.ceil(outside_px)), int(np.ceil(inside_px))
    far = max(reaches)
    # Squared distances within each row: of ink, 0 on paper, and the reverse. They are below 128^2 and fit
    # into 16 bits, so that sixteen at a time are processed.
    along = np.zeros((2, height, width), np.int16)
    found = np.empty((height, width), np.float32)
    for row in range(height):
        begin = -far
        for column in range(width + 1):
            if column == width or (column and mask[row, column] != mask[row, column - 1]):
                kind = int(mask[row, column - 1])
                end = column if column < width else width + far
                first = max(begin, 0)
                for place in range(first, column):
                    nearest = min(place - begin + 1, end - place, reaches[kind])
                    along[kind, row, place] = nearest * nearest
                begin = column
    ink, least = -mask.astype(np.int16), np.empty(width, np.int16)  # all bits, or none
    for row in range(height):
        own, most = ink[row], np.int16(0)
        for column in range(width):
            least[column] = along[0, row, column] + along[1, row, column]
            most = max(most, least[column])
        for offset in range(1, far):
            added = np.int16(offset * offset)
            if added >= most:
                break
            for other in (row - offset, row + offset):
                if 0 <= other < height:
                    paper, inked = along[0, other], along[1, other]
                    for column in range(width):
                        squared = (inked[column] & own[column]) | (paper[column] & ~own[column])
                        least[column] = min(least[column], np.int16(squared + added))
        for column in range(width):
            away = np.sqrt(np.float32(least[column]))
            if ink[row, column]:
                found[row, column] = min(away, np.float32(inside_px)) - np.float32(0.5)
            else:
                found[row, column] = np.float32(0.5) - min(away, np.float32(outside_px))
    return found


@compiled
def narrow_pixels(distance: Float32, wide_px: float, reach: int) -> Int64:
    """Return rows and columns, shape (2, N), of narrow ink and paper: necks, gaps, whiskers and notches.

    A pixel is narrow if the square around it, ``reach`` pixels to each side, has no pixel of the same kind
    that is at least ``wide_px`` from the outline.
    """
    height, width = distance.shape
    found, count = np.empty((2, height * width), np.int64), 0
    for row in range(height):
        for column in range(width):
            if abs(distance[row, column]) >= wide_px:
                continue
            sign, near = np.float32(1 if distance[row, column] > 0 else -1), False
            for other in range(max(row - reach, 0), min(row + reach + 1, height)):
                for beside in range(max(column - reach, 0), min(column + reach + 1, width)):
                    near |= sign * distance[other, beside] >= wide_px
                if near:
                    break
            if not near:
                found[0, count], found[1, count] = row, column
                count += 1
    return found[:, :count]


@compiled
def blurred(
    values: Floating, nodes: Float64, sigma_per_pitch: float, bell_reach: float, grain: float
) -> Float64:
    """Blur values along the first axis, in proportion to the distance of the nodes; return those at nodes.

    The weights are twice a bell minus a wider one, rounded to multiples of ``grain``. They keep waves that
    one bell would damp, so that tips, notches and ridges lose less than half as much, and still remove what
    the lattice cannot represent. A bell is close to a Gaussian, but is computed by products and sums only,
    because exponentials differ between processors. A node one pixel from the next is not blurred.
    """
    found = np.zeros((len(nodes), values.shape[1]))
    weights = np.empty((2, len(values)))
    for node in range(len(nodes)):
        # Pitches differ along an axis: each node is blurred for the finer of its two sides.
        before, after = max(node, 1), min(node + 1, len(nodes) - 1)
        pitch = min(nodes[before] - nodes[before - 1], nodes[after] - nodes[after - 1])
        sigma = sigma_per_pitch * pitch if pitch > 1 else 0.0
        radii = max(bell_reach * sigma, 0.5), max(bell_reach * (2**0.5 * sigma), 0.5)
        first = max(math.ceil(nodes[node] - radii[1]), 0)
        last = min(math.floor(nodes[node] + radii[1]), len(values) - 1)
        for bell in range(2):
            total = 0.0
            for pixel in range(first, last + 1):
                away = nodes[node] - pixel
                weight = max(1 - away * away / (radii[bell] * radii[bell]), 0.0)
                weight *= weight
                weights[bell, pixel] = weight * weight
                total += weight * weight
            for pixel in range(first, last + 1):
                weights[bell, pixel] /= total
        for pixel in range(first, last + 1):
            weight = np.rint((2 * weights[0, pixel] - weights[1, pixel]) / grain) * grain
            if weight != 0:
                for place in range(values.shape[1]):
                    found[node, place] += weight * values[pixel, place]
    return found


@compiled
def runs_of(mask: Bool) -> tuple[Int64, Int64]:
    """Return the runs of marked pixels and the pairs of runs that touch.

    Runs have the shape (N, 3): row, first column, and the column after the last. Pairs have the shape (M, 2).
    """
    height, width = mask.shape
    found = np.empty((height * (width // 2 + 1), 3), np.int64)
    pairs = np.empty((2 * len(found), 2), np.int64)
    count = touching = above = 0
    for row in range(height):
        line, first, begin = mask[row], count, -1
        for column in range(width + 1):
            if column < width and line[column]:
                begin = column if begin < 0 else begin
            elif begin >= 0:
                found[count, 0], found[count, 1], found[count, 2] = row, begin, column
                while above < first and found[above, 2] <= begin:
                    above += 1
                beside = above
                while beside < first and found[beside, 1] < column:
                    pairs[touching, 0], pairs[touching, 1] = count, beside
                    touching += 1
                    beside += 1
                # The last one may touch the next run, too.
                above = max(above, beside - 1)
                count, begin = count + 1, -1
        above = first
    return found[:count], pairs[:touching]


@compiled
def smoothed(vertices: Float32, faces: Int32, flat: Int64, shares: Float32) -> Float32:
    """Move vertices towards the mean of their neighbours, by each share of the way in turn.

    Vertices marked in ``flat`` keep their z. An edge counts once for each of its triangles. Neighbours are
    added from the last to the first: the order decides the last bit.
    """
    ends = np.zeros(len(vertices) + 1, np.int64)
    for corner in faces.ravel():
        ends[corner + 1] += 2
    ends = np.cumsum(ends)
    beside, weights = np.empty(ends[-1], np.int32), np.empty(ends[-1], np.float32)
    filled = ends[:-1].copy()
    for face in range(len(faces)):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        for corner, other in ((a, b), (a, c), (b, c), (b, a), (c, a), (c, b)):
            first, place = ends[corner], filled[corner]
            while place > first and beside[place - 1] < other:
                place -= 1
            if place > first and beside[place - 1] == other:
                weights[place - 1] += 1
                continue
            for later in range(filled[corner], place, -1):
                beside[later], weights[later] = beside[later - 1], weights[later - 1]
            beside[place], weights[place] = other, 1
            filled[corner] += 1
    for share in shares:
        moved = vertices.copy()
        for vertex in range(len(vertices)):
            part = np.float32(1) / np.float32(ends[vertex + 1] - ends[vertex])
            x, y, z = np.float32(0), np.float32(0), np.float32(0)
            for place in range(ends[vertex], filled[vertex]):
                weight, other = weights[place] * part, vertices[beside[place]]
                x, y, z = x + weight * other[0], y + weight * other[1], z + weight * other[2]
            for axis, middle in enumerate((x, y, z)):
                if axis < 2 or not flat[vertex]:
                    moved[vertex, axis] += share * (middle - vertices[vertex, axis])
        vertices = moved
    return vertices
