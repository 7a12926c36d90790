"""Solids from above and in oblique views, and records of them that draw themselves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from PIL import Image

from tactile_toolkit import arithmetic, mesh
from tactile_toolkit.mesh import Mesh
from tactile_toolkit.mesh.mesh import join_surfaces
from tactile_toolkit.mesh.raster import highest_faces
from tactile_toolkit.pictures.sheets import PAPER, Colour, Drawn, Tile, sheet
from tactile_toolkit.value_types import Float64, Floating, Int64, Integers, UInt8
from tactile_toolkit.wording import class_name, with_count

# Pictures are drawn larger by this factor and averaged, for smooth edges.
_SAMPLING = 2

# Direction (right, up, towards the viewer) and strength of the lights, and reflection of bodies.
_LIGHTS = (((-0.5, 0.75, 0.9), 0.88), ((0.9, 0.1, 0.6), 0.30))
_AMBIENT, _DIFFUSE, _SPECULAR = 0.22, 0.78, 0.12

# Direction of the light of reliefs: right, up and out of the picture; and their grey levels.
_RELIEF_LIGHT = np.array([-0.45, 0.55, 0.70])
_DARKEST = 60
_RANGE = 180
_MARGIN_PX = 2
_MAX_RELIEF_PX = 2_048

_MESH_PX = 520  # width of the picture of a single mesh

# Triangles with a larger angle between them meet at a visible edge.
_COS_SHARP = math.cos(math.radians(40.0))


@dataclass(frozen=True, slots=True)
class View:
    """A direction of view, without perspective."""

    OBLIQUE: ClassVar[View]
    """From the front, slightly left and far above: digits are readable and show their height."""

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

    def draw(
        self,
        bodies: Sequence[tuple[Mesh, Colour]],
        size_px: tuple[int, int],
        px_per_m: float,
        paper: Colour = PAPER,
    ) -> UInt8:
        """Draw meshes, each in a colour, in the middle of a picture of a given size; only sharp edges show.

        The projection is parallel: lengths along the picture plane keep their scale. Returns shape (H, W, 3).
        """
        counts = [len(part.faces) for part, _ in bodies]
        vertices_m, faces = join_surfaces([(part.vertices_m, part.faces) for part, _ in bodies])
        projected = self.project(vertices_m)
        width, height = (side * _SAMPLING for side in size_px)
        scale = px_per_m * _SAMPLING
        middle = (projected[:, :2].min(axis=0) + projected[:, :2].max(axis=0)) / 2
        # Rows grow downwards, and the centre of the first pixel is at column 0, row 0.
        points_px = (projected[:, :2] - middle) * (scale, -scale) + (width / 2 - 0.5, height / 2 - 0.5)
        nearest = highest_faces(
            np.stack([*points_px.T, projected[:, 2]]), faces, (height, width), both_sides=True
        )
        row, column = np.nonzero(nearest >= 0)
        face = nearest[row, column]

        levels = np.repeat(np.array([colour for _, colour in bodies], float), counts, axis=0)[face]
        normals = _corner_normals(projected, faces)[face]
        levels = _lit(levels, _normals_at(column, row, points_px[faces[face]], normals))
        pixels = np.full((height, width, 3), paper, np.uint8)
        pixels[row, column] = np.clip(np.round(levels), 0, 255)
        return _reduced(pixels)


View.OBLIQUE = View(-25.0, 42.0)


def _corner_normals(points: Float64, faces: Integers) -> Float64:
    """Return normals at the corners of triangles, (F, 3, 3): sums over triangles that meet smoothly."""
    across = _face_normals(points, faces)
    own = _unit_vectors(across)
    corners = faces.ravel()
    by_vertex = np.argsort(corners, kind="stable")
    first = np.searchsorted(corners[by_vertex], corners)
    meeting = np.bincount(corners)[corners]
    sums = np.zeros((len(corners), 3))
    for turn in range(meeting.max()):
        at = np.flatnonzero(turn < meeting)
        neighbour = by_vertex[first[at] + turn] // 3
        is_smooth = (own[at // 3] * own[neighbour]).sum(axis=1) > _COS_SHARP
        sums[at] += np.where(is_smooth[:, None], across[neighbour], 0.0)
    # Triangles that point away are lit as if they did not, so that damaged meshes are visible.
    return np.asarray(_unit_vectors(sums).reshape(-1, 3, 3) * np.where(own[:, None, 2:] < 0, -1.0, 1.0))


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
    return _unit_vectors(a + share_b * (b - a) + share_c * (c - a))


def _lit(plain: Float64, normals: Float64) -> Float64:
    """Shade colours, (n, 3), with diffuse light and highlights (Phong 1975)."""
    levels = _AMBIENT * plain
    for direction, strength in _LIGHTS:
        towards = _unit_vectors(np.array(direction))
        facing = np.maximum(arithmetic.moved(normals, towards[:, None]), 0.0)
        mirrored = np.maximum(2 * facing * normals[:, 2:] - towards[2], 0.0)
        # To the power of 12 by products, which all processors round alike.
        highlight = mirrored * mirrored * mirrored
        highlight *= highlight
        highlight *= highlight
        levels += strength * (_DIFFUSE * facing * plain + _SPECULAR * 255 * highlight)
    return levels


def relief(vertices_m: Floating, faces: Integers, px_per_m: float, *, with_opacity: bool = False) -> UInt8:
    """Draw a mesh from above in shaded relief, with smooth edges and a margin of one to two pixels.

    A mesh that would have more than 2,048 pixels is drawn smaller.

    Returns levels of uint8: shape (H, W), where 255 is empty paper, or (H, W, 2) with the opacity of each
    pixel. Row 0 is the largest y.
    """
    vertices = np.asarray(vertices_m, np.float64)
    low = vertices[:, :2].min(axis=0)
    extent_m = vertices[:, :2].max(axis=0) - low
    # A mesh in millimetres that is read in metres would have 10^10 pixels.
    scale = _SAMPLING * min(px_per_m, _MAX_RELIEF_PX / max(float(extent_m.max()), 1e-6))
    sides = np.ceil(extent_m * scale / _SAMPLING - 1e-6).astype(int) + 2 * _MARGIN_PX
    width, height = (sides * _SAMPLING).tolist()
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    columns, rows = ((vertices[:, :2] - low - extent_m / 2) * scale + middle).T
    # Rows grow with y here, so that triangles keep their orientation; the picture is flipped at the end.
    nearest = highest_faces(np.stack([columns, rows, vertices[:, 2]]), np.asarray(faces), (height, width))
    normals = _face_normals(vertices, np.asarray(faces))
    # Faces that point away are lit as if they did not, so that damaged meshes are visible.
    normals *= np.where(normals[:, 2:] < 0, -1.0, 1.0)
    light = arithmetic.moved(_unit_vectors(normals), _RELIEF_LIGHT[:, None])[:, 0]
    shades = np.append(_DARKEST + _RANGE * np.clip(light, 0, 1), 255.0).astype(np.uint8)
    drawn = nearest[::-1]
    if not with_opacity:
        return _reduced(shades[drawn])
    is_solid = drawn >= 0
    opacity = _reduced(np.where(is_solid, np.uint8(255), np.uint8(0)))
    levels = _reduced(np.where(is_solid, shades[drawn], np.uint8(0)))
    # Levels of the solid alone, so that no light rim shows on dark pages.
    levels = np.round(levels * (255.0 / np.maximum(opacity, 1))).clip(0, 255).astype(np.uint8)
    return np.stack([levels, opacity], axis=2)


def _reduced(pixels: UInt8) -> UInt8:
    """Return a picture that was drawn larger at its size; each pixel is a mean."""
    return np.asarray(Image.fromarray(pixels).reduce(_SAMPLING))


class DrawnSolid(Drawn, mesh.SolidRecord):
    """A record of a mesh that draws itself, from above by default.

    ``is_faceted`` shows sharp edges in a gallery, instead of smooth shading. ``drawn_columns`` are those that
    a picture needs. ``class_noun`` is what captions call its class.
    """

    __slots__ = ()
    is_faceted: ClassVar[bool] = False
    drawn_columns: ClassVar[tuple[str, ...]] = (mesh.VERTICES, mesh.FACES)
    class_noun: ClassVar[str] = "class"

    def caption(self, label_names: Sequence[str] = ()) -> str:
        """Return the class of the solid."""
        return f"{self.class_noun} {class_name(label_names, self.label)}"

    @property
    def notes(self) -> list[tuple[str, str]]:
        """Titles and texts about the solid, for a gallery and below its picture."""
        return [("Size", size_text(self))]

    @property
    def details(self) -> str:
        """Caption, id, notes, volume and number of triangles."""
        notes = ", ".join(f"{title.lower()} {text}" for title, text in self.notes)
        volume_mm3 = self.volume_m3 * mesh.MM_PER_M**3
        return (
            f"{self.caption()}, id {self.id}: {notes}, volume {volume_mm3:,.0f} mm³, "
            f"{len(self.faces):,} triangles"
        )

    @property
    def extent_m(self) -> float:
        """Width of what a picture shows, or height if that is larger, metres."""
        return _extent_m(self.vertices_m)

    @property
    def parts(self) -> list[tuple[int, str]]:
        """Runs of triangles and their colour, ``"main"`` or ``"other"``; empty if all are ``"main"``."""
        return []

    @property
    def legend(self) -> str:
        """Meaning of the colours of a picture, if it has any."""
        return ""

    def picture(self, width_px: float) -> UInt8:
        """Draw the solid from above in shaded relief."""
        vertices_m = self.vertices_m
        return relief(vertices_m, self.faces, width_px / _extent_m(vertices_m))

    def cutout(self, width_px: float) -> UInt8:
        """Draw the solid with opacity, (H, W, 2) or (H, W, 4); with its margin ``width_px`` long."""
        scale = (width_px - 2 * _MARGIN_PX) / self.extent_m
        return relief(self.vertices_m, self.faces, scale, with_opacity=True)

    @property
    def tile_caption(self) -> str:
        """Caption and id."""
        return f"{self.caption()}, id {self.id}"


def solid_sheet(
    solids: Sequence[DrawnSolid],
    tile_px: int,
    columns: int,
    title: str = "",
    label_names: Sequence[str] = (),
    nouns: str = "",
) -> UInt8:
    """Draw solids at one scale, the largest one ``tile_px`` wide, with their ids.

    With a title, solids with one caption are a group, and a line about the ``nouns`` and a scale bar are
    added.
    """
    extents_m = [solid.extent_m for solid in solids]
    px_per_m = tile_px / max(extents_m)
    drawn = [solid.picture(px_per_m * extent_m) for solid, extent_m in zip(solids, extents_m, strict=True)]
    if not title:
        return sheet([Tile(pixels) for pixels in drawn], columns, margin_px=8)
    tiles = [
        Tile(pixels, f"{solid.id}", group=solid.caption(label_names))
        for solid, pixels in zip(solids, drawn, strict=True)
    ]
    words = f"{with_count(len(solids), nouns)} from above, at one scale; the id of each is below it"
    if solids[0].legend:
        words = f"{words}; {solids[0].legend}"
    return sheet(tiles, columns, title, (words,), px_per_mm=px_per_m / mesh.MM_PER_M, gap_px=12)


def draw_mesh(part: Mesh, title: str) -> UInt8:
    """Draw a mesh from above, with a scale bar and its measures."""
    widest_m = float(np.ptp(part.vertices_m[:, :2], axis=0).max())
    px_per_m = _MESH_PX / max(widest_m, 1e-9)
    tile = Tile(relief(part.vertices_m, part.faces, px_per_m))
    return sheet([tile], 1, title, _mesh_facts(part), px_per_mm=px_per_m / mesh.MM_PER_M)


def _mesh_facts(part: Mesh) -> tuple[str, ...]:
    """Return the measures of a mesh as text, and the reason if it is not a solid."""
    size = size_text(part)
    parts = f"{len(part.vertices_m):,} vertices, {len(part.faces):,} triangles"
    verdict = mesh.check_manifold(part)
    if verdict.problem is not None:
        return f"{size}; {parts}", f"not a solid: {verdict.detail}"
    bodies = "one body" if verdict.bodies == 1 else f"{verdict.bodies} bodies"
    return (f"{size}; volume {verdict.volume_mm3:,.0f} mm³; {parts}; {bodies}",)


def _extent_m(vertices_m: Floating) -> float:
    return max(float(np.ptp(vertices_m[:, :2], axis=0).max()), 1e-6)


def size_text(surface: mesh.Mesh | mesh.SolidRecord) -> str:
    """Return the size of a mesh as text: ``"38.2 x 52.1 x 8.0 mm"``."""
    size_mm = np.ptp(np.asarray(surface.vertices_m, np.float64), axis=0) * mesh.MM_PER_M
    return " x ".join(f"{side:.1f}" for side in size_mm) + " mm"


def _face_normals(points: Float64, faces: Integers) -> Float64:
    """Return normals of triangles, (F, 3), with twice their areas as lengths."""
    corners = points[faces]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _unit_vectors(vectors: Float64) -> Float64:
    """Scale vectors, shape (..., 3), to length 1; vectors of length 0 stay."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(lengths > 0, lengths, 1.0))
