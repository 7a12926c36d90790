"""Pictures for tests, like those of users: handwriting, a coloured drawing, and photographs of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFilter
from scipy import ndimage

from mnist3d.digit_options import SolidSize
from mnist3d.solid.picture_ink import SizedInk, sized_ink
from tactile_toolkit.mesh import Mesh

PEN = (15, 15, 40)
SUN, WALL, GRASS = (255, 165, 0), (255, 235, 150), (60, 170, 60)


def word(width: int = 22) -> Image.Image:
    """Return handwriting of five pieces: an l, two i with their dots."""
    picture = Image.new("RGB", (800, 400), "white")
    draw = ImageDraw.Draw(picture)
    for x, top in ((200, 80), (350, 180), (500, 180)):
        draw.line([(x, top), (x, 320)], fill=PEN, width=width)
    for x in (350, 500):
        draw.ellipse([x - width / 2, 120 - width / 2, x + width / 2, 120 + width / 2], fill=PEN)
    return picture


def child() -> Image.Image:
    """Return a house with an outline and pale walls, an orange sun, and grass: three filled pieces."""
    picture = Image.new("RGB", (800, 600), "white")
    draw = ImageDraw.Draw(picture)
    draw.ellipse([560, 60, 700, 200], fill=SUN)
    draw.rectangle([120, 250, 380, 480], fill=WALL, outline=(0, 0, 0), width=8)
    draw.rectangle([60, 520, 740, 550], fill=GRASS)
    return picture


def house() -> Image.Image:
    """Return a house with a thick roof, thin windows and a sun with rays: parts of strokes of 4 to 26 px."""
    picture = Image.new("RGB", (1200, 900), "white")
    draw = ImageDraw.Draw(picture)
    draw.polygon([(300, 450), (550, 220), (800, 450)], outline=PEN, width=16)
    draw.rectangle([330, 470, 770, 780], outline=PEN, width=9)
    for x in (400, 640):
        draw.rectangle([x, 540, x + 70, 610], outline=PEN, width=4)
    draw.ellipse([950, 80, 1100, 230], outline=SUN, width=26)
    draw.line([(1025, 270), (1025, 330)], fill=SUN, width=9)
    return picture


def photographed(
    picture: Image.Image, paper: tuple[float, ...] = (0.93, 0.89, 0.82), finger: float = 0
) -> Image.Image:
    """Return a page as photographed by a phone: uneven warm light, the shadow of a finger, noise, blur."""
    page = np.asarray(picture.resize((900, 675)), float)
    rows, columns = np.mgrid[:675, :900]
    light = 0.5 + 0.5 * (0.7 * columns / 900 + 0.3 * rows / 675)
    covered = (abs(columns - 450) < 30) & (rows > 300)
    light *= 1 - finger * ndimage.gaussian_filter(covered.astype(float), 10.0)
    shot = page * light[..., None] * np.array(paper)
    shot += np.random.default_rng(0).normal(0, 3, page.shape)
    blurred = Image.fromarray(np.clip(shot, 0, 255).astype(np.uint8))
    return blurred.filter(ImageFilter.GaussianBlur(1))


def inked(picture: Any, **options: Any) -> SizedInk:
    size = SolidSize(**{name: options.pop(name) for name in list(options) if name.endswith("_mm")})
    return sized_ink(picture, None, size, **options)


def pieces(mask: np.ndarray) -> int:
    return int(ndimage.label(mask, np.ones((3, 3)))[1])


def size_mm(mesh: Mesh) -> np.ndarray:
    return np.ptp(mesh.vertices_m, axis=0) * 1000
