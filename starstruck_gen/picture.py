"""Scenes seen from above."""

from __future__ import annotations

import base64
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from starstruck_gen.placement import Placement, Rejected
from starstruck_gen.shapes import outline
from tactile_toolkit.errors import InputError
from tactile_toolkit.pictures.writing import png_bytes

if TYPE_CHECKING:
    from collections.abc import Iterable

    from PIL.Image import Image

    from starstruck_gen.spec import SceneSpec

__all__ = ["DISTRACTOR", "REJECTED", "STAR", "centre_px", "draw_scene", "draw_trace", "scene_html"]

_PLATE = (245, 243, 238)
STAR = (214, 140, 20)
DISTRACTOR = (92, 110, 132)
_EDGE = (40, 40, 40)
_AREA = (150, 156, 164)
REJECTED = (213, 94, 0)
_SUPERSAMPLING = 4
_DASH = 6.0 * _SUPERSAMPLING
_CROSS = 4.0 * _SUPERSAMPLING
_MOST_PIXELS = 100_000_000


def draw_scene(placements: Iterable[Placement], cell_m: tuple[float, float], px_per_mm: float) -> Image:
    """Draw the objects of a scene; see :meth:`starstruck_gen.scene.Scene.draw`.

    Raises
    ------
    InputError
        When the picture would have no pixel, or too many.
    """
    picture = _plate(cell_m, px_per_mm)
    for placement in placements:
        _draw_object(picture, placement, px_per_mm * 1e3 * _SUPERSAMPLING)
    return _reduced(picture)


def draw_trace(
    placements: Iterable[Placement], rejected: Iterable[Rejected], spec: SceneSpec, px_per_mm: float
) -> Image:
    """Draw a scene with the room that collision takes around each object, and the positions not taken.

    Objects that were not placed are outlined in red where they would have stood, with a cross at their
    centre; those of layouts that were given up have a grey cross only. The dashed frame holds all centres.

    Parameters
    ----------
    placements : iterable of Placement
        What stands in the scene.
    rejected : iterable of Rejected
        Positions not taken.
    spec : SceneSpec
        How it was made.
    px_per_mm : float
        Scale of the picture.

    Raises
    ------
    InputError
        As :func:`draw_scene`.
    """
    picture = _plate(spec.cell_m, px_per_mm)
    scale = px_per_mm * 1e3 * _SUPERSAMPLING
    _draw_area(picture, spec, scale)
    for placement in placements:
        _draw_object(picture, placement, scale)
        if spec.collision == "circles":
            _draw_circle(picture, placement, spec.clearance_m, scale)
    for lost in sorted(rejected, key=lambda each: not each.given_up):
        _draw_rejected(picture, lost.candidate, lost.given_up, scale)
    return _reduced(picture)


def _plate(cell_m: tuple[float, float], px_per_mm: float) -> Image:
    from PIL import Image

    sides = (cell_m[0] * 1e3 * px_per_mm, cell_m[1] * 1e3 * px_per_mm)
    if not all(map(math.isfinite, sides)):
        message = (
            f"a picture of a cell of {cell_m!r} m with {px_per_mm!r} pixels per mm; expected finite numbers"
        )
        raise InputError(message)
    size_px = (round(sides[0]), round(sides[1]))
    large_px = (size_px[0] * _SUPERSAMPLING, size_px[1] * _SUPERSAMPLING)
    if min(size_px) < 1 or large_px[0] * large_px[1] > _MOST_PIXELS:
        message = (
            f"a picture of {size_px[0]} x {size_px[1]} pixels; expected 1 to {_MOST_PIXELS // 16:,} pixels"
        )
        raise InputError(message)
    return Image.new("RGB", large_px, _PLATE)


def _reduced(picture: Image) -> Image:
    from PIL import Image

    size_px = (picture.width // _SUPERSAMPLING, picture.height // _SUPERSAMPLING)
    return picture.resize(size_px, Image.Resampling.LANCZOS)


def _draw_object(picture: Image, placement: Placement, px_per_m: float) -> None:
    from PIL import Image, ImageDraw

    rings = [_corners_px(ring, placement, picture.size, px_per_m) for ring in outline(placement.shape)]
    # A mask keeps holes open: what stands inside one must stay visible.
    mask = Image.new("L", picture.size)
    for number, ring in enumerate(rings):
        ImageDraw.Draw(mask).polygon(ring, fill=0 if number else 255)
    picture.paste(STAR if placement.is_star else DISTRACTOR, mask=mask)
    for ring in rings:
        ImageDraw.Draw(picture).polygon(ring, outline=_EDGE, width=_SUPERSAMPLING)


def _draw_area(picture: Image, spec: SceneSpec, px_per_m: float) -> None:
    from PIL import ImageDraw

    half_x, half_y = (side * px_per_m for side in spec.half_area_m)
    x, y = picture.width / 2, picture.height / 2
    corners = [
        (x - half_x, y - half_y),
        (x + half_x, y - half_y),
        (x + half_x, y + half_y),
        (x - half_x, y + half_y),
    ]
    pen = ImageDraw.Draw(picture)
    for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
        length = math.dist(start, end)
        for begin in np.arange(0.0, length, 2 * _DASH).tolist():
            share, stop = begin / length, min(begin + _DASH, length) / length
            line = [(a + part * (b - a)) for part in (share, stop) for a, b in zip(start, end, strict=True)]
            pen.line(line, fill=_AREA, width=_SUPERSAMPLING)


def _draw_circle(picture: Image, placement: Placement, clearance_m: float, px_per_m: float) -> None:
    from PIL import ImageDraw

    x, y = centre_px(placement, picture.size, px_per_m)
    radius = (placement.radius_m + clearance_m / 2) * px_per_m
    box = (x - radius, y - radius, x + radius, y + radius)
    ImageDraw.Draw(picture).ellipse(box, outline=_AREA, width=_SUPERSAMPLING)


def _draw_rejected(picture: Image, placement: Placement, given_up: bool, px_per_m: float) -> None:
    from PIL import ImageDraw

    pen = ImageDraw.Draw(picture)
    colour = _AREA if given_up else REJECTED
    if not given_up:
        for ring in outline(placement.shape):
            corners = _corners_px(ring, placement, picture.size, px_per_m)
            pen.line([*corners, corners[0]], fill=colour, width=_SUPERSAMPLING)
    x, y = centre_px(placement, picture.size, px_per_m)
    for slope in (1, -1):
        line = (x - _CROSS, y - slope * _CROSS, x + _CROSS, y + slope * _CROSS)
        pen.line(line, fill=colour, width=2 * _SUPERSAMPLING)


def centre_px(placement: Placement, size_px: tuple[int, int], px_per_m: float) -> tuple[float, float]:
    """Return where the centre of an object lies in a picture: column and row, 0 at the outer edge."""
    return size_px[0] / 2 + placement.x_m * px_per_m, size_px[1] / 2 - placement.y_m * px_per_m


def _corners_px(
    ring: NDArray[np.float64], placement: Placement, size_px: tuple[int, int], px_per_m: float
) -> list[tuple[float, float]]:
    corners = _standing_m(ring, placement) * px_per_m * (1.0, -1.0) + np.array(size_px) / 2
    return [(x, y) for x, y in corners.tolist()]


def _standing_m(ring: NDArray[np.float64], placement: Placement) -> NDArray[np.float64]:
    c, s = math.cos(placement.angle_rad), math.sin(placement.angle_rad)
    turned = ring @ np.array([[c, s], [-s, c]])
    return np.asarray(placement.radius_m * turned + (placement.x_m, placement.y_m))


def scene_html(placements: Iterable[Placement], caption: str) -> str:
    """Show a scene in a notebook."""
    content = png_bytes(np.asarray(draw_scene(placements, (0.12, 0.12), px_per_mm=2.0)))
    picture = base64.b64encode(content).decode("ascii")
    return f'<figure><img src="data:image/png;base64,{picture}"><figcaption>{caption}</figcaption></figure>'
