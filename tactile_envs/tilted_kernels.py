"""Kernels of touches by tilted sensors, in numba: meshes are seen along the axis of a sensor.

A sensor is tilted by at most 45 degrees: its window sees a few cells of a mesh's grid only. Kernels of other
files are compiled into these, and numba's cache on disk does not notice when they change.
"""

from __future__ import annotations

import math

import numpy as np

from tactile_envs.touch_kernels import (
    _EDGE_PX,
    PADDING,
    Pool,
    Room,
    _highest,
    _measure,
    _show,
    batch_room,
    new_runs,
    raise_runs,
)
from tactile_toolkit.array_types import Bool, Float32, Float64, Int64
from tactile_toolkit.compiled import compiled


@compiled
def touch_tilted(
    begin: int,
    end: int,
    window: Float64,
    motion: Float64,
    drift: Float64,
    pool: Pool,
    plate: Pool,
    far: float,
    chosen: Int64,
    lifts: Float64,
    axes: Float64,
    sensors: Float64,
    objects: Float64,
    heights: Float32,
    images: Float32,
    depths: Float32,
    positions: Float32,
    is_bare: Bool,
) -> None:
    """Bring tilted sensors down along their axes, and let the objects slip: for environments begin to end.

    ``plate`` is a pool of one mesh, the plate under the objects with its upper side at height 0; what lies
    more than ``far`` below the target of a sensor, metres, is not seen. ``axes`` (n, 3, 3) has the x, y and z
    axis of each sensor in its columns; ``sensors`` (n, 3), metres, are moved along z until the gel is pressed
    in. The rest is as of :func:`tactile_envs.touch_kernels.touch`.
    """
    greatest, room = np.empty(images.shape[2], np.float32), batch_room()
    press_m, gel_m = window[3], window[4]
    view, lying = np.empty((3, 4)), np.empty((3, 4))
    for i in range(begin, end):
        cosine, sine = math.cos(objects[i, 2]), math.sin(objects[i, 2])
        lying[:, :] = 0.0
        lying[0, 0] = lying[1, 1] = lying[2, 2] = 1.0
        heights[:, :] = -far
        lying[2, 3] = -plate[3][0, 12]
        _look(view, window, axes[i], sensors[i], lying)
        raise_mesh(heights, plate, 0, view, room)
        lying[0, 0], lying[0, 1], lying[0, 3] = cosine, -sine, objects[i, 0]
        lying[1, 0], lying[1, 1], lying[1, 3] = sine, cosine, objects[i, 1]
        lying[2, 3] = 0.0
        _look(view, window, axes[i], sensors[i], lying)
        raise_mesh(heights, pool, chosen[i], view, room)
        highest = _highest(heights, greatest)
        is_bare[i] = False  # a tilted plate is seen, too
        # The sensor may not go below a height: how far along its axis that is.
        least_m = (window[5] - sensors[i, 2]) / axes[i, 2, 2]
        pressed = max(highest, np.float32(least_m - press_m))
        _show(images[i], heights, pressed, gel_m - press_m)
        if len(depths):
            _measure(depths[i], heights, pressed, press_m)
        observed_m = max(highest + press_m + lifts[i], least_m)
        for axis in range(3):
            sensors[i, axis] += axes[i, axis, 2] * observed_m
            low, high = motion[axis], motion[axis + 3]
            share = (sensors[i, axis] - low) / (high - low) * 2.0 - 1.0
            positions[i, axis] = np.float32(min(max(share, -1.0), 1.0))
        objects[i, 0] += cosine * drift[0] - sine * drift[1]
        objects[i, 1] += sine * drift[0] + cosine * drift[1]
        objects[i, 2] += drift[2]


@compiled
def _look(view: Float64, window: Float64, axes: Float64, sensor: Float64, lying: Float64) -> None:
    """Write how a mesh is seen: columns, rows and heights, metres, of its points x, y, z, 1; shape (3, 4).

    ``axes`` (3, 3) and ``sensor`` (3,) are those of a sensor, and ``lying`` (3, 4) the pose of the mesh.
    """
    for row in range(3):
        for column in range(4):
            total = 0.0
            for k in range(3):
                along = lying[k, column]
                if column == 3:
                    along -= sensor[k]
                total += axes[k, row] * along
            view[row, column] = total
    for row in range(2):
        for column in range(4):
            view[row, column] *= window[0]
        view[row, 3] += window[1 + row]


@compiled
def raise_mesh(heights: Float32, pool: Pool, number: int, view: Float64, room: Room) -> None:
    """Raise pixels to the nearest triangle of mesh ``number`` at each of them.

    ``heights``, shape (H, W + PADDING), metres towards the sensor, has its first row at the bottom; pixels
    look at integers. ``view`` (3, 4) gives column, row and height of a point x, y, z, 1 of the mesh.
    """
    starts, grid = pool[2], pool[3][number]
    first_face, large, first_start = int(grid[1]), int(grid[2]), int(grid[3])
    across, up = int(grid[4]), int(grid[5])
    cell_m, reach_m = grid[8], grid[9]
    small = first_face + large
    seen_by = (
        (view[0, 0], view[0, 1], view[0, 2], view[0, 3]),
        (view[1, 0], view[1, 1], view[1, 2], view[1, 3]),
        (view[2, 0], view[2, 1], view[2, 2], view[2, 3]),
    )
    if starts[first_start + across * up] == 0:
        up = 0
    seen, runs = _seen_in_grid(heights, grid, view), new_runs(first_face, small, up)
    lowest, highest = seen[:, 1].min() - reach_m, seen[:, 1].max() + reach_m
    for line in range(max(math.floor(lowest / cell_m), 0), min(math.floor(highest / cell_m), up - 1) + 1):
        # A triangle lies at most `reach_m` from the middle that says which cell it is in.
        least, most = _extent_between(seen, line * cell_m - reach_m, (line + 1) * cell_m + reach_m)
        begin_cell = max(math.floor((least - reach_m) / cell_m), 0)
        end_cell = min(math.floor((most + reach_m) / cell_m), across - 1)
        if begin_cell <= end_cell:
            cell = first_start + line * across
            runs[line + 1, 0] = small + starts[cell + begin_cell]
            runs[line + 1, 1] = small + starts[cell + end_cell + 1]
    raise_runs(heights, pool, number, runs, seen_by, room)


@compiled
def _seen_in_grid(heights: Float32, grid: Float64, view: Float64) -> Float64:
    """Return corners (8, 2) of the part of a mesh's box that the window sees, from the corner of its grid on.

    The first four are at the height of its foot, the others at that of its top.
    """
    rows, columns = heights.shape[0], heights.shape[1] - PADDING
    seen = np.empty((8, 2))
    per_area = 1.0 / (view[0, 0] * view[1, 1] - view[0, 1] * view[1, 0])
    for corner in range(8):
        side, height_m = corner & 3, grid[12] * (corner >> 2)
        column = columns - 1.0 + _EDGE_PX if side == 1 or side == 2 else -_EDGE_PX
        row = rows - 1.0 + _EDGE_PX if side >= 2 else -_EDGE_PX
        over = column - view[0, 3] - view[0, 2] * height_m
        along = row - view[1, 3] - view[1, 2] * height_m
        seen[corner, 0] = (view[1, 1] * over - view[0, 1] * along) * per_area - grid[6]
        seen[corner, 1] = (view[0, 0] * along - view[1, 0] * over) * per_area - grid[7]
    return seen


@compiled
def _extent_between(seen: Float64, from_y: float, to_y: float) -> tuple[float, float]:
    """Return least and greatest x of the part of a box between two y; ``seen`` (8, 2) are its corners."""
    least, most = np.inf, -np.inf
    for edge in range(12):
        side = edge & 3
        begin_at = side + 4 * (edge >> 2 == 1)
        end_at = side + 4
        if edge < 8:
            end_at = ((side + 1) & 3) + 4 * (edge >> 2)
        x, y = seen[begin_at, 0], seen[begin_at, 1]
        along_x, along_y = seen[end_at, 0] - x, seen[end_at, 1] - y
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
