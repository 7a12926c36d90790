"""One object: in shaded relief from above, and in oblique view, at one scale."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.mesh.mesh import MM_PER_M
from tactile_toolkit.mesh.solid_check import judge
from tactile_toolkit.pictures.relief import relief_of
from tactile_toolkit.pictures.render import TOP, Body, Picture3d, Studio, fitting_scale
from tactile_toolkit.pictures.sheets import Sheet, Tile, sheet, with_scale_bar
from tactile_toolkit.pictures.writing import Drawing

if TYPE_CHECKING:
    from tactile_toolkit.mesh.mesh import Mesh

__all__ = ["CLAY", "draw_object", "object_facts"]

CLAY = (224, 166, 72)
"""Colour of objects in oblique views."""

_PANEL_PX = (560, 520)
_FILLED = 0.9


def draw_object(studio: Studio, mesh: Mesh, title: str) -> Drawing:
    """Draw a mesh from above and obliquely, with scale bars and its measures.

    Parameters
    ----------
    studio : Studio
        Where the oblique view is made.
    mesh : Mesh
        Metres.
    title : str
        Heading.
    """
    bodies = (Body(mesh, CLAY),)
    inner_px = (round(_PANEL_PX[0] * _FILLED), round(_PANEL_PX[1] * _FILLED))
    px_per_m = min(fitting_scale(bodies, inner_px, TOP), fitting_scale(bodies, inner_px))
    px_per_mm = px_per_m / MM_PER_M
    above = with_scale_bar(_in_the_middle(relief_of(mesh, px_per_mm), _PANEL_PX), px_per_mm)
    view, notes = studio.draw(Picture3d(bodies, _PANEL_PX, px_per_m))
    tiles = (
        Tile(above, "shaded relief, from above"),
        Tile(with_scale_bar(view, px_per_mm), "oblique view; the bar holds along the picture plane"),
    )
    return Drawing(sheet(tiles, Sheet(2, title, object_facts(mesh))), notes)


def object_facts(mesh: Mesh) -> tuple[str, ...]:
    """Return the measures of a mesh in words, and what keeps it from being a solid."""
    x_mm, y_mm, z_mm = (np.ptp(mesh.vertices_m, axis=0) * MM_PER_M).tolist()
    size = f"{x_mm:.1f} x {y_mm:.1f} x {z_mm:.1f} mm"
    parts = f"{len(mesh.vertices_m):,} vertices, {len(mesh.faces):,} triangles"
    found = judge(mesh)
    if found.problem is not None:
        return f"{size}; {parts}", f"no solid: {found.detail}"
    bodies = "one body" if found.bodies == 1 else f"{found.bodies} bodies"
    return (f"{size}; volume {found.volume_mm3:,.0f} mm³; {parts}; {bodies}",)


def _in_the_middle(pixels: NDArray[np.uint8], size_px: tuple[int, int]) -> NDArray[np.uint8]:
    """Return a picture in the middle of paper of some size."""
    canvas = np.full((size_px[1], size_px[0]), 255, np.uint8)
    height, width = pixels.shape
    top, left = (canvas.shape[0] - height) // 2, (canvas.shape[1] - width) // 2
    canvas[top : top + height, left : left + width] = pixels
    return canvas
