"""Kernels in numba around the solution of a contact: means of blocks, fields of an image, forces."""

from __future__ import annotations

import numpy as np

from tactile_toolkit.array_types import Bool, Float64, Int64
from tactile_toolkit.kernels import compiled


@compiled
def block_means(heights: Float64, block_px: int) -> Float64:
    """Return means over blocks of pixels, (H / block_px, W / block_px)."""
    rows, columns = heights.shape[0] // block_px, heights.shape[1] // block_px
    out = np.zeros((rows, columns))
    for row in range(rows):
        for line in range(row * block_px, (row + 1) * block_px):
            for column in range(columns):
                for place in range(column * block_px, (column + 1) * block_px):
                    out[row, column] += heights[line, place]
    return out / (block_px * block_px)


@compiled
def bring_up(fields: Float64, block_px: int) -> Float64:
    """Return fields (n, h, w) of blocks in the size of their pixels, linear between the centres of blocks."""
    count, rows, columns = fields.shape
    tall, wide = rows * block_px, columns * block_px
    out, line = np.empty((count, tall, wide)), np.empty(columns)
    above, down = _places(rows, block_px)
    left, across = _places(columns, block_px)
    for field in range(count):
        for row in range(tall):
            first, second = fields[field, above[row]], fields[field, min(above[row] + 1, rows - 1)]
            for column in range(columns):
                line[column] = first[column] + down[row] * (second[column] - first[column])
            for column in range(wide):
                value = line[left[column]]
                value += across[column] * (line[min(left[column] + 1, columns - 1)] - value)
                out[field, row, column] = value
    return out


@compiled
def _places(count: int, block_px: int) -> tuple[Int64, Float64]:
    """Return the block before each pixel, and the fraction of the distance to the next block."""
    first, part = np.empty(count * block_px, np.int64), np.empty(count * block_px)
    for number in range(count * block_px):
        place = min(max((number + 0.5) / block_px - 0.5, 0.0), count - 1.0)
        first[number] = int(place)
        part[number] = place - first[number]
    return first, part


@compiled
def follow_body(surface_m: Float64, is_contact: Bool, body_m: Float64) -> None:
    """Set the surface to the body, (H, W), in the contact, and keep it out of the body elsewhere."""
    rows, columns = body_m.shape
    for row in range(rows):
        for column in range(columns):
            body = body_m[row, column]
            if is_contact[row, column] or body > surface_m[row, column]:
                surface_m[row, column] = body
                is_contact[row, column] = True


@compiled
def resultants(
    fields: Float64, pixel_m: tuple[float, float]
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return the force (N) and the torque (N m) about the centre of pressures and tractions (Pa)."""
    rows, columns = fields.shape[1:]
    area = pixel_m[0] * pixel_m[1]
    force_x, force_y, force_z, about_x, about_y, about_z = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for row in range(rows):
        y = ((rows - 1) / 2 - row) * pixel_m[1]
        for column in range(columns):
            x = (column - (columns - 1) / 2) * pixel_m[0]
            p, q_x, q_y = fields[0, row, column], fields[1, row, column], fields[2, row, column]
            force_x, force_y, force_z = force_x + q_x, force_y + q_y, force_z + p
            about_x, about_y, about_z = about_x + y * p, about_y - x * p, about_z + (x * q_y - y * q_x)
    return (
        (force_x * area, force_y * area, force_z * area),
        (about_x * area, about_y * area, about_z * area),
    )
