"""Smoothing of a surface without shrinking it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mnist3d.compiled_loops import smoothed
from mnist3d.solid.surface import Surface

TAUBIN_RATIO = -1.06
"""Ratio of the outward to the inward step that keeps the volume (Taubin 1995: slightly above one)."""


def smooth(surface: Surface, iterations: int, factor: float) -> Surface:
    """Smooth a surface without shrinking it (Taubin 1995).

    Each round moves vertices by ``factor`` of the way to the mean of their neighbours, and then back by a
    slightly longer step. The rim stays in the mid-plane, so an upper half moves as it would in the whole.
    """
    rim = surface.rim
    flat = np.bincount(rim, minlength=len(surface.vertices_px))
    shares = np.array([factor, factor * TAUBIN_RATIO] * iterations, np.float32)
    vertices = smoothed(surface.vertices_px.copy(), surface.faces, flat, shares)
    # A wall that folds is not a solid, so thin parts are not smoothed.
    vertices[surface.still] = surface.vertices_px[surface.still]
    vertices[:, 2] = np.maximum(vertices[:, 2], np.float32(surface.least_px))
    vertices[rim, 2] = 0
    return replace(surface, vertices_px=vertices)
