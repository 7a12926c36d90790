"""Drawings in closed form, and sizes of the solids that are made of them."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from scipy import ndimage

from mnist3d.compiled_loops import signed_distance_px
from tactile_toolkit.mesh import Mesh
from tests.real_input import SHARED

DIGITS = SHARED / "digits" / "png"
ROWS, COLUMNS = np.mgrid[:500, :500]


def drawn(mask: np.ndarray) -> np.ndarray:
    return np.where(mask, 20, 250).astype(np.uint8)


def disc(radius: float, row: float = 249.5, column: float = 249.5) -> np.ndarray:
    return np.hypot(ROWS - row, COLUMNS - column) <= radius


def ring() -> np.ndarray:
    return drawn(disc(90) & ~disc(60))


def stroke(points: list[tuple[float, float]], width: float) -> np.ndarray:
    """Return a line of a round pen through (row, column) points."""
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


def dumbbell(neck_mm: float, angle_deg: float) -> np.ndarray:
    """Return two discs 4 mm in radius, 6 mm apart, joined by a bar of a width; 0.2 mm per pixel."""
    y, x = (np.mgrid[:640, :640] - 319.5) * 0.05
    angle = math.radians(angle_deg)
    along, aside = (
        np.abs(x * math.cos(angle) - y * math.sin(angle)),
        x * math.sin(angle) + y * math.cos(angle),
    )
    ink = (np.hypot(along - 7, aside) <= 4) | ((np.abs(aside) <= neck_mm / 2) & (along <= 7))
    return (255 * (1 - ink.reshape(160, 4, 160, 4).mean(axis=(1, 3)))).round().astype(np.uint8)


def neck_mm(mesh: Mesh, angle_deg: float) -> float:
    """Width of a dumbbell in the mid-plane where it is narrowest."""
    angle = math.radians(angle_deg)
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    contours = mesh.to_manifold().slice(float(mesh.vertices_m[:, 2].max()) * 500).to_polygons()
    widths = []
    for place in np.linspace(-2, 2, 41):
        crossings: list[float] = []
        for points in (np.asarray(contour) @ turn.T for contour in contours):
            after = np.roll(points, -1, axis=0)
            cut = (points[:, 0] > place) != (after[:, 0] > place)
            share = (place - points[cut, 0]) / (after - points)[cut, 0]
            crossings += (points[cut, 1] + share * (after - points)[cut, 1]).tolist()
        widths.append(max(crossings) - min(crossings))
    return min(widths)


def spiral(width_px: float, gap_px: float, turns: float) -> np.ndarray:
    """A page with one long stroke of round pen, wound up."""
    angles = np.linspace(math.pi, 2 * math.pi * turns, 100_000)
    radii = (width_px + gap_px) * angles / (2 * math.pi)
    mask = np.zeros((500, 500), bool)
    places = 250 + radii * np.stack([np.sin(angles), np.cos(angles)])
    mask[tuple(np.round(places[:, radii < 235]).astype(int))] = True
    return drawn(ndimage.distance_transform_edt(~mask) <= width_px / 2)
