"""Solids as arrays of one shape: points on the surface, voxels, and height maps in a fixed box."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.height_map import MOST_PIXELS
from tactile_toolkit.mesh.raster import highest_values, pixels_of, scan_lines

# Columns of voxels are followed this far next to their centres, in voxels: there no edge of a solid lies, and
# only one of the triangles that share it is met.
_ASIDE_PX = (0.618e-5, 0.414e-5)


@dataclass(frozen=True, slots=True)
class Box:
    """The part of space that a grid covers: centred on the origin along x and y, from z = 0 upwards.

    Attributes
    ----------
    extent_m : tuple of three floats
        Size along x, y and z, metres.
    pitch_m : float
        Side of a voxel or pixel, metres.

    Raises
    ------
    InputError
        A length is not positive, or the grid is too large.
    """

    extent_m: tuple[float, float, float]
    pitch_m: float

    def __post_init__(self) -> None:
        lengths = np.array([*self.extent_m, self.pitch_m], np.float64)
        possible = lengths.shape == (4,) and bool((lengths > 0).all()) and bool(np.isfinite(lengths).all())
        if not possible or not np.prod(np.maximum(1.0, lengths[:3] / lengths[3])) <= MOST_PIXELS:
            raise InputError(
                f"a grid of {self.extent_m!r} m in steps of {self.pitch_m!r} m was asked for; expected three "
                f"positive lengths and a step such as 0.001, at most {MOST_PIXELS:,} voxels"
            )

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels along z, y and x."""
        columns, rows, layers = (max(1, round(length / self.pitch_m)) for length in self.extent_m)
        return layers, rows, columns

    def grid_points(self, vertices_m: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Return column, row and layer of vertices, shape (3, V); voxel centres have integers."""
        _, rows, columns = self.shape
        middle = np.array([[columns / 2.0], [rows / 2.0], [0.0]])
        return np.asarray(vertices_m.T.astype(np.float64) / self.pitch_m + (middle - 0.5))


def surface_points(
    vertices_m: NDArray[np.floating[Any]],
    faces: NDArray[np.integer[Any]],
    count: int,
    random: np.random.Generator,
) -> NDArray[np.float32]:
    """Draw points on a surface, each place as likely as any other: shape (count, 3), float32, metres."""
    a, b, c = (vertices_m[corner].astype(np.float64) for corner in np.asarray(faces).T)
    areas = np.cumsum(np.linalg.norm(np.cross(b - a, c - a), axis=1))
    numbers = random.random((3, count))
    face = np.minimum(np.searchsorted(areas, numbers[0] * areas[-1], side="right"), len(areas) - 1)
    # The root spreads the points evenly over a triangle, which narrows towards its first corner.
    root, along = np.sqrt(numbers[1])[:, None], numbers[2][:, None]
    points = a[face] * (1.0 - root) + b[face] * (root * (1.0 - along)) + c[face] * (root * along)
    return np.asarray(points, np.float32)


def heights_in(
    box: Box, vertices_m: NDArray[np.floating[Any]], faces: NDArray[np.integer[Any]]
) -> NDArray[np.float32]:
    """Return the height of the top surface over each pixel centre, 0 next to the solid.

    Shape (rows, columns), float32, metres; row 0 has the least y. See
    :func:`tactile_toolkit.mesh.height_map.top_surface`.
    """
    points = box.grid_points(vertices_m)
    points[2] = vertices_m[:, 2]
    heights_m = highest_values(points, faces, box.shape[1:])
    return np.where(np.isneginf(heights_m), np.float32(0), heights_m)


def voxels_in(
    box: Box, vertices_m: NDArray[np.floating[Any]], faces: NDArray[np.integer[Any]]
) -> NDArray[np.uint8]:
    """Return which voxel centres lie inside a solid: shape (layers, rows, columns) of z, y, x, uint8."""
    layers, rows, columns = box.shape
    points = box.grid_points(vertices_m)
    points[:2] += np.array(_ASIDE_PX)[:, None]
    (ab_x, ab_y), (ac_x, ac_y) = (points[:2, faces.T[corner]] - points[:2, faces.T[0]] for corner in (1, 2))
    upwards = ab_x * ac_y > ab_y * ac_x
    # How often the surface is entered less how often it is left, on the way up a column: 1 inside.
    # One layer more, for what is entered or left above the box.
    change = np.zeros((layers + 1) * rows * columns, np.int32)
    for lines in scan_lines(points, faces, (rows, columns), both_sides=True):
        for line, pixel, height in pixels_of(lines, columns):
            layer = np.clip(np.ceil(height), 0, layers).astype(np.int64)
            np.add.at(change, layer * (rows * columns) + pixel, np.where(upwards[lines.face[line]], -1, 1))
    inside = np.cumsum(change.reshape(layers + 1, rows, columns)[:-1], axis=0) > 0
    return inside.astype(np.uint8)
