"""Scenes seen from above, drawn from what stands where."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from starstruck_gen.placement import Placement
from starstruck_gen.shapes import outline
from tactile_toolkit.arithmetic import cosine_sine, moved
from tactile_toolkit.errors import InputError

if TYPE_CHECKING:
    from PIL.Image import Image


STAR = (214, 140, 20)
DISTRACTOR = (92, 110, 132)
SUPERSAMPLING = 4
"""Scenes are drawn so many times larger and averaged: smooth edges."""

_PLATE = (245, 243, 238)
_EDGE = (40, 40, 40)
# 300 MB at three bytes each.
_MOST_PIXELS = 100_000_000  # while drawing, so larger than the picture by SUPERSAMPLING**2


def draw_scene(placements: Iterable[Placement], cell_m: tuple[float, float], px_per_mm: float) -> Image:
    """Draw what stands on a plate; InputError where the picture would have no pixel, or too many.

    See :meth:`starstruck_gen.scene.Scene.draw`.
    """
    picture = empty_plate(cell_m, px_per_mm)
    for placement in placements:
        paint_object(picture, placement, px_per_mm * 1e3 * SUPERSAMPLING)
    return reduced(picture)


def empty_plate(cell_m: tuple[float, float], px_per_mm: float) -> Image:
    """Return the plate, larger by SUPERSAMPLING; InputError as :func:`draw_scene`."""
    from PIL import Image

    sides = np.round(np.array(cell_m) * 1e3 * px_per_mm)
    most = _MOST_PIXELS // SUPERSAMPLING**2
    if not (np.isfinite(sides).all() and sides.min() >= 1 and sides.prod() <= most):
        raise InputError(f"a picture of {sides[0]:g} x {sides[1]:g} pixels; expected 1 to {most:,} pixels")
    width, height = sides.astype(int).tolist()
    return Image.new("RGB", (width * SUPERSAMPLING, height * SUPERSAMPLING), _PLATE)


def reduced(picture: Image) -> Image:
    """Return a picture that was drawn larger in its own size."""
    from PIL import Image

    size_px = (picture.width // SUPERSAMPLING, picture.height // SUPERSAMPLING)
    return picture.resize(size_px, Image.Resampling.LANCZOS)


def paint_object(picture: Image, placement: Placement, px_per_m: float) -> None:
    """Paint an object where it stands, with its edge; ``px_per_m`` is the scale of the larger picture."""
    from PIL import Image, ImageDraw

    rings = [corners_px(ring, placement, picture.size, px_per_m) for ring in outline(placement.shape)]
    # A mask keeps holes open: what stands inside one must stay visible.
    mask = Image.new("L", picture.size)
    for number, ring in enumerate(rings):
        ImageDraw.Draw(mask).polygon(ring, fill=0 if number else 255)
    picture.paste(STAR if placement.is_star else DISTRACTOR, mask=mask)
    for ring in rings:
        ImageDraw.Draw(picture).polygon(ring, outline=_EDGE, width=SUPERSAMPLING)


def centre_px(placement: Placement, size_px: tuple[int, int], px_per_m: float) -> tuple[float, float]:
    """Return where the centre of an object lies in a picture: column and row, 0 at the outer edge."""
    return size_px[0] / 2 + placement.x_m * px_per_m, size_px[1] / 2 - placement.y_m * px_per_m


def corners_px(
    ring: NDArray[np.float64], placement: Placement, size_px: tuple[int, int], px_per_m: float
) -> list[tuple[float, float]]:
    """Return where the corners of an outline, (n, 2) in radii, lie in a picture."""
    c, s = cosine_sine(placement.angle_rad)
    turned = moved(ring, np.array([[c, s], [-s, c]]))
    standing_m = placement.radius_m * turned + (placement.x_m, placement.y_m)
    return [(x, y) for x, y in (standing_m * px_per_m * (1.0, -1.0) + np.array(size_px) / 2).tolist()]
