"""Scenes: the placements of their objects, meshes and drawings."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from PIL import Image, ImageDraw

from starstruck_gen import shapes
from tactile_toolkit import mesh, read
from tactile_toolkit.arithmetic import cosine_sine
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh
from tactile_toolkit.touch import CELL_M
from tactile_toolkit.value_types import UInt8

if TYPE_CHECKING:
    import manifold3d


STORAGE_MARGIN_M = 1e-7
"""Margin beyond the clearance: float32 storage moves coordinates by up to a third of it."""

STAR_COLOUR = (214, 140, 20)
DISTRACTOR_COLOUR = (92, 110, 132)

# Factor by which scenes are drawn larger, then reduced, for smooth edges.
_SUPERSAMPLING = 4

_PLATE = (245, 243, 238)
_EDGE = (40, 40, 40)
_OPAQUE_FROM = 150  # each object is at least this many levels darker than the plate

# Largest enlarged drawing: 300 MB at three bytes for each pixel.
_MAX_PIXELS = 100_000_000


class Placement(NamedTuple):
    """One object of a scene.

    Frame: origin at the cell's centre, x right, y away from the robot, z up from the plate.

    Attributes
    ----------
    shape : str
        The ``key`` of a :class:`starstruck_gen.Shape`: its name, with proportions that differ from those of
        its kind in brackets, such as ``star`` or ``star(points=6)``.
    x_m, y_m : float
        Centre of its circumscribed circle, metres.
    angle_rad : float
        Rotation about z, counter-clockwise, radians.
    radius_m : float
        Circumscribed radius, metres.
    height_m : float
        Height over the plate, metres.
    """

    shape: str
    x_m: float
    y_m: float
    angle_rad: float
    radius_m: float
    height_m: float

    @property
    def is_star(self) -> bool:
        """Whether the object is a star, which is counted."""
        return self.shape.partition("(")[0] == shapes.STAR


def circles_clear(placement: Placement, others: Sequence[Placement], clearance_m: float) -> bool:
    """Return whether circumscribed circles keep a clearance: the rule of package tactile-mnist 0.13.0."""
    _, x_m, y_m, _, radius_m, _ = placement
    # A loop of products, without calls or roots: each pair of objects is tested up to 100 times.
    for _, other_x_m, other_y_m, _, other_radius_m, _ in others:
        along_m, across_m = x_m - other_x_m, y_m - other_y_m
        least_m = radius_m + other_radius_m + clearance_m + STORAGE_MARGIN_M
        if not along_m * along_m + across_m * across_m > least_m * least_m:  # NaN is not clear
            return False
    return True


def outlines_clear(placement: Placement, others: Sequence[Placement], clearance_m: float) -> bool:
    """Return whether outlines keep a clearance, as measured by manifold3d.

    An object inside a hole of another one is clear of it; an object inside its solid is not.
    """
    least_mm = (clearance_m + STORAGE_MARGIN_M) * mesh.MM_PER_M
    near = (neighbour for neighbour in others if not circles_clear(placement, [neighbour], clearance_m))
    pairs = ((_standing(placement), _standing(neighbour)) for neighbour in near)
    # The gap does not reveal an object inside another one, and is slow to compute if objects overlap.
    return all((a ^ b).is_empty() and a.min_gap(b, 2 * least_mm) > least_mm for a, b in pairs)


COLLISION_TESTS = {"circles": circles_clear, "exact": outlines_clear}
"""Collision rules by name: whether an object keeps a clearance, in metres, to others."""


def _standing(placement: Placement) -> manifold3d.Manifold:
    """Return the solid of an object in its place, millimetres, 1 mm high."""
    c, s = cosine_sine(placement.angle_rad)
    x_mm, y_mm = placement.x_m * mesh.MM_PER_M, placement.y_m * mesh.MM_PER_M
    matrix = np.array([[c, -s, 0.0, x_mm], [s, c, 0.0, y_mm], [0.0, 0.0, 1.0, 0.0]])
    return prism_solid(placement.shape, placement.radius_m).transform(matrix)


@lru_cache(shapes.MAX_KEPT)
def prism_solid(key: str, radius_m: float) -> manifold3d.Manifold:
    """Return the solid of a shape for manifold3d: millimetres, 1 mm high, centred, not turned."""
    made = shapes.prism(key)
    vertices_m = made.vertices(0.0) * radius_m
    vertices_m[1::2, 2] = 1e-3
    return mesh.Mesh(vertices_m, made.faces).to_manifold()


@dataclass(frozen=True, slots=True, eq=False)
class SceneMeshes:
    """The meshes of a batch of scenes.

    Attributes
    ----------
    vertices_m : RaggedColumn
        Row i: vertices of scene i, shape (V_i, 3), float32, metres, as they are stored.
    faces : RaggedColumn
        Row i: triangles of scene i, shape (F_i, 3), int32, numbered within the scene.
    """

    vertices_m: read.RaggedColumn
    faces: read.RaggedColumn

    def __len__(self) -> int:
        return len(self.vertices_m)

    def __getitem__(self, index: int) -> mesh.Mesh:
        """Return the mesh of one scene: views, no copies."""
        return mesh.Mesh(self.vertices_m[index], self.faces[index])


def build_meshes(layouts: Sequence[Sequence[Placement]]) -> SceneMeshes:
    """Make the meshes of a batch of scenes.

    Each object is a separate solid on z = 0, in the order of the placements; see
    :class:`starstruck_gen.Placement` for the frame. The mesh of a scene does not depend on the other scenes
    of the batch.

    Parameters
    ----------
    layouts : sequence of sequence of Placement
        Objects of each scene.

    Returns
    -------
    SceneMeshes
    """
    from starstruck_gen.compiled_vertices import standing_vertices  # numba takes 0.5 s to import

    outlines = [shapes.prisms(tuple([placement.shape for placement in layout])) for layout in layouts]
    poses = np.array([placement[1:] for layout in layouts for placement in layout], np.float64)
    parts = outlines or [shapes.prisms(())]  # there may be no layout
    corners = np.concatenate([made.corners for made in parts])
    corner_counts = np.concatenate([made.corner_counts for made in parts])
    faces = np.concatenate([made.faces for made in parts])
    vertices = standing_vertices(poses.reshape(-1, 5), corners, corner_counts)
    # Where the rows of each scene begin, and the end of the last one.
    sizes = [(2 * len(made.corners), len(made.faces)) for made in outlines]
    first_vertices, first_faces = np.cumsum([(0, 0), *sizes], axis=0, dtype=np.int64).T.copy()
    return SceneMeshes(read.RaggedColumn(vertices, first_vertices), read.RaggedColumn(faces, first_faces))


def draw_scene(placements: Iterable[Placement], cell_m: tuple[float, float], px_per_mm: float) -> Image.Image:
    """Draw objects on a plate, as :meth:`starstruck_gen.Scene.draw` does.

    Raises InputError if the picture would have no pixel, or too many.
    """
    sides = np.round(np.array(cell_m) * 1e3 * px_per_mm)
    most = _MAX_PIXELS // _SUPERSAMPLING**2
    if not (np.isfinite(sides).all() and sides.min() >= 1 and sides.prod() <= most):
        raise InputError(
            f"the picture would have {sides[0]:g} x {sides[1]:g} pixels; expected 1 to {most:,} pixels",
            next="change px_per_mm",
        )
    width, height = sides.astype(int).tolist()
    picture = Image.new("RGB", (width * _SUPERSAMPLING, height * _SUPERSAMPLING), _PLATE)
    for placement in placements:
        _paint_object(picture, placement, px_per_mm * 1e3 * _SUPERSAMPLING)
    return picture.resize((width, height), Image.Resampling.LANCZOS)


def without_plate(pixels: UInt8) -> UInt8:
    """Return a picture of a scene with opacity, (H, W, 4): the plate is transparent."""
    levels = pixels.astype(np.float32)
    plate = np.array(_PLATE, np.float32)
    opacity = np.clip((plate - levels).max(axis=-1) / _OPAQUE_FROM, 0, 1)[..., None]
    # The share of the plate in smooth edges is removed, so that no light rim shows on dark pages.
    ink = np.clip((levels - (1 - opacity) * plate) / np.maximum(opacity, 1 / 255), 0, 255)
    return np.concatenate([np.where(opacity > 0, ink, 0), 255 * opacity], axis=-1).round().astype(np.uint8)


def _paint_object(picture: Image.Image, placement: Placement, px_per_m: float) -> None:
    """Paint an object and its edge in its place; ``px_per_m`` is the scale of the enlarged drawing."""
    c, s = cosine_sine(placement.angle_rad)
    rings = []
    for ring in shapes.outline(placement.shape):
        turned = ring[:, :1] * (c, s) + ring[:, 1:] * (-s, c)
        standing_m = placement.radius_m * turned + (placement.x_m, placement.y_m)
        rings.append(standing_m * px_per_m * (1.0, -1.0) + np.array(picture.size) / 2)
    # A mask of the size of the object keeps its holes open, so that objects inside them stay visible.
    low, high = (
        np.clip((rings[0].min(axis=0), rings[0].max(axis=0) + 2), 0, picture.size).astype(int).tolist()
    )
    mask = Image.new("L", (high[0] - low[0], high[1] - low[1]))
    fill = 255
    for edge_px in rings:
        ImageDraw.Draw(mask).polygon((edge_px - low).ravel().tolist(), fill=fill)
        fill = 0  # rings after the first are holes
    colour = STAR_COLOUR if placement.is_star else DISTRACTOR_COLOUR
    picture.paste(colour, (*low, *high), mask)
    for edge_px in rings:
        ImageDraw.Draw(picture).polygon(edge_px.ravel().tolist(), outline=_EDGE, width=_SUPERSAMPLING)


@dataclass(frozen=True, slots=True)
class Scene:
    """Stars and distractors in a cell, and statistics of their placement.

    Attributes
    ----------
    star_count : int
        Number of stars.
    placements : tuple of Placement
        Objects in the order of placing, stars first. Frame: origin at the centre of the cell, z = 0 on the
        plate.
    attempts : tuple of int
        Positions drawn for each object, over all layouts of the scene.
    restarts : int
        How often the scene was started over.
    """

    star_count: int
    placements: tuple[Placement, ...]
    attempts: tuple[int, ...]
    restarts: int

    @property
    def distractor_count(self) -> int:
        """Number of objects that are not stars."""
        return len(self.placements) - self.star_count

    def mesh(self) -> Mesh:
        """Return the mesh: one watertight solid per object, float32 vertices in metres, as they are stored.

        Returns
        -------
        tactile_toolkit.mesh.Mesh
            Arrays ``vertices_m`` and ``faces``, with ``volume_m3`` and ``bounds_m``; its ``to_trimesh()``
            returns the `trimesh.Trimesh` that ``mesh`` of a record is.
        """
        return build_meshes([self.placements])[0]

    def draw(self, cell_m: tuple[float, float] = CELL_M, px_per_mm: float = 4.0) -> Image.Image:
        """Draw the scene from above, x right and y up, stars in their own colour.

        Parameters
        ----------
        cell_m : tuple of float
            Size of the cell, metres.
        px_per_mm : float
            Scale of the picture, pixels per millimetre.

        Returns
        -------
        PIL.Image.Image
            RGB.

        Raises
        ------
        InputError
            The picture would have no pixel, or more than 6.25 million.
        """
        return draw_scene(self.placements, cell_m, px_per_mm)
