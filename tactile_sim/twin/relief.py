"""Reliefs of solids: height maps on a grid, from which any touch is sampled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tactile_sim.press_kernels import rasterise
from tactile_sim.pressable import Pressable
from tactile_toolkit.array_types import Float32, Float64
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import MeshLike

_PITCH_M = 5e-5  # the pixel of a GelSight Mini has 59 micrometres
_MAX_POINTS = 1 << 24
_MARGIN_M = 2e-4  # of plate around the solid


@dataclass(frozen=True, eq=False)
class Relief:
    """Heights above the plate, metres, shape (rows, columns), first row at the least y.

    ``corner`` is x and y of the first point and the distances of points along x and y, metres.
    """

    heights_m: Float32
    corner: Float64

    @classmethod
    def of(cls, solid: MeshLike | Pressable) -> Relief:
        """Return the relief of a solid that stands on the plate; InputError if it is open or too large."""
        prepared = Pressable.of(solid)
        low = prepared.vertices_m[:, :2].min(axis=0) - _MARGIN_M
        sides = np.ptp(prepared.vertices_m[:, :2], axis=0) + 2 * _MARGIN_M
        columns, rows = np.ceil(sides / _PITCH_M).astype(np.int64) + 1
        if columns * rows > _MAX_POINTS:
            raise InputError(
                f"a solid of {1e3 * sides[0]:.4g} x {1e3 * sides[1]:.4g} mm is too large to be touched; "
                "expected metres",
                next="check the unit of the mesh",
            )
        out = np.zeros((rows, columns))
        affine = np.zeros((3, 4))
        affine[0, 0] = affine[1, 1] = 1 / _PITCH_M
        affine[:2, 3] = -low / _PITCH_M
        affine[2, 2:] = 1.0, -prepared.foot_m
        rasterise(out, prepared.vertices_m, prepared.faces, prepared.blocks_m, affine, None)
        corner = np.array([low[0], low[1], _PITCH_M, _PITCH_M])
        return cls(np.ascontiguousarray(out[::-1], np.float32), corner)

    @property
    def top_m(self) -> float:
        """Greatest height, metres."""
        return float(self.heights_m.max())
