"""Relief and oblique views of meshes, with equal pixels on all machines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tactile_toolkit.arithmetic import cosine_sine, moved
from tactile_toolkit.array_types import Float64, Floating, Int64, Integers, UInt8
from tactile_toolkit.mesh import Mesh, highest_faces, joined
from tactile_toolkit.pictures.lettering import PAPER, Colour
from tactile_toolkit.pictures.picture_files import TILE_STYLE, figure_html

_PITCH_M = 0.0002
_TILE_PX = 96
_MOST_PX = 4096  # largest side of a relief

# Direction of the light of reliefs: right, up and out of the picture.
_LIGHT = np.array([-0.45, 0.55, 0.70])

_DARKEST, _RANGE = 60, 180


@dataclass(frozen=True, slots=True)
class View:
    """A direction of view, without perspective."""

    azimuth_deg: float  # of the viewer around the z axis, counter-clockwise from -y
    elevation_deg: float  # of the viewer: 90 looks straight down, with x right and y up

    @property
    def axes(self) -> Float64:
        """Unit vectors right, up and towards the viewer, one in each row: shape (3, 3)."""
        walked, aside = cosine_sine(math.radians(self.azimuth_deg))
        level, raised = cosine_sine(math.radians(self.elevation_deg))
        towards = np.array([level * aside, -level * walked, raised])
        right = np.array([walked, aside, 0.0])
        return np.stack([right, np.cross(towards, right), towards])

    def project(self, points: Floating) -> Float64:
        """Rotate points, shape (n, 3), to coordinates right, up and towards the viewer."""
        return moved(np.asarray(points, np.float64), self.axes.T)


OBLIQUE = View(-25.0, 42.0)
"""View from the front, slightly left and far above: digits are readable and show their height."""


def box_downsample(pixels: UInt8, factor: int) -> UInt8:
    """Reduce a picture, (H, W) or (H, W, 3), by an integer factor; each pixel is a mean.

    Sides that are not a multiple of ``factor`` are padded with white.
    """
    height, width = (-(-side // factor) for side in pixels.shape[:2])
    padding = [(0, height * factor - pixels.shape[0]), (0, width * factor - pixels.shape[1])]
    padded = np.pad(pixels, [*padding, *[(0, 0)] * (pixels.ndim - 2)], constant_values=255)
    blocks = padded.reshape(height, factor, width, factor, *pixels.shape[2:])
    sums = blocks.sum(axis=(1, 3), dtype=np.uint32)
    return np.asarray((sums + factor * factor // 2) // (factor * factor), np.uint8)


def relief(vertices_m: Floating, faces: Integers, pitch_m: float = _PITCH_M) -> UInt8:
    """Draw a mesh from above in shaded relief, with pixels of ``pitch_m``, or larger ones for large meshes.

    Returns levels of uint8, shape (H, W): 255 is empty paper; row 0 is the largest y.
    """
    vertices, faces = np.asarray(vertices_m, np.float64), np.asarray(faces)
    low, high = vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0)
    # A mesh in millimetres that is read in metres would have 10^10 pixels.
    pitch_m = max(pitch_m, float((high - low).max()) / _MOST_PX)
    # Four pixels of margin on each side, and one for the pixel of the last corner.
    width, height = (np.ceil((high - low) / pitch_m).astype(int) + 9).tolist()
    columns, rows = ((vertices[:, :2] - low) / pitch_m + 4).T
    # Rows grow with y here, so that triangles keep their orientation; the picture is flipped at the end.
    seen = highest_faces(np.stack([columns, rows, vertices[:, 2]]), faces, (height, width))
    normals = _across(vertices, faces)
    # Faces that point away are lit as if they did not, so that damaged meshes are visible.
    normals *= np.where(normals[:, 2:] < 0, -1.0, 1.0)
    light = moved(_unit(normals), _LIGHT[:, None])[:, 0]
    shades = np.asarray(_DARKEST + _RANGE * np.clip(light, 0, 1)).astype(np.uint8)
    return np.append(shades, np.uint8(255))[seen[::-1]]


def relief_tile_html(vertices_m: Floating, faces: Integers, caption: str) -> str:
    """Return HTML for notebooks of a small relief and its caption, which is plain text."""
    pitch_m = max(float(np.ptp(vertices_m[:, :2], axis=0).max()) / _TILE_PX, 1e-6)
    return figure_html(relief(vertices_m, faces, pitch_m), caption, TILE_STYLE)


def relief_of(mesh: Mesh, px_per_mm: float, smoothing: int = 3) -> UInt8:
    """Draw a mesh as :func:`relief` does, with smooth edges. The margin is one to two pixels."""
    return box_downsample(relief(mesh.vertices_m, mesh.faces, 1e-3 / (px_per_mm * smoothing)), smoothing)


@dataclass(frozen=True, slots=True, eq=False)
class DrawnBody:
    """A mesh to draw in a colour, red, green and blue; unshaded unless ``lit``."""

    mesh: Mesh
    colour: Colour
    lit: bool = True


# Pictures are drawn larger by this factor and averaged, for smooth edges.
_SAMPLING = 2

# Direction (right, up, towards the viewer) and strength of the lights, and reflection of bodies.
_LIGHTS = (((-0.5, 0.75, 0.9), 0.88), ((0.9, 0.1, 0.6), 0.30))
_AMBIENT, _DIFFUSE, _SPECULAR = 0.22, 0.78, 0.12

# Triangles with a larger angle between them meet at a visible edge.
_COS_SHARP = math.cos(math.radians(40.0))


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
    vertices_m, faces = joined([(body.mesh.vertices_m, body.mesh.faces) for body in bodies])
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


def _across(points: Float64, faces: Integers) -> Float64:
    """Return normals of triangles, (F, 3), with twice their areas as lengths."""
    corners = points[faces]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _unit(vectors: Float64) -> Float64:
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(lengths > 0, lengths, 1.0))


def _corner_normals(points: Float64, faces: Integers) -> Float64:
    """Return normals at the corners of triangles, (F, 3, 3): sums over triangles that meet smoothly."""
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
    # Triangles that point away are lit as if they did not, so that damaged meshes are visible.
    return np.asarray(_unit(sums).reshape(-1, 3, 3) * np.where(own[:, None, 2:] < 0, -1.0, 1.0))


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
    return _unit(a + share_b * (b - a) + share_c * (c - a))


def _lit(plain: Float64, normals: Float64) -> Float64:
    """Shade colours, (n, 3), with diffuse light and highlights (Phong 1975)."""
    levels = _AMBIENT * plain
    for direction, strength in _LIGHTS:
        towards = _unit(np.array(direction))
        facing = np.maximum(moved(normals, towards[:, None]), 0.0)
        mirrored = np.maximum(2 * facing * normals[:, 2:] - towards[2], 0.0)
        # To the power of 12 by products, which all processors round alike.
        highlight = mirrored * mirrored * mirrored
        highlight *= highlight
        highlight *= highlight
        levels += strength * (_DIFFUSE * facing * plain + _SPECULAR * 255 * highlight)
    return levels
