"""Pictures of scenes from above."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from PIL import Image, ImageDraw

from starstruck_gen.placement import Placement
from starstruck_gen.shapes import outline
from tactile_toolkit.arithmetic import cosine_sine, moved
from tactile_toolkit.array_types import UInt8
from tactile_toolkit.errors import InputError

STAR_COLOUR = (214, 140, 20)
DISTRACTOR_COLOUR = (92, 110, 132)
# Factor by which scenes are drawn larger, then reduced, for smooth edges.
_SUPERSAMPLING = 4
_PLATE = (245, 243, 238)
_EDGE = (40, 40, 40)
_OPAQUE_FROM = 150  # each object is at least this many levels darker than the plate
# Largest enlarged drawing: 300 MB at three bytes for each pixel.
_MAX_PIXELS = 100_000_000


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
    for ring in outline(placement.shape):
        turned = moved(ring, np.array([[c, s], [-s, c]]))
        standing_m = placement.radius_m * turned + (placement.x_m, placement.y_m)
        rings.append(standing_m * px_per_m * (1.0, -1.0) + np.array(picture.size) / 2)
    # A mask of the size of the object keeps its holes open, so that objects inside them stay visible.
    low, high = (
        np.clip((rings[0].min(axis=0), rings[0].max(axis=0) + 2), 0, picture.size).astype(int).tolist()
    )
    mask, fill = Image.new("L", (high[0] - low[0], high[1] - low[1])), 255
    for edge_px in rings:
        ImageDraw.Draw(mask).polygon((edge_px - low).ravel().tolist(), fill=fill)
        fill = 0  # rings after the first are holes
    colour = STAR_COLOUR if placement.is_star else DISTRACTOR_COLOUR
    picture.paste(colour, (*low, *high), mask)
    for edge_px in rings:
        ImageDraw.Draw(picture).polygon(edge_px.ravel().tolist(), outline=_EDGE, width=_SUPERSAMPLING)
