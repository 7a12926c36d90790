"""Solids in oblique views, with equal pixels on all machines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tactile_toolkit import arithmetic
from tactile_toolkit.array_types import Float64, Floating, Int64, Integers, UInt8
from tactile_toolkit.mesh import Mesh, highest_faces, join_surfaces
from tactile_toolkit.pictures.lettering import PAPER, Colour
from tactile_toolkit.pictures.relief_views import box_downsample
from tactile_toolkit.pictures.vectors import face_normals, unit_vectors

# Pictures are drawn larger by this factor and averaged, for smooth edges.
_SAMPLING = 2

# Direction (right, up, towards the viewer) and strength of the lights, and reflection of bodies.
_LIGHTS = (((-0.5, 0.75, 0.9), 0.88), ((0.9, 0.1, 0.6), 0.30))
_AMBIENT, _DIFFUSE, _SPECULAR = 0.22, 0.78, 0.12

# Triangles with a larger angle between them meet at a visible edge.
_COS_SHARP = math.cos(math.radians(40.0))


@dataclass(frozen=True, slots=True)
class View:
    """A direction of view, without perspective."""

    azimuth_deg: float  # of the viewer around the z axis, counter-clockwise from -y
    elevation_deg: float  # of the viewer: 90 looks straight down, with x right and y up

    @property
    def axes(self) -> Float64:
        """Unit vectors right, up and towards the viewer, one in each row: shape (3, 3)."""
        walked, aside = arithmetic.cosine_sine(math.radians(self.azimuth_deg))
        level, raised = arithmetic.cosine_sine(math.radians(self.elevation_deg))
        towards = np.array([level * aside, -level * walked, raised])
        right = np.array([walked, aside, 0.0])
        return np.stack([right, np.cross(towards, right), towards])

    def project(self, points: Floating) -> Float64:
        """Rotate points, shape (n, 3), to coordinates right, up and towards the viewer."""
        return arithmetic.moved(np.asarray(points, np.float64), self.axes.T)


OBLIQUE = View(-25.0, 42.0)
"""View from the front, slightly left and far above: digits are readable and show their height."""


@dataclass(frozen=True, slots=True, eq=False)
class DrawnBody:
    """A mesh to draw in a colour, red, green and blue; unshaded unless ``lit``."""

    mesh: Mesh
    colour: Colour
    lit: bool = True


def draw_bodies(
    bodies: Sequence[DrawnBody],
    size_px: tuple[int, int],
    px_per_m: float,
    view: View = OBLIQUE,
    paper: Colour = PAPER,
) -> UInt8:
    """Draw bodies in the middle of a picture of a given width and height, smooth except at sharp edges.

    The projection is parallel: lengths along the picture plane keep their scale. Returns shape (H, W, 3).
    """
    counts = [len(body.mesh.faces) for body in bodies]
    vertices_m, faces = join_surfaces([(body.mesh.vertices_m, body.mesh.faces) for body in bodies])
    seen = view.project(vertices_m)
    width, height = (side * _SAMPLING for side in size_px)
    scale = px_per_m * _SAMPLING
    middle = (seen[:, :2].min(axis=0) + seen[:, :2].max(axis=0)) / 2
    # Rows grow downwards, and the centre of the first pixel is at column 0, row 0.
    places = (seen[:, :2] - middle) * (scale, -scale) + (width / 2 - 0.5, height / 2 - 0.5)
    nearest = highest_faces(np.stack([*places.T, seen[:, 2]]), faces, (height, width), both_sides=True)
    row, column = np.nonzero(nearest >= 0)
    face = nearest[row, column]

    levels = np.repeat(np.array([body.colour for body in bodies], float), counts, axis=0)[face]
    lit = np.flatnonzero(np.repeat([body.lit for body in bodies], counts)[face])
    corners, normals = places[faces[face[lit]]], _corner_normals(seen, faces)[face[lit]]
    levels[lit] = _lit(levels[lit], _normals_at(column[lit], row[lit], corners, normals))
    pixels = np.full((height, width, 3), paper, np.uint8)
    pixels[row, column] = np.clip(np.round(levels), 0, 255)
    return box_downsample(pixels, _SAMPLING)


def _corner_normals(points: Float64, faces: Integers) -> Float64:
    """Return normals at the corners of triangles, (F, 3, 3): sums over triangles that meet smoothly."""
    across = face_normals(points, faces)
    own, corners = unit_vectors(across), faces.ravel()
    by_vertex = np.argsort(corners, kind="stable")
    first = np.searchsorted(corners[by_vertex], corners)
    meeting = np.bincount(corners)[corners]
    sums = np.zeros((len(corners), 3))
    for turn in range(meeting.max()):
        at = np.flatnonzero(turn < meeting)
        other = by_vertex[first[at] + turn] // 3
        is_smooth = (own[at // 3] * own[other]).sum(axis=1) > _COS_SHARP
        sums[at] += np.where(is_smooth[:, None], across[other], 0.0)
    # Triangles that point away are lit as if they did not, so that damaged meshes are visible.
    return np.asarray(unit_vectors(sums).reshape(-1, 3, 3) * np.where(own[:, None, 2:] < 0, -1.0, 1.0))


def _normals_at(
    column: Int64,
    row: Int64,
    corners: Float64,
    normals: Float64,
) -> Float64:
    """Interpolate normals at a pixel of each triangle, given corners, (n, 3, 2), and normals, (n, 3, 3)."""
    start_x, start_y = corners[:, 0].T
    to_b_x, to_b_y = (corners[:, 1] - corners[:, 0]).T
    to_c_x, to_c_y = (corners[:, 2] - corners[:, 0]).T
    x, y = column - start_x, row - start_y
    area = to_b_x * to_c_y - to_b_y * to_c_x
    area = np.where(area == 0, 1.0, area)
    # Rounding may place a point outside a thin triangle.
    share_b = np.clip((x * to_c_y - y * to_c_x) / area, 0, 1)[:, None]
    share_c = np.clip((to_b_x * y - to_b_y * x) / area, 0, 1)[:, None]
    a, b, c = np.moveaxis(normals, 1, 0)
    return unit_vectors(a + share_b * (b - a) + share_c * (c - a))


def _lit(plain: Float64, normals: Float64) -> Float64:
    """Shade colours, (n, 3), with diffuse light and highlights (Phong 1975)."""
    levels = _AMBIENT * plain
    for direction, strength in _LIGHTS:
        towards = unit_vectors(np.array(direction))
        facing = np.maximum(arithmetic.moved(normals, towards[:, None]), 0.0)
        mirrored = np.maximum(2 * facing * normals[:, 2:] - towards[2], 0.0)
        # To the power of 12 by products, which all processors round alike.
        highlight = mirrored * mirrored * mirrored
        highlight *= highlight
        highlight *= highlight
        levels += strength * (_DIFFUSE * facing * plain + _SPECULAR * 255 * highlight)
    return levels
