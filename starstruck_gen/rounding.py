"""Whether stored coordinates are fine enough for the smallest triangles of the shapes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from starstruck_gen.solid import prism
from tactile_toolkit.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from starstruck_gen.shapes import Shape

__all__ = ["require_fine_steps"]


def require_fine_steps(
    shapes: Sequence[Shape], half_area_m: tuple[float, float], cell_m: tuple[float, float]
) -> None:
    """Refuse shapes so small, in a cell so large, that float32 coordinates could turn a triangle over.

    Three corners that move by up to e each stay in their order while the triangle is thicker than 2 e.

    Raises
    ------
    InputError
        Names the shape, its radius and the cell.
    """
    for shape in shapes:
        thinnest_m = prism(shape.key).thinnest * shape.radius_m
        moved_m = _farthest_moved_m(half_area_m, shape)
        if thinnest_m <= 2 * moved_m:
            message = (
                f"cell_m of the scene specification is {cell_m!r}; expected a smaller one with shape "
                f"{shape.key!r} of radius_m {shape.radius_m!r}: its thinnest triangle is {thinnest_m:.2g} m, "
                f"and storing coordinates as float32 moves corners by up to {moved_m:.2g} m there; next: "
                "lower cell_m (--cell-mm) or the corners of the shape (segments, points), or raise radius_m "
                "(--radius-mm)"
            )
            raise InputError(message)


def _farthest_moved_m(half_area_m: tuple[float, float], shape: Shape) -> float:
    """Return how far rounding can move a corner: half a step along x and half a step along y."""
    farthest_m = np.array(half_area_m) + shape.radius_m
    return math.hypot(*np.spacing(farthest_m.astype(np.float32)).tolist()) / 2
