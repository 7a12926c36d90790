"""Oblique views of solids, drawn by the rasteriser: without a screen, and with the same pixels everywhere."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.arithmetic import cosine_sine, moved
from tactile_toolkit.mesh.raster import highest_faces
from tactile_toolkit.pictures.lettering import PAPER, Colour

if TYPE_CHECKING:
    from tactile_toolkit.mesh.mesh import Mesh


# Where the light of reliefs comes from: right, up and out of the picture.
_LIGHT = np.array([-0.45, 0.55, 0.70])

_DARKEST, _RANGE = 60, 180


@dataclass(frozen=True, slots=True)
class View:
    """From where a mesh is looked at, without perspective."""

    azimuth_deg: float  # how far the viewer has walked around the z axis, counter-clockwise from -y
    elevation_deg: float  # how high the viewer stands: 90 looks straight down, with x right and y up

    @property
    def axes(self) -> NDArray[np.float64]:
        """Directions right, up and towards the viewer, one a row: shape (3, 3), of length one."""
        walked, aside = cosine_sine(math.radians(self.azimuth_deg))
        level, raised = cosine_sine(math.radians(self.elevation_deg))
        towards = np.array([level * aside, -level * walked, raised])
        right = np.array([walked, aside, 0.0])
        return np.stack([right, np.cross(towards, right), towards])

    def project(self, points: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Turn points, shape (n, 3), into right, up and towards the viewer, in the same unit."""
        return moved(np.asarray(points, np.float64), self.axes.T)


TOP = View(0.0, 90.0)
"""Straight from above."""

OBLIQUE = View(-25.0, 42.0)
"""From the front, somewhat left and well above: digits stay readable and show their height."""


def averaged(pixels: NDArray[np.uint8], factor: int, paper: int = 255) -> NDArray[np.uint8]:
    """Return a picture, (H, W) or (H, W, 3), so many times smaller, each pixel the mean of those it covers.

    Sides that are not a multiple of ``factor`` are filled up with the level ``paper`` first.
    """
    height, width = (-(-side // factor) for side in pixels.shape[:2])
    spread = [(0, height * factor - pixels.shape[0]), (0, width * factor - pixels.shape[1])]
    whole = np.pad(pixels, [*spread, *[(0, 0)] * (pixels.ndim - 2)], constant_values=paper)
    blocks = whole.reshape(height, factor, width, factor, *pixels.shape[2:])
    sums = blocks.sum(axis=(1, 3), dtype=np.uint32)
    return np.asarray((sums + factor * factor // 2) // (factor * factor), np.uint8)


def shades(points: NDArray[np.float64], faces: NDArray[np.integer[Any]]) -> NDArray[np.uint8]:
    """Return how bright each triangle is, (F,), 60 to 240; points, (V, 3), are right, up and to the viewer.

    One that faces away is lit as if it did not, so that damaged meshes show something, too.
    """
    normals = _across(points, np.asarray(faces))
    normals *= np.where(normals[:, 2:] < 0, -1.0, 1.0)
    light = moved(_unit(normals), _LIGHT[:, None])[:, 0]
    return np.asarray(_DARKEST + _RANGE * np.clip(light, 0, 1)).astype(np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A mesh to draw in a colour, red, green and blue; without ``lit`` in its plain colour."""

    mesh: Mesh
    colour: Colour
    lit: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Picture3d:
    """A picture of bodies, without perspective: lengths along the picture plane keep their scale."""

    bodies: tuple[Body, ...]
    size_px: tuple[int, int]  # width and height
    px_per_m: float
    view: View = OBLIQUE
    paper: Colour = PAPER


def fitting_scale(bodies: Sequence[Body], size_px: tuple[int, int], view: View = OBLIQUE) -> float:
    """Return the scale, pixels per metre, at which bodies just fill a picture of some size."""
    points = np.concatenate([view.project(body.mesh.vertices_m)[:, :2] for body in bodies])
    return float((np.array(size_px) / np.maximum(np.ptp(points, axis=0), 1e-9)).min())


# Pictures are drawn so many times larger and averaged: smooth edges.
_SAMPLING = 2

# Direction (right, up, towards the viewer) and strength of the lights, and how bodies answer to them.
_LIGHTS = (((-0.5, 0.75, 0.9), 0.88), ((0.9, 0.1, 0.6), 0.30))
_AMBIENT, _DIFFUSE, _SPECULAR = 0.22, 0.78, 0.12

# Triangles that lean more than this against one another meet at an edge that is seen.
_COS_SHARP = math.cos(math.radians(40.0))


def draw_bodies(picture: Picture3d) -> NDArray[np.uint8]:
    """Draw bodies, in the middle of the paper, shape (H, W, 3): the surface smooth, sharp edges sharp."""
    counts = [len(body.mesh.faces) for body in picture.bodies]
    starts = np.cumsum([0, *(len(body.mesh.vertices_m) for body in picture.bodies)])
    seen = np.concatenate([picture.view.project(body.mesh.vertices_m) for body in picture.bodies])
    faces = np.concatenate(
        [body.mesh.faces + start for body, start in zip(picture.bodies, starts, strict=False)]
    ).astype(np.int64)
    width, height = (side * _SAMPLING for side in picture.size_px)
    scale = picture.px_per_m * _SAMPLING
    middle = (seen[:, :2].min(axis=0) + seen[:, :2].max(axis=0)) / 2
    # Rows run downwards, and the centre of the first pixel is at column 0, row 0.
    places = (seen[:, :2] - middle) * (scale, -scale) + (width / 2 - 0.5, height / 2 - 0.5)
    nearest = highest_faces(np.stack([*places.T, seen[:, 2]]), faces, (height, width), both_sides=True)
    row, column = np.nonzero(nearest >= 0)
    face = nearest[row, column]

    levels = np.repeat(np.array([body.colour for body in picture.bodies], float), counts, axis=0)[face]
    lit = np.flatnonzero(np.repeat([body.lit for body in picture.bodies], counts)[face])
    corners, normals = places[faces[face[lit]]], _corner_normals(seen, faces)[face[lit]]
    levels[lit] = _lit(levels[lit], _normals_at(column[lit], row[lit], corners, normals))
    pixels = np.full((height, width, 3), picture.paper, np.uint8)
    pixels[row, column] = np.clip(np.round(levels), 0, 255)
    return averaged(pixels, _SAMPLING)


def _across(points: NDArray[np.float64], faces: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
    """Return the normals of triangles, (F, 3), as long as twice their areas."""
    corners = points[faces]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(lengths > 0, lengths, 1.0))


def _corner_normals(points: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return normals at the corners of each triangle, (F, 3, 3): sums over those that meet there smoothly."""
    across = _across(points, faces)
    own, corners = _unit(across), faces.ravel()
    by_vertex = np.argsort(corners, kind="stable")
    first = np.searchsorted(corners[by_vertex], corners)
    meeting = np.bincount(corners)[corners]
    sums = np.zeros((len(corners), 3))
    for turn in range(meeting.max()):
        at = np.flatnonzero(turn < meeting)
        other = by_vertex[first[at] + turn] // 3
        is_smooth = (own[at // 3] * own[other]).sum(axis=1) > _COS_SHARP
        sums[at] += np.where(is_smooth[:, None], across[other], 0.0)
    # A triangle that faces away is lit as if it did not, so that damaged meshes show something, too.
    return np.asarray(_unit(sums).reshape(-1, 3, 3) * np.where(own[:, None, 2:] < 0, -1.0, 1.0))


def _normals_at(
    column: NDArray[np.int64],
    row: NDArray[np.int64],
    corners: NDArray[np.float64],
    normals: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the normal at a pixel of each triangle with corners, (n, 3, 2), and normals there, (n, 3, 3)."""
    start_x, start_y = corners[:, 0].T
    to_b_x, to_b_y = (corners[:, 1] - corners[:, 0]).T
    to_c_x, to_c_y = (corners[:, 2] - corners[:, 0]).T
    x, y = column - start_x, row - start_y
    area = to_b_x * to_c_y - to_b_y * to_c_x
    area = np.where(area == 0, 1.0, area)
    # Rounding may put a point outside of a thin triangle.
    share_b = np.clip((x * to_c_y - y * to_c_x) / area, 0, 1)[:, None]
    share_c = np.clip((to_b_x * y - to_b_y * x) / area, 0, 1)[:, None]
    a, b, c = np.moveaxis(normals, 1, 0)
    return _unit(a + share_b * (b - a) + share_c * (c - a))


def _lit(plain: NDArray[np.float64], normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return colours, (n, 3), as the lights show them: all from one side, and a highlight (Phong 1975)."""
    levels = _AMBIENT * plain
    for direction, strength in _LIGHTS:
        towards = _unit(np.array(direction))
        facing = np.maximum(moved(normals, towards[:, None]), 0.0)
        mirrored = np.maximum(2 * facing * normals[:, 2:] - towards[2], 0.0)
        # To the power of 12, by products alone: every processor rounds those alike.
        highlight = mirrored * mirrored * mirrored
        highlight *= highlight
        highlight *= highlight
        levels += strength * (_DIFFUSE * facing * plain + _SPECULAR * 255 * highlight)
    return levels
