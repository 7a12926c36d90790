"""Distances from the outline at the nodes of a lattice, with the same bits on every processor."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mnist3d.compiled_loops import blurred
from tactile_toolkit.array_types import AnyArray, Float32, Float64, Int64

F = TypeVar("F", np.float32, np.float64)

BLUR_PER_PITCH = 0.25
"""Standard deviation of the blur near the outline, in pitches."""

RIDGE_BLUR_PER_PITCH = 0.6
"""Standard deviation of the blur far inside, in pitches.

Distances grow evenly with the depth, so a blur changes only the ridge of a narrow stroke, whose height would
otherwise depend on the positions of the nodes.
"""

RIDGE_DEPTH_PER_PITCH = 1.0
"""Depth from which, and over which, the first blur passes into the second, in pitches."""

BELL_REACH = 11**0.5
"""Half width r of a bell in standard deviations: (1 - (x / r)^2)^4 has the deviation r / sqrt(11)."""

GRAIN_PX = 2.0**-12
"""Grid to which sampled distances are rounded."""

FACTOR_GRAIN_PX, _WEIGHT_GRAIN = 2.0**-16, 2.0**-24
"""Grids of distances, below 2^7 px, and of weights, below 2: their sums need at most 50 bits."""


def sampled(distance: Float32, rows: Float64, columns: Float64, pitch_px: float) -> Float32:
    """Return the distances from the outline at nodes; those near a ridge are blurred more."""
    s, ridge = (_blurred(distance, rows, columns, blur) for blur in (BLUR_PER_PITCH, RIDGE_BLUR_PER_PITCH))
    share = np.clip(s / np.float32(RIDGE_DEPTH_PER_PITCH * pitch_px) - 1, 0, 1)
    return np.asarray(s + share * (ridge - s))


def _blurred(values: Float32, rows: Float64, columns: Float64, sigma_per_pitch: float) -> Float32:
    """Return values at nodes after a blur in proportion to the distance of the nodes.

    Values and weights lie on such coarse grids that every product and sum is exact in double precision, with
    the same bits on every processor.
    """
    blur = sigma_per_pitch, BELL_REACH, _WEIGHT_GRAIN
    halfway = on_grid(blurred(values, rows, *blur), FACTOR_GRAIN_PX)
    across = blurred(np.ascontiguousarray(halfway.T), columns, *blur)
    return on_grid(across.T, GRAIN_PX).astype(np.float32)


def on_grid(values: NDArray[F], grain: float) -> NDArray[F]:
    """Round values to multiples of a power of two."""
    # Multiplication by powers of two is exact.
    return np.asarray(np.round(values * values.dtype.type(1 / grain)) * values.dtype.type(grain))


def linear(nodes: Float64, pixels: Int64) -> tuple[AnyArray, ...]:
    """Return the nodes before pixels, and the weights of these and of the next nodes."""
    before = np.searchsorted(nodes[1:-1], pixels, side="right")
    share = np.clip((pixels - nodes[before]) / (nodes[before + 1] - nodes[before]), 0, 1)
    return before, on_grid(1 - share, _WEIGHT_GRAIN), on_grid(share, _WEIGHT_GRAIN)
