"""Kernels of touches, in numba: triangles become heights, a batch of them at a time.

LLVM vectorises the loops over the triangles of a batch, which take a third of the time of plain loops then.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tactile_toolkit.kernels import compiled, part
from tactile_toolkit.value_types import AnyArray, Bool, Float32, Float64, Int32, Int64

_BLOCK = 4  # rows and columns of pixels that are drawn at once; few triangles cover more
PADDING = _BLOCK
"""Spare pixels of a row of heights, so that a block can begin at its last pixel; never shown."""

Pool = tuple[Float32, AnyArray, Int32, Float64]
"""Vertices, faces, starts and grids of a :class:`tactile_envs.mesh_pool.MeshPool`."""

ObjectPose = tuple[float, float, float, float, float]
"""Pose of an object: cosine and sine of its turn, column and row of its origin, pixels per metre."""

Workspace = tuple[Float32, Float32, Float32, Float64, Int32, Float64, Float32, Float32]
"""Work arrays: heights of an image, shape (H, W + PADDING), metres, its first row at the bottom; greatest
heights of columns (W,). For a batch of triangles: corners, metres; weights and heights of corners; first and
last columns and rows; edges of the window; heights of blocks of pixels; weights and heights in single
precision."""

View = tuple[tuple[float, float, float, float], ...]
"""Affine map of a mesh to the image: column, row and height, metres, of its points x, y, z, 1."""


class Setting(NamedTuple):
    """What all touches of a step have in common.

    ``window`` (6,): pixels per metre, column and row of the middle, from the bottom, ``press_m`` and
    ``gel_m`` of the sensor, least height of sensors, metres. ``motion`` (8,): as for
    :func:`tactile_envs.episode_kernels.aim`. ``drift`` (3,): how objects slip in their own frame, metres and
    radians.
    """

    window: Float64
    motion: Float64
    drift: Float64


class Cells(NamedTuple):
    """Sensors and objects of n environments; a touch moves both.

    ``numbers`` (n,) are those of the meshes of the objects in the pool; ``lifts`` (n,) is added to the
    observed heights, metres. ``axes`` (n, 3, 3) are those of the sensors, in columns; ``sensors`` (n, 3) are
    their positions, metres, which get the observed height. ``objects`` (n, 3) are position (x, y), metres,
    and rotation, radians.
    """

    numbers: Int64
    lifts: Float64
    axes: Float64
    sensors: Float64
    objects: Float64


class SensorReadings(NamedTuple):
    """One touch of each environment.

    ``images`` (n, H, W) are depth images; ``depths_m``, of the same shape or (0, 0, 0), are
    distances from the camera of the gel, metres; ``positions`` (n, 3) are the observed positions of the
    sensors, -1 to 1; ``is_bare`` (n,) states whether the gel touched only the plate.
    """

    images: Float32
    depths_m: Float32
    positions: Float32
    is_bare: Bool


EDGE_PX = 1e-6
"""Distance beyond the outermost pixels that still counts as in the window."""

_MAX_EDGES = 12  # of a box
# Distance outside an edge at which a pixel still counts as on it, as a share of the change of its weight
# from one pixel to the next: single precision must leave no hole between neighbours.
_SLACK = 2e-6
_LEVEL_M = 1e-12  # an edge of the window that rises by less is level
_BATCH = 64  # triangles that are prepared at once


def allocate_workspace(size_px: tuple[int, int]) -> Workspace:
    """Allocate work arrays for images of a width and height; arrays are slow to compile."""
    width, height = size_px
    return (
        np.zeros((height, width + PADDING), np.float32),
        np.empty(width, np.float32),
        np.empty(9 * _BATCH, np.float32),
        np.empty(11 * _BATCH),
        np.empty(4 * _BATCH, np.int32),
        np.empty((5, _MAX_EDGES)),
        np.empty((_BLOCK * _BLOCK, _BATCH), np.float32),
        np.empty((10, _BATCH), np.float32),
    )


@compiled
def raise_object(pool: Pool, number: int, pose: ObjectPose, workspace: Workspace) -> None:
    """Raise pixels to the highest triangle of mesh ``number`` over each of them.

    Heights are metres above the plate; samples of pixels are at integers.
    """
    _write_window_edges(workspace[5], workspace[0], pool[3][number], pose)
    raise_within(pool, number, 4, _upright_view(pose), workspace)


@part
def _upright_view(pose: ObjectPose) -> View:
    cosine, sine, x_px, y_px, px_per_m = pose
    turn_x, turn_y = cosine * px_per_m, sine * px_per_m
    return (turn_x, -turn_y, 0.0, x_px), (turn_y, turn_x, 0.0, y_px), (0.0, 0.0, 1.0, 0.0)


@part
def raise_within(pool: Pool, number: int, edges: int, view: View, workspace: Workspace) -> bool:
    """Raise pixels to the triangles of a mesh near an area of its grid; return whether there are any.

    ``edges`` is the number of edges of the area in the workspace, as :func:`write_edge` writes them.
    """
    vertices, faces, starts, grids = pool
    heights, _, corners, weights, boxes, area, blocks, singles = workspace
    grid = grids[number]
    first_vertex = np.uint64(grid[0])
    first_start, across, up = int(grid[3]), int(grid[4]), int(grid[5])
    cell_m, reach_m = grid[8], grid[9]
    # The large faces, then those of each line of cells.
    begin = int(grid[1])
    end = small = begin + int(grid[2])
    line, last_line = _lines_near(area, edges, reach_m, cell_m, across, up)
    if starts[first_start + across * up] == 0:
        last_line = -1
    waiting, is_any = 0, False
    while True:
        stop = min(end, begin + _BATCH - waiting)
        for face in range(begin, stop):
            # Unsigned, so that numba does not check for negative indices.
            at = np.uint64(waiting + face - begin)
            for corner in range(3):
                vertex = first_vertex + np.uint64(faces[np.uint64(face), np.uint64(corner)])
                for axis in range(3):
                    value = vertices[vertex, np.uint64(axis)]
                    corners[np.uint64((3 * corner + axis) * _BATCH) + at] = value
        waiting += stop - begin
        begin = stop
        # Only the last batch may be incomplete.
        is_last = begin == end and line > last_line
        if waiting == _BATCH or (is_last and waiting > 0):
            _prepare(heights, corners, weights, boxes, view)
            _raise_large(heights, weights, boxes, waiting)
            _draw_blocks(blocks, singles, weights)
            _raise_blocks(heights, blocks, boxes, waiting)
            waiting, is_any = 0, True
        if is_last:
            return is_any
        if begin == end:
            begin_cell, end_cell = _cells_near(area, edges, reach_m, cell_m, across, line)
            cell = first_start + line * across
            begin, end = small + starts[cell + begin_cell], small + starts[cell + end_cell]
            line += 1


@part
def _lines_near(
    area: Float64, edges: int, reach_m: float, cell_m: float, across: int, up: int
) -> tuple[int, int]:
    """Return the first and last line of cells that an area may meet."""
    left = np.inf
    lowest = np.inf
    right = -np.inf
    highest = -np.inf
    for edge in range(edges):
        x, y = area[0, edge], area[1, edge]
        end_x, end_y = x + area[2, edge], y + area[3, edge]
        left, right = min(left, min(x, end_x)), max(right, max(x, end_x))
        lowest, highest = min(lowest, min(y, end_y)), max(highest, max(y, end_y))
    if left - reach_m > across * cell_m or right + reach_m < 0.0:
        return 0, -1
    first = max(math.floor((lowest - reach_m) / cell_m), 0)
    return first, min(math.floor((highest + reach_m) / cell_m), up - 1)


@part
def _cells_near(
    area: Float64, edges: int, reach_m: float, cell_m: float, across: int, line: int
) -> tuple[int, int]:
    """Return the first cell of a line that an area may meet, and the one after the last."""
    # A triangle lies at most `reach_m` from the middle that says which cell it is in.
    from_y, to_y = line * cell_m - reach_m, (line + 1) * cell_m + reach_m
    least = np.inf
    most = -np.inf
    for edge in range(edges):
        x, y, along_x = area[0, edge], area[1, edge], area[2, edge]
        begin, end = 0.0, 1.0
        if abs(area[3, edge]) > _LEVEL_M:
            low = (from_y - y) * area[4, edge]
            high = (to_y - y) * area[4, edge]
            begin, end = max(min(low, high), 0.0), min(max(low, high), 1.0)
        elif y < from_y or y > to_y:
            continue
        if begin <= end:
            least = min(least, x + min(begin * along_x, end * along_x))
            most = max(most, x + max(begin * along_x, end * along_x))
    if most < least:
        return 0, 0
    begin_cell = min(max(math.floor((least - reach_m) / cell_m), 0), across)
    return begin_cell, max(min(math.floor((most + reach_m) / cell_m), across - 1) + 1, begin_cell)


@part
def _write_window_edges(edges: Float64, heights: Float32, grid: Float64, pose: ObjectPose) -> None:
    """Write the edges of the window in the object's frame, from the corner of its grid on."""
    cosine, sine, x_px, y_px, px_per_m = pose
    rows = heights.shape[0]
    columns = heights.shape[1] - PADDING
    per_px = 1.0 / px_per_m
    for corner in range(4):
        column = columns - 1.0 + EDGE_PX if corner == 1 or corner == 2 else -EDGE_PX
        row = rows - 1.0 + EDGE_PX if corner >= 2 else -EDGE_PX
        over_x, over_y = (column - x_px) * per_px, (row - y_px) * per_px
        edges[0, corner] = cosine * over_x + sine * over_y - grid[6]
        edges[1, corner] = cosine * over_y - sine * over_x - grid[7]
    for corner in range(4):
        write_edge(edges, corner, edges[0, (corner + 1) & 3], edges[1, (corner + 1) & 3])


@part
def write_edge(edges: Float64, edge: int, end_x: float, end_y: float) -> None:
    """Write the direction of an edge, given its start in ``edges`` and its end.

    ``edges``, shape (5, n): x and y of the start, differences of the end along x and y, and the inverse of
    the difference along y.
    """
    edges[2, edge] = end_x - edges[0, edge]
    edges[3, edge] = end_y - edges[1, edge]
    edges[4, edge] = 1.0 / edges[3, edge]


@part
def _prepare(heights: Float32, corners: Float32, weights: Float64, boxes: Int32, view: View) -> None:
    """Write which pixels each triangle of a batch may cover, and the weights of its corners there.

    LLVM vectorises the loop, because it has a fixed length and each result its own element of an array.
    """
    columns = heights.shape[1] - PADDING - 1.0
    rows = heights.shape[0] - 1.0
    for i in range(_BATCH):
        ax, ay, az = _project(view, corners[i], corners[_BATCH + i], corners[2 * _BATCH + i])
        bx, by, bz = _project(view, corners[3 * _BATCH + i], corners[4 * _BATCH + i], corners[5 * _BATCH + i])
        cx, cy, cz = _project(view, corners[6 * _BATCH + i], corners[7 * _BATCH + i], corners[8 * _BATCH + i])
        left, right = min(min(ax, bx), cx), max(max(ax, bx), cx)
        low, high = min(min(ay, by), cy), max(max(ay, by), cy)
        first_column = max(np.ceil(left - EDGE_PX), 0.0)
        first_row = max(np.ceil(low - EDGE_PX), 0.0)
        abx = bx - ax
        aby = by - ay
        acx = cx - ax
        acy = cy - ay
        area = abx * acy - aby * acx
        # Triangles that do not face the sensor cover no pixel.
        last_row = min(np.floor(high + EDGE_PX), rows) if area > 0.0 else -1.0
        boxes[i] = np.int32(first_column)
        boxes[_BATCH + i] = np.int32(min(np.floor(right + EDGE_PX), columns))
        boxes[2 * _BATCH + i] = np.int32(first_row)
        boxes[3 * _BATCH + i] = np.int32(last_row)
        per_area = 1.0 / area
        # Weights of the second and the third corner, and what they grow by along x and y.
        b_step = acy * per_area
        c_step = -aby * per_area
        b_up = -acx * per_area
        c_up = abx * per_area
        away_x, away_y = first_column - ax, first_row - ay
        weights[i] = b_step * away_x + b_up * away_y
        weights[_BATCH + i] = c_step * away_x + c_up * away_y
        weights[2 * _BATCH + i] = b_up
        weights[3 * _BATCH + i] = c_up
        weights[4 * _BATCH + i] = b_step
        weights[5 * _BATCH + i] = c_step
        weights[6 * _BATCH + i] = _SLACK * abs(b_step) + _SLACK
        weights[7 * _BATCH + i] = _SLACK * abs(c_step) + _SLACK
        weights[8 * _BATCH + i] = az
        weights[9 * _BATCH + i] = bz - az
        weights[10 * _BATCH + i] = cz - az


@part
def _project(view: View, x: np.float32, y: np.float32, z: np.float32) -> tuple[float, float, float]:
    """Return column, row and height of a point."""
    across, up, high = view
    column = np.float64(across[0] * x + across[1] * y + across[2] * z + across[3])
    row = np.float64(up[0] * x + up[1] * y + up[2] * z + up[3])
    return column, row, np.float64(high[0] * x + high[1] * y + high[2] * z + high[3])


@part
def _raise_blocks(heights: Float32, blocks: Float32, boxes: Int32, count: int) -> None:
    """Raise pixels to the blocks of the first triangles of a batch."""
    pixels = heights.reshape(heights.size)
    pitch = heights.shape[1]
    spare = len(pixels) - PADDING
    for i in range(count):
        if boxes[i] > boxes[_BATCH + i] or boxes[2 * _BATCH + i] > boxes[3 * _BATCH + i]:
            continue
        first = np.int64(boxes[2 * _BATCH + i]) * pitch + np.int64(boxes[i])
        for down in range(_BLOCK):
            # Rows above the window are drawn into spare pixels.
            start = np.uint64(min(first + down * pitch, spare))
            for right in range(_BLOCK):
                at = start + np.uint64(right)
                height = blocks[down * _BLOCK + right, i]
                held = pixels[at]
                pixels[at] = height if height > held else held


@part
def _draw_blocks(blocks: Float32, singles: Float32, weights: Float64) -> None:
    """Write the heights of all triangles of a batch at the pixels of their blocks; -inf: not covered.

    ``blocks``, shape (16, n), holds four rows of four pixels for each triangle, from the first pixel of its
    box on. ``singles`` (10, n) is a work array; the weights are moved up by four rows. LLVM vectorises the
    loops over triangles, because all their values are of single precision.
    """
    unit = np.float32(1.0)
    zero = np.float32(0.0)
    nothing = np.float32(-np.inf)
    for line in range(4, 11):
        for i in range(_BATCH):
            singles[line - 2, i] = weights[line * _BATCH + i]
    b_slack, c_slack = singles[4], singles[5]
    for i in range(_BATCH):
        singles[9, i] = unit + (b_slack[i] + c_slack[i])
    for down in range(_BLOCK):
        for i in range(_BATCH):
            singles[0, i], singles[1, i] = weights[i], weights[_BATCH + i]
            weights[i] += weights[2 * _BATCH + i]
            weights[_BATCH + i] += weights[3 * _BATCH + i]
        for right in range(_BLOCK):
            drawn = blocks[_BLOCK * down + right]
            along = np.float32(right)
            for i in range(_BATCH):
                b = singles[0, i] + singles[2, i] * along
                c = singles[1, i] + singles[3, i] * along
                height = singles[6, i] + (b * singles[7, i] + c * singles[8, i])
                height = height if b + b_slack[i] >= zero else nothing
                height = height if c + c_slack[i] >= zero else nothing
                drawn[i] = height if singles[9, i] - (b + c) >= zero else nothing


@part
def _raise_large(heights: Float32, weights: Float64, boxes: Int32, count: int) -> None:
    """Raise pixels to those of the first triangles that are larger than a block, and take them out."""
    for i in range(count):
        last_row = boxes[3 * _BATCH + i]
        if boxes[_BATCH + i] - boxes[i] < _BLOCK and last_row - boxes[2 * _BATCH + i] < _BLOCK:
            continue
        boxes[3 * _BATCH + i] = -1
        b_row = weights[i]
        c_row = weights[_BATCH + i]
        b_step, c_step = weights[4 * _BATCH + i], weights[5 * _BATCH + i]
        b_slack, c_slack = weights[6 * _BATCH + i], weights[7 * _BATCH + i]
        for row in range(boxes[2 * _BATCH + i], last_row + 1):
            line = heights[row]
            along = 0.0
            for column in range(boxes[i], boxes[_BATCH + i] + 1):
                b, c = b_row + b_step * along, c_row + c_step * along
                along += 1.0
                if b + b_slack >= 0.0 and c + c_slack >= 0.0 and 1.0 + b_slack + c_slack - (b + c) >= 0.0:
                    height = weights[8 * _BATCH + i] + (
                        b * weights[9 * _BATCH + i] + c * weights[10 * _BATCH + i]
                    )
                    line[column] = max(line[column], np.float32(height))
            b_row += weights[2 * _BATCH + i]
            c_row += weights[3 * _BATCH + i]


@compiled
def touch(
    begin: int,
    end: int,
    setting: Setting,
    pool: Pool,
    cells: Cells,
    workspace: Workspace,
    readings: SensorReadings,
) -> None:
    """Press the sensors of environments ``begin`` to before ``end``, then let the objects slip.

    Sensors are upright. ``readings`` are written, depths only if they are not empty.
    """
    window, sensors, objects = setting.window, cells.sensors, cells.objects
    heights = workspace[0]
    press_m, least_m = window[3], window[5]
    is_near = True
    for i in range(begin, end):
        if is_near:
            fill(heights, 0.0)
        number, turn_rad = cells.numbers[i], objects[i, 2]
        cosine, sine = math.cos(turn_rad), math.sin(turn_rad)
        x_px = (objects[i, 0] - sensors[i, 0]) * window[0] + window[1]
        y_px = (objects[i, 1] - sensors[i, 1]) * window[0] + window[2]
        pose = cosine, sine, x_px, y_px, window[0]
        _write_window_edges(workspace[5], heights, pool[3][number], pose)
        is_near = raise_within(pool, number, 4, _upright_view(pose), workspace)
        highest = np.float32(0.0)
        if is_near:
            highest = highest_of(heights, workspace[1])
        readings.is_bare[i] = highest == 0.0
        draw_touch(i, readings, heights, highest, window, least_m)
        sensors[i, 2] = max(highest + press_m + cells.lifts[i], least_m)
        observe_and_slip(i, cosine, sine, setting, cells, readings.positions)


@part
def fill(heights: Float32, height_m: float) -> None:
    """Set all heights."""
    rows, columns = heights.shape
    for row in range(rows):
        for column in range(columns):
            heights[row, column] = height_m


@part
def draw_touch(
    i: int, readings: SensorReadings, heights: Float32, highest: np.float32, window: Float64, least_m: float
) -> None:
    """Draw the images of sensor ``i``, whose height along its axis is at least ``least_m``."""
    press_m, gel_m = window[3], window[4]
    # The plate may hold the sensor up before the object is pressed in fully.
    pressed = max(highest, np.float32(least_m - press_m))
    _show(readings.images[i], heights, pressed, gel_m - press_m)
    if len(readings.depths_m):
        _measure(readings.depths_m[i], heights, pressed, press_m)


@part
def observe_and_slip(
    i: int, cosine: float, sine: float, setting: Setting, cells: Cells, positions: Float32
) -> None:
    """Write the observed position of sensor ``i``, and let its object slip, whose rotation is given."""
    motion, drift, objects = setting.motion, setting.drift, cells.objects
    for axis in range(3):
        low = motion[axis]
        high = motion[axis + 3]
        share = (cells.sensors[i, axis] - low) / (high - low) * 2.0 - 1.0
        positions[i, axis] = np.float32(min(max(share, -1.0), 1.0))
    objects[i, 0] += cosine * drift[0] - sine * drift[1]
    objects[i, 1] += sine * drift[0] + cosine * drift[1]
    objects[i, 2] += drift[2]


@part
def highest_of(heights: Float32, greatest: Float32) -> np.float32:
    """Return the greatest height in the first columns; ``greatest`` is a work array with their number."""
    # One greatest value for each column, and comparisons as selections: LLVM does several pixels at once.
    for column in range(len(greatest)):
        greatest[column] = heights[0, column]
    for row in range(1, len(heights)):
        for column in range(len(greatest)):
            here = heights[row, column]
            greatest[column] = here if here > greatest[column] else greatest[column]
    highest: np.float32 = greatest[0]
    for column in range(1, len(greatest)):
        highest = max(highest, greatest[column])
    return highest


@part
def _show(image: Float32, heights: Float32, highest: np.float32, span_m: float) -> None:
    """Draw the depth image: 0 at the greatest height, 1 from ``span_m`` below it on."""
    rows, columns = image.shape
    scale = np.float32(1.0 / span_m)
    top = np.float32(1.0)
    if highest == 0.0:
        for row in range(rows):
            for column in range(columns):
                image[row, column] = 0.0
        return
    for row in range(rows):
        line = heights[rows - 1 - row]
        shown = image[row]
        for column in range(columns):
            depth = (highest - line[column]) * scale
            shown[column] = depth if depth < top else top


@part
def _measure(far: Float32, heights: Float32, highest: np.float32, press_m: float) -> None:
    """Write distances from the gel's camera, metres."""
    rows, columns = far.shape
    press = np.float32(press_m)
    for row in range(rows):
        line = heights[rows - 1 - row]
        measured = far[row]
        for column in range(columns):
            measured[column] = press + (highest - line[column])
