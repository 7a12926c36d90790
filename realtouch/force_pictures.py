"""Pictures of contact: pressure as colours, and the motion of markers as arrows."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw

from realtouch.touches.rounds import Touch
from tactile_toolkit.touch import resized
from tactile_toolkit.value_types import AnyArray, Float64, UInt8

ARROWS = 5
"""Length of arrows relative to the motion of markers, which is a few pixels at most."""

_MIN_PX = 160
_BRIGHTEST = 98
_PAPER = (250, 250, 248)
_INK = (30, 60, 110)
# From no pressure to the greatest of the picture.
_COLOURS = np.array(
    [(14, 12, 44), (110, 26, 110), (222, 73, 62), (252, 165, 40), (252, 250, 190)], np.float64
)
_HEAD = 0.35
_HALF_HEAD_RAD = 0.45  # of an arrow


def force_views(touch: Touch) -> list[UInt8]:
    """Return the picture of a touch, and pictures of its pressure and its moving markers, if it has them.

    They have one size. Maps of another size than the image, as after `realtouch resize`, are left out.
    """
    image = touch.image
    extra = touch.extra
    height, width = image.shape[:2]
    views = []
    if "pressure_kpa" in extra and np.size(extra["pressure_kpa"]) == height * width:
        views.append(pressure_picture(np.reshape(extra["pressure_kpa"], (height, width))))
    if {"marker_positions_px", "marker_flow_px"} <= set(extra):
        positions, flow = (np.reshape(extra[f"marker_{name}_px"], (-1, 2)) for name in ("positions", "flow"))
        views.append(flow_picture(positions - flow, flow, (width, height)))
    if not views:
        return [image]
    scale = max(1, -(-_MIN_PX // width))
    shape = (width * scale, height * scale)
    return [resized(view, *shape) for view in (image, *views)]


def pressure_picture(pressure: AnyArray) -> UInt8:
    """Return a map of pressure (H, W), of any unit, as colours (H, W, 3).

    The brightest colour begins at the 98th percentile of the contact, as single pixels at edges have far more
    pressure.
    """
    known = np.nan_to_num(np.asarray(pressure, np.float64))
    most = 1.0
    if (known > 0).any():
        most = float(np.percentile(known[known > 0], _BRIGHTEST))
    positions = np.clip(known / most, 0, 1) * (len(_COLOURS) - 1)
    first = np.minimum(positions.astype(np.int64), len(_COLOURS) - 2)
    part = (positions - first)[..., None]
    mixed = _COLOURS[first] * (1 - part) + _COLOURS[first + 1] * part
    return np.asarray(np.rint(mixed), np.uint8)


def flow_picture(rest_px: AnyArray, flow_px: AnyArray, size_px: tuple[int, int]) -> UInt8:
    """Return arrows from markers at rest (n, 2), :data:`ARROWS` times as long as their motion (n, 2), pixels.

    The picture (H, W, 3) shows an image of ``size_px``, width and height, and has at least 160 columns.
    """
    scale = max(1, -(-_MIN_PX // size_px[0]))
    canvas = Image.new("RGB", (size_px[0] * scale, size_px[1] * scale), _PAPER)
    draw = ImageDraw.Draw(canvas)
    for (x, y), (dx, dy) in zip(rest_px.tolist(), flow_px.tolist(), strict=True):
        begin = np.array([(x + 0.5) * scale, (y + 0.5) * scale])
        arrow = np.array([dx, dy]) * scale * ARROWS
        if np.isfinite([*begin, *arrow]).all():
            _draw_arrow(draw, begin, arrow)
    return np.asarray(canvas)


def _draw_arrow(draw: ImageDraw.ImageDraw, begin: Float64, arrow: Float64) -> None:
    end = begin + arrow
    draw.ellipse([*(begin - 1), *(begin + 1)], fill=_INK)
    draw.line([*begin, *end], fill=_INK, width=1)
    cosine = np.cos(_HALF_HEAD_RAD)
    sine = np.sin(_HALF_HEAD_RAD)
    for side in (-sine, sine):
        turned = np.array([cosine * arrow[0] - side * arrow[1], side * arrow[0] + cosine * arrow[1]])
        draw.line([*end, *(end - _HEAD * turned)], fill=_INK, width=1)
