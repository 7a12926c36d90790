"""Smoothing of a surface without shrinking it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mnist3d.compiled_loops import smoothed
from mnist3d.solid.surface import Surface

TAUBIN_RATIO = -1.06
"""Step outward over step inward that lets smoothing keep the volume (Taubin 1995: slightly above one)."""


def smooth(surface: Surface, iterations: int, factor: float) -> Surface:
    """Even out a surface without shrinking it (Taubin 1995).

    Each round is a step of ``factor`` of the way to the middle of the neighbours and a slightly longer one
    back. As its rim stays in the mid-plane, the upper half moves exactly as it would within the whole.
    """
    rim = surface.rim
    flat = np.bincount(rim, minlength=len(surface.vertices_px))
    shares = np.array([factor, factor * TAUBIN_RATIO] * iterations, np.float32)
    vertices = smoothed(surface.vertices_px.copy(), surface.faces, flat, shares)
    # Volume and topology come before smoothness there: a wall that folds is not a solid.
    vertices[surface.still] = surface.vertices_px[surface.still]
    vertices[:, 2] = np.maximum(vertices[:, 2], np.float32(surface.least_px))
    vertices[rim, 2] = 0
    return replace(surface, vertices_px=vertices)
