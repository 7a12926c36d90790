"""Scenes seen from above."""

from __future__ import annotations

import base64
import io
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dataset_store.errors import InputError
from starstruck_gen.placement import Placement
from starstruck_gen.shapes import outline

if TYPE_CHECKING:
    from PIL.Image import Image

    from starstruck_gen.scene import Scene

__all__ = ["draw_scene", "scene_html"]

_PLATE = (245, 243, 238)
_STAR = (214, 140, 20)
_DISTRACTOR = (92, 110, 132)
_EDGE = (40, 40, 40)
_SUPERSAMPLING = 4
_MOST_PIXELS = 100_000_000


def draw_scene(scene: Scene, cell_m: tuple[float, float], px_per_mm: float) -> Image:
    """Draw a scene; see :meth:`starstruck_gen.scene.Scene.draw`.

    Raises
    ------
    InputError
        When the picture would have no pixel, or too many.
    """
    from PIL import Image

    size_px = (round(cell_m[0] * 1e3 * px_per_mm), round(cell_m[1] * 1e3 * px_per_mm))
    large_px = (size_px[0] * _SUPERSAMPLING, size_px[1] * _SUPERSAMPLING)
    if min(size_px) < 1 or large_px[0] * large_px[1] > _MOST_PIXELS:
        message = (
            f"a picture of {size_px[0]} x {size_px[1]} pixels; expected 1 to {_MOST_PIXELS // 16:,} pixels"
        )
        raise InputError(message)
    picture = Image.new("RGB", large_px, _PLATE)
    for placement in scene.placements:
        _draw_object(picture, placement, px_per_mm * 1e3 * _SUPERSAMPLING)
    return picture.resize(size_px, Image.Resampling.LANCZOS)


def _draw_object(picture: Image, placement: Placement, px_per_m: float) -> None:
    from PIL import Image, ImageDraw

    rings = [_corners_px(ring, placement, picture.size, px_per_m) for ring in outline(placement.shape)]
    # A mask keeps holes open: what stands inside one must stay visible.
    mask = Image.new("L", picture.size)
    for number, ring in enumerate(rings):
        ImageDraw.Draw(mask).polygon(ring, fill=0 if number else 255)
    picture.paste(_STAR if placement.is_star else _DISTRACTOR, mask=mask)
    for ring in rings:
        ImageDraw.Draw(picture).polygon(ring, outline=_EDGE, width=_SUPERSAMPLING)


def _corners_px(
    ring: NDArray[np.float64], placement: Placement, size_px: tuple[int, int], px_per_m: float
) -> list[tuple[float, float]]:
    corners = _standing_m(ring, placement) * px_per_m * (1.0, -1.0) + np.array(size_px) / 2
    return [(x, y) for x, y in corners.tolist()]


def _standing_m(ring: NDArray[np.float64], placement: Placement) -> NDArray[np.float64]:
    c, s = math.cos(placement.angle_rad), math.sin(placement.angle_rad)
    turned = ring @ np.array([[c, s], [-s, c]])
    return np.asarray(placement.radius_m * turned + (placement.x_m, placement.y_m))


def scene_html(scene: Scene, caption: str) -> str:
    """Show a scene in a notebook."""
    content = io.BytesIO()
    scene.draw(px_per_mm=2.0).save(content, format="PNG")
    picture = base64.b64encode(content.getvalue()).decode("ascii")
    return f'<figure><img src="data:image/png;base64,{picture}"><figcaption>{caption}</figcaption></figure>'
