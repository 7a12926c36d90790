"""Drawings in closed form, and sizes of what is made of them."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from scipy import ndimage

from mnist3d.lattice import signed_distance_px
from tactile_toolkit.mesh.mesh import Mesh
from tests.real_input import SHARED

DIGITS = SHARED / "digits" / "png"
ROWS, COLUMNS = np.mgrid[:500, :500]


def drawn(mask: np.ndarray) -> np.ndarray:
    return np.where(mask, 20, 250).astype(np.uint8)


def disc(radius: float, row: float = 249.5, column: float = 249.5) -> np.ndarray:
    return np.hypot(ROWS - row, COLUMNS - column) <= radius


def stroke(points: list[tuple[float, float]], width: float) -> np.ndarray:
    """A line of round pen through (row, column) points."""
    path = np.concatenate([np.linspace(a, b, 60) for a, b in pairwise(points)])
    mask = np.zeros((500, 500), bool)
    mask[tuple(np.round(path).astype(int).T)] = True
    return ndimage.distance_transform_edt(~mask) <= width / 2


def seven(width: float = 30) -> np.ndarray:
    rough = ndimage.gaussian_filter(np.random.default_rng(7).normal(size=(500, 500)), 2)
    mask = stroke([(120, 150), (120, 330), (380, 220)], width)
    edge = signed_distance_px(mask, 3, 3) + 8 * rough
    return drawn((edge > 0) & (ndimage.distance_transform_edt(~mask) < 3))


def six(width: float = 34) -> np.ndarray:
    way = np.linspace(0, 2 * np.pi, 30)
    loop = [(320 + 60 * math.sin(t), 240 + 60 * math.cos(t)) for t in way]
    return drawn(stroke(loop, width) | stroke([(110, 280), (220, 190), (320, 180)], width))


def volume_mm3(mesh: Mesh) -> float:
    return mesh.volume_m3 * 1e9


def size_mm(mesh: Mesh) -> np.ndarray:
    return np.ptp(mesh.bounds_m, axis=0) * 1000
