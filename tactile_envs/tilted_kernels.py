"""Kernels of touches by tilted sensors, in numba: meshes are seen along the axis of a sensor.

A sensor is tilted by at most 45 degrees: its window sees a few cells of a mesh's grid only. Kernels of other
files are compiled into these, and numba's cache on disk does not notice when they change.
"""

from __future__ import annotations

import math

import numpy as np

from tactile_envs.touch_kernels import (
    EDGE_PX,
    PADDING,
    Pool,
    Room,
    batch_room,
    draw_touch,
    highest_of,
    lay_edge,
    leave,
    raise_within,
)
from tactile_toolkit.array_types import Bool, Float32, Float64, Int64
from tactile_toolkit.kernels import compiled


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
    """Press tilted sensors along their axes, and let the objects slip, for environments ``begin`` to ``end``.

    ``plate`` is a pool of one mesh, the plate under the objects with its upper side at height 0; what lies
    more than ``far`` below the target of a sensor, metres, is not seen. ``axes`` (n, 3, 3) has the x, y and z
    axis of each sensor in its columns; ``sensors`` (n, 3), metres, are moved along z until the gel is pressed
    in. The rest is as for :func:`tactile_envs.touch_kernels.touch`.
    """
    greatest, room = np.empty(images.shape[2], np.float32), batch_room()
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
        highest = highest_of(heights, greatest)
        is_bare[i] = False  # a tilted plate is seen, too
        # Distance along its axis at which the sensor reaches its least height.
        least_m = (window[5] - sensors[i, 2]) / axes[i, 2, 2]
        draw_touch(i, images, depths, heights, highest, window, least_m)
        observed_m = max(highest + window[3] + lifts[i], least_m)
        for axis in range(3):
            sensors[i, axis] += axes[i, axis, 2] * observed_m
        leave(i, cosine, sine, motion, drift, sensors, objects, positions)


@compiled
def _look(view: Float64, window: Float64, axes: Float64, sensor: Float64, lying: Float64) -> None:
    """Write the affine map of a mesh to columns, rows and heights, metres, shape (3, 4).

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

    ``heights``, shape (H, W + PADDING), metres towards the sensor, has its first row at the bottom; samples
    of pixels are at integers. ``view`` (3, 4) gives column, row and height of a point x, y, z, 1 of the mesh.
    """
    seen_by = (
        (view[0, 0], view[0, 1], view[0, 2], view[0, 3]),
        (view[1, 0], view[1, 1], view[1, 2], view[1, 3]),
        (view[2, 0], view[2, 1], view[2, 2], view[2, 3]),
    )
    seen, edges = _seen_in_grid(heights, pool[3][number], view), room[3]
    # Four around the foot, four around the top, and four upright ones.
    for edge in range(12):
        side = edge & 3
        begin, end = side + 4 * (edge >> 2 == 1), side + 4
        if edge < 8:
            end = ((side + 1) & 3) + 4 * (edge >> 2)
        edges[0, edge], edges[1, edge] = seen[begin, 0], seen[begin, 1]
        lay_edge(edges, edge, seen[end, 0], seen[end, 1])
    raise_within(heights, pool, number, 12, seen_by, room)


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
        column = columns - 1.0 + EDGE_PX if side == 1 or side == 2 else -EDGE_PX
        row = rows - 1.0 + EDGE_PX if side >= 2 else -EDGE_PX
        over = column - view[0, 3] - view[0, 2] * height_m
        along = row - view[1, 3] - view[1, 2] * height_m
        seen[corner, 0] = (view[1, 1] * over - view[0, 1] * along) * per_area - grid[6]
        seen[corner, 1] = (view[0, 0] * along - view[1, 0] * over) * per_area - grid[7]
    return seen
