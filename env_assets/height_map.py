"""Height maps: the top surface of a mesh on a grid of pixels, exact at their centres.

This module defines where a map lies and what its values mean; :mod:`tactile_toolkit.mesh.raster` turns
triangles into pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real

import numpy as np

from tactile_toolkit.array_types import Bool, Float32, Float64
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import MAX_PIXELS, Mesh, MeshLike, highest_values


@dataclass(frozen=True, slots=True, eq=False)
class HeightMap:
    """The top surface of a mesh, in the frame of the mesh.

    The pixels of a pitch are the same for all meshes: pixel (i, j) is the square from ``i * pitch`` to
    ``(i + 1) * pitch`` along x and from ``j * pitch`` to ``(j + 1) * pitch`` along y. A map has those that
    touch the mesh.

    Row 0 has the least y and column 0 the least x: ``heights_m[row, column]`` is the surface above the point
    ``(x_m[column], y_m[row])``, the centre of that pixel. (Pictures put row 0 on top: show
    ``heights_m[::-1]``, or give matplotlib ``origin="lower"``.) Above pixels whose centre lies outside the
    mesh, as seen from above, the height is NaN.

    Attributes
    ----------
    heights_m : ndarray of float32, shape (rows, columns)
        z of the highest point of the mesh above each pixel centre, metres; read-only.
    first_column, first_row : int
        Least i and j.
    pitch_m : float
        Side of a pixel, metres.
    """

    heights_m: Float32
    first_column: int
    first_row: int
    pitch_m: float

    @property
    def x_m(self) -> Float64:
        """Centre of each column along x, shape (columns,), metres."""
        return _centres_m(self.first_column, self.heights_m.shape[1], self.pitch_m)

    @property
    def y_m(self) -> Float64:
        """Centre of each row along y, shape (rows,), metres."""
        return _centres_m(self.first_row, self.heights_m.shape[0], self.pitch_m)

    @property
    def covered(self) -> Bool:
        """Mask of the pixel centres under the mesh, shape (rows, columns)."""
        return ~np.isnan(self.heights_m)

    def filled(self, outside_m: float = 0.0) -> Float32:
        """Return the heights with a number in place of NaN, such as the plate's; a new array."""
        return np.where(self.covered, self.heights_m, np.float32(outside_m))


def top_surface(mesh: MeshLike, pitch_m: float) -> HeightMap:
    """Turn a mesh into a height map.

    Exact at pixel centres: the height is that of the highest triangle above the centre. Triangles are closed:
    a centre on an edge or corner is covered. Vertical triangles cover nothing. The mesh has to be a solid,
    with triangles counter-clockwise seen from outside.

    Parameters
    ----------
    mesh : Mesh, record or trimesh.Trimesh
        In metres.
    pitch_m : float
        Side of a pixel, metres.

    Returns
    -------
    HeightMap
        As many pixels as touch the bounding box of the mesh.

    Raises
    ------
    InputError
        No mesh, none of its vertices or an infinite one; a pitch that is not positive, or too small.

    Examples
    --------
    >>> from tactile_toolkit.mesh.mesh import Mesh
    >>> corners = np.array([[0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, 4]], np.float32)
    >>> faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)
    >>> top_surface(Mesh(corners, faces), 1.0).heights_m[0]
    array([3., 2., 1., 0.], dtype=float32)
    """
    if not _is_length(pitch_m):
        raise InputError(
            f"the pitch of a height map is {pitch_m!r} m; expected a positive length such as 0.0002"
        )
    mesh = Mesh.of(mesh)
    vertices_m = np.asarray(mesh.vertices_m)
    if not len(vertices_m) or not np.isfinite(vertices_m).all():
        raise InputError("a mesh with no vertices, or NaN or infinite ones, has no height map")
    low = vertices_m[:, :2].astype(np.float64).min(axis=0)
    high = vertices_m[:, :2].max(axis=0)
    # The errors of a tiny pitch, which is refused below.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        # Counted from the origin and not from the mesh: two meshes of one frame share their pixels.
        first, stop = np.floor(low / float(pitch_m)), np.ceil(high / float(pitch_m))
        columns, rows = np.maximum(stop - first, 1).tolist()
    if not columns * rows <= MAX_PIXELS:
        raise InputError(
            f"a height map of {columns:.7g} x {rows:.7g} pixels of {pitch_m:g} m was asked for, at most "
            f"{MAX_PIXELS:,} are made",
            next="choose a larger pitch",
        )
    first_column, first_row = map(int, first)
    x_m, y_m, z_m = vertices_m.T.astype(np.float64)
    # The centre of pixel (i, j) of the map is at column i, row j.
    places = x_m / pitch_m - (first_column + 0.5), y_m / pitch_m - (first_row + 0.5)
    heights_m = highest_values(np.stack([*places, z_m]), mesh.faces, (int(rows), int(columns)))
    heights_m[np.isneginf(heights_m)] = np.nan
    heights_m.setflags(write=False)
    return HeightMap(heights_m, first_column, first_row, float(pitch_m))


def _is_length(value: object) -> bool:
    return isinstance(value, (Real, np.number)) and 0 < float(value) < np.inf


def _centres_m(first: int, count: int, pitch_m: float) -> Float64:
    return np.asarray((np.arange(first, first + count) + 0.5) * pitch_m)
