"""Kernels of touches, in numba: triangles become heights, eight pixels at a time.

numba does not vectorise the loop that draws triangles. Its vector instructions are therefore given to LLVM,
which fits them to the lanes of the processor: a touch takes half as long. All kernels of touches lie in this
one file, because numba's cache on disk looks at the file of a kernel only.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from tactile_toolkit.array_types import AnyArray, Bool, Float32, Float64, Int32, Int64
from tactile_toolkit.compiled import compiled

LANES = 8
"""Pixels that are drawn at once."""

PADDING = LANES
"""Spare pixels of a row of heights, so that eight at once can begin at its last."""

Pool = tuple[Float32, AnyArray, Int32, Float64]
"""Vertices, faces, starts and grids of a :class:`tactile_envs.mesh_pool.MeshPool`."""

ObjectPlace = tuple[float, float, float, float, float]
"""Place of an object: cosine and sine of its turn, column and row of its origin, pixels per metre."""

_EDGE_PX = 1e-6
# Distance outside of an edge at which a pixel still counts as on it, as a share of the change of its weight
# from one pixel to the next: single precision must leave no hole between neighbours.
_SLACK = 2e-6
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


@compiled
def raise_object(heights: Float32, pool: Pool, number: int, placed: ObjectPlace) -> None:
    """Raise pixels to the highest triangle of mesh ``number`` over each of them.

    ``heights``, shape (H, W + PADDING), metres above the plate, has its first row at the bottom; pixels look
    at integers.
    """
    starts, grid = pool[2], pool[3][number]
    first_face, large, first_start = int(grid[1]), int(grid[2]), int(grid[3])
    across, up = int(grid[4]), int(grid[5])
    cell_m, reach_m = grid[8], grid[9]
    small = first_face + large
    _raise_run(heights, pool, number, first_face, small, placed)
    corner_x, corner_y = _corners_in_grid(heights, grid, placed)
    lowest, highest = corner_y.min() - reach_m, corner_y.max() + reach_m
    for line in range(max(math.floor(lowest / cell_m), 0), min(math.floor(highest / cell_m), up - 1) + 1):
        # A triangle lies at most `reach_m` from the middle that says which cell it is in.
        from_y, to_y = line * cell_m - reach_m, (line + 1) * cell_m + reach_m
        least, most = _extent_between(corner_x, corner_y, from_y, to_y)
        begin_cell = max(math.floor((least - reach_m) / cell_m), 0)
        end_cell = min(math.floor((most + reach_m) / cell_m), across - 1)
        if begin_cell <= end_cell:
            cell = first_start + line * across
            first, last = starts[cell + begin_cell], starts[cell + end_cell + 1]
            _raise_run(heights, pool, number, small + first, small + last, placed)


@compiled
def _corners_in_grid(heights: Float32, grid: Float64, placed: ObjectPlace) -> tuple[Float64, Float64]:
    """Return x and y of the corners of the window in the object's frame, from the corner of its grid on."""
    cosine, sine, x_px, y_px, px_per_m = placed
    rows, columns = heights.shape[0], heights.shape[1] - PADDING
    corner_x, corner_y = np.empty(4), np.empty(4)
    for corner in range(4):
        column = columns - 1.0 + _EDGE_PX if corner == 1 or corner == 2 else -_EDGE_PX
        row = rows - 1.0 + _EDGE_PX if corner >= 2 else -_EDGE_PX
        over_x, over_y = (column - x_px) / px_per_m, (row - y_px) / px_per_m
        corner_x[corner] = cosine * over_x + sine * over_y - grid[6]
        corner_y[corner] = cosine * over_y - sine * over_x - grid[7]
    return corner_x, corner_y


@compiled
def _extent_between(corner_x: Float64, corner_y: Float64, from_y: float, to_y: float) -> tuple[float, float]:
    """Return least and greatest x of the part of a convex polygon between two heights."""
    least, most = np.inf, -np.inf
    for corner in range(4):
        x, y = corner_x[corner], corner_y[corner]
        along_x, along_y = corner_x[(corner + 1) & 3] - x, corner_y[(corner + 1) & 3] - y
        begin, end = 0.0, 1.0
        if along_y != 0.0:
            one, other = (from_y - y) / along_y, (to_y - y) / along_y
            begin, end = max(min(one, other), 0.0), min(max(one, other), 1.0)
        elif y < from_y or y > to_y:
            continue
        if begin <= end:
            least = min(least, x + min(begin * along_x, end * along_x))
            most = max(most, x + max(begin * along_x, end * along_x))
    return least, most


@compiled
def _raise_run(heights: Float32, pool: Pool, number: int, first: int, last: int, placed: ObjectPlace) -> None:
    """Raise pixels to those of some triangles that face upwards."""
    vertices, faces, _, grids = pool
    first_vertex, pixels = int(grids[number, 0]), heights.reshape(heights.size)
    rows, columns = heights.shape[0], heights.shape[1] - PADDING
    for face in range(first, last):
        a = first_vertex + np.int64(faces[face, 0])
        b = first_vertex + np.int64(faces[face, 1])
        c = first_vertex + np.int64(faces[face, 2])
        ax, ay = _in_window(vertices, a, placed)
        bx, by = _in_window(vertices, b, placed)
        cx, cy = _in_window(vertices, c, placed)
        first_column = max(math.ceil(min(min(ax, bx), cx) - _EDGE_PX), 0)
        last_column = min(math.floor(max(max(ax, bx), cx) + _EDGE_PX), columns - 1)
        first_row = max(math.ceil(min(min(ay, by), cy) - _EDGE_PX), 0)
        last_row = min(math.floor(max(max(ay, by), cy) + _EDGE_PX), rows - 1)
        if first_column > last_column or first_row > last_row:
            continue
        abx, aby, acx, acy = bx - ax, by - ay, cx - ax, cy - ay
        area = abx * acy - aby * acx
        if area <= 0.0:
            continue
        per_area = 1.0 / area
        # Weights of the second and the third corner, and what they grow by along x and y.
        b_step, c_step = acy * per_area, -aby * per_area
        b_up, c_up = -acx * per_area, abx * per_area
        b_slack = np.float32(_SLACK * abs(b_step) + _SLACK)
        c_slack = np.float32(_SLACK * abs(c_step) + _SLACK)
        away_x, away_y = first_column - ax, first_row - ay
        b_row, c_row = b_step * away_x + b_up * away_y, c_step * away_x + c_up * away_y
        low = vertices[a, 2]
        b_rise, c_rise = vertices[b, 2] - low, vertices[c, 2] - low
        for row in range(first_row, last_row + 1):
            b_here, c_here = b_row, c_row
            for column in range(first_column, last_column + 1, LANES):
                raise_pixels(
                    pixels,
                    row * heights.shape[1] + column,
                    np.float32(b_here),
                    np.float32(c_here),
                    np.float32(b_step),
                    np.float32(c_step),
                    b_slack,
                    c_slack,
                    low,
                    b_rise,
                    c_rise,
                )
                b_here += LANES * b_step
                c_here += LANES * c_step
            b_row += b_up
            c_row += c_up


@compiled
def _in_window(vertices: Float32, vertex: np.int64, placed: ObjectPlace) -> tuple[float, float]:
    """Return column and row of a vertex."""
    cosine, sine, x_px, y_px, px_per_m = placed
    turn_x, turn_y = cosine * px_per_m, sine * px_per_m
    x, y = np.float64(vertices[vertex, 0]), np.float64(vertices[vertex, 1])
    return turn_x * x - turn_y * y + x_px, turn_y * x + turn_x * y + y_px


@compiled
def touch(
    begin: int,
    end: int,
    window: Float64,
    motion: Float64,
    drift: Float64,
    pool: Pool,
    chosen: Int64,
    lifts: Float64,
    sensors: Float64,
    objects: Float64,
    heights: Float32,
    images: Float32,
    depths: Float32,
    positions: Float32,
    is_bare: Bool,
) -> None:
    """Bring sensors down where they are, and let the objects slip: for environments begin to end.

    ``window`` (6,) is pixels a metre, column and row of the middle, counted from the bottom, press depth and
    thickness of the gel, and the least height of sensors, metres; ``motion`` is as of :func:`aim`; ``drift``
    (3,) how objects slip afterwards, in their own frame, metres and radians; ``chosen`` which mesh of the
    pool each object is; ``lifts`` (n,) how much higher sensors are observed than they are, metres;
    ``heights`` (H, W + PADDING) room to work in. Of ``sensors`` (n, 3), metres, the observed height is
    written; ``objects`` (n, 3), position, metres, and turn, radians, slip in place. Written are depth images
    (n, H, W); ``depths``, likewise or (0, 0, 0) where not wanted, distances from the gel's camera, metres;
    ``positions`` (n, 3), what sensors observe of theirs, -1 to 1; ``is_bare`` (n,), whether the plate alone
    was met.
    """
    greatest = np.empty(images.shape[2], np.float32)
    press_m, gel_m, least_m = window[3], window[4], window[5]
    for i in range(begin, end):
        cosine, sine = math.cos(objects[i, 2]), math.sin(objects[i, 2])
        x_px = (objects[i, 0] - sensors[i, 0]) * window[0] + window[1]
        y_px = (objects[i, 1] - sensors[i, 1]) * window[0] + window[2]
        heights[:, :] = 0.0
        raise_object(heights, pool, chosen[i], (cosine, sine, x_px, y_px, window[0]))
        highest = _highest(heights, greatest)
        is_bare[i] = highest == 0.0
        # The plate may hold the sensor up before the object is pressed in fully.
        pressed = max(highest, np.float32(least_m - press_m))
        _show(images[i], heights, pressed, gel_m - press_m)
        if len(depths):
            _measure(depths[i], heights, pressed, press_m)
        sensors[i, 2] = max(highest + press_m + lifts[i], least_m)
        for axis in range(3):
            low, high = motion[axis], motion[axis + 3]
            share = (sensors[i, axis] - low) / (high - low) * 2.0 - 1.0
            positions[i, axis] = np.float32(min(max(share, -1.0), 1.0))
        objects[i, 0] += cosine * drift[0] - sine * drift[1]
        objects[i, 1] += sine * drift[0] + cosine * drift[1]
        objects[i, 2] += drift[2]


@compiled
def _highest(heights: Float32, greatest: Float32) -> np.float32:
    """Return the greatest height of the columns that ``greatest`` has room for."""
    # One greatest value for each column, and comparisons as selections: LLVM does several pixels at once.
    greatest[:] = heights[0, : len(greatest)]
    for row in range(1, len(heights)):
        for column in range(len(greatest)):
            here = heights[row, column]
            greatest[column] = here if here > greatest[column] else greatest[column]
    highest: np.float32 = greatest.max()
    return highest


@compiled
def _show(image: Float32, heights: Float32, highest: np.float32, span_m: float) -> None:
    """Draw the depth image: 0 at the greatest height, 1 from ``span_m`` below it on."""
    rows, columns = image.shape
    scale, top = np.float32(1.0 / span_m), np.float32(1.0)
    if highest == 0.0:
        image[:, :] = 0.0
        return
    for row in range(rows):
        line, shown = heights[rows - 1 - row], image[row]
        for column in range(columns):
            depth = (highest - line[column]) * scale
            shown[column] = depth if depth < top else top


@compiled
def _measure(far: Float32, heights: Float32, highest: np.float32, press_m: float) -> None:
    """Write distances from the gel's camera, metres."""
    rows, columns = far.shape
    press = np.float32(press_m)
    for row in range(rows):
        line, measured = heights[rows - 1 - row], far[row]
        for column in range(columns):
            measured[column] = press + (highest - line[column])
