"""Solids to press on, made by hand."""

from __future__ import annotations

import numpy as np
import trimesh


def ball(radius_m: float = 0.008, subdivisions: int = 4) -> trimesh.Trimesh:
    """A ball that stands on z = 0."""
    made = trimesh.creation.icosphere(subdivisions, radius_m)
    made.apply_translation([0, 0, radius_m])
    return made


def block(size_m: tuple[float, float, float] = (0.02, 0.006, 0.004)) -> trimesh.Trimesh:
    """A block that stands on z = 0."""
    made = trimesh.creation.box(size_m)
    made.apply_translation([0, 0, size_m[2] / 2])
    return made


def tilted(polar_rad: float, azimuth_rad: float, x_m: float = 0.0, y_m: float = 0.0) -> np.ndarray:
    """A sensor pose that leans from the vertical."""
    lean = trimesh.transformations.rotation_matrix(
        polar_rad, [-np.sin(azimuth_rad), np.cos(azimuth_rad), 0.0]
    )
    lean[:2, 3] = x_m, y_m
    return lean
