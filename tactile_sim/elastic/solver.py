"""Solution of a contact by projected gradients: pressure and traction in turn, on transforms of SciPy.

Fields are of single precision and have a border of one pixel, which is not loaded; their rows are counted
from the least y. Rows of displacements are longer, as those of the transforms.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.fft import fft, ifft, irfft, rfft

from tactile_sim.elastic import steps
from tactile_sim.elastic.layer import Complex64, Layer
from tactile_toolkit.array_types import Bool, Float32, Float64

_PRESS_TOLERANCE = 7e-4  # largest error of the gap, relative to the depth
_SHEAR_TOLERANCE = 1e-4  # root mean square of the error along the surface, relative to the largest motion
_MAX_PASSES = 8  # of pressure and shear, each with the displacement that the other one makes
_FIRST_PASS = 30.0  # factor of the tolerances in the first pass, which only starts the others
_MAX_STEPS = 300
_FAR_M = 1e6


class Solution(NamedTuple):
    """A solved contact.

    Attributes
    ----------
    fields : ndarray of float64, shape (6, R, C)
        Pressure, traction along x and y, Pa; displacement along x, y and z, metres; row 0 at the greatest y.
    is_contact, is_stick : ndarray of bool, shape (R, C)
        Where the body touches the gel, and where it sticks.
    depth_m : float
        How far the highest point is pressed in.
    error : float
        Largest error of the gap, relative to the depth.
    iterations : int
        Steps, all together.
    """

    fields: Float64
    is_contact: Bool
    is_stick: Bool
    depth_m: float
    error: float
    iterations: int


def solve(
    below_m: Float64,
    pixel_m: tuple[float, float],
    target: float,
    is_force: bool,
    friction: float,
    motion: tuple[float, float, float],
    layer: Layer,
    start: float,
) -> Solution:
    """Press a body in, then move it along x and y and turn it; see :func:`tactile_sim.solve_contact`.

    Parameters
    ----------
    below_m : ndarray of float64, shape (R, C)
        How far the body is below its highest point, metres, row 0 at the greatest y.
    pixel_m : tuple of float
        Width and height of a pixel, metres.
    target : float
        Sum of the pressures, Pa, if ``is_force``; else the depth, metres.
    is_force : bool
        What the target is.
    friction : float
        Coefficient of friction.
    motion : tuple of float
        Slide along x and y, metres, and twist, radians.
    layer : Layer
        Tables for the window.
    start : float
        Pressure per depth of the first guess, Pa / m.
    """
    rows, columns = below_m.shape
    state = _State(below_m, pixel_m, target, is_force, friction, motion, layer, start)
    count = 0
    for number in range(_MAX_PASSES):
        looseness = _FIRST_PASS if number == 0 and friction > 0.0 else 1.0
        taken = state.press(looseness * _PRESS_TOLERANCE)
        count += taken
        if number > 0 and taken == 0:
            break
        state.push_aside()
        if friction == 0.0:
            break
        count += state.shear(looseness * _SHEAR_TOLERANCE)
    else:
        state.press(math.inf)  # only the error
    fields = np.empty((6, rows, columns))
    inside = (..., slice(-2, 0, -1), slice(1, columns + 1))
    fields[0] = state.p[inside]
    fields[1:3] = state.q[inside]
    fields[3:5] = (state.bend + state.aside)[inside]
    fields[5] = (state.u + state.lifted)[inside]
    is_stick = (state.bound > 0.0) & ~state.slips
    return Solution(
        fields, fields[0] > 0.0, is_stick[inside], state.depth_m, state.worst_m / state.depth_m, count
    )


class _State:
    """Loads and displacements of a contact, while it is solved.

    Attributes
    ----------
    p : ndarray of float32, shape (R + 2, C + 2)
        Pressure.
    q : ndarray of float32, shape (2, R + 2, C + 2)
        Traction.
    bound, slips : ndarray, shape (R + 2, C + 2)
        Greatest traction, and where it is reached.
    u, aside : ndarray of float32, shapes (R + 2, n) and (2, R + 2, n)
        Displacement by the pressure.
    lifted, bend : ndarray of float32, shapes (R + 2, n) and (2, R + 2, n)
        Displacement by the traction.
    depth_m, worst_m : float
        Depth of the press, and the largest error of the gap.
    """

    def __init__(
        self,
        below_m: Float64,
        pixel_m: tuple[float, float],
        target: float,
        is_force: bool,
        friction: float,
        motion: tuple[float, float, float],
        layer: Layer,
        start: float,
    ) -> None:
        self._layer, self._target, self._is_force, self._friction = layer, target, is_force, friction
        shape = (below_m.shape[0] + 2, below_m.shape[1] + 2)
        self._below = np.full(shape, _FAR_M, np.float32)
        self._below[1:-1, 1:-1] = below_m[::-1]
        y, x = (
            (np.arange(count) - (count - 1) / 2) * size
            for count, size in zip(shape, pixel_m[::-1], strict=True)
        )
        self._motion = np.empty((2, *shape), np.float32)
        self._motion[0] = (motion[0] - motion[2] * y)[:, None]
        self._motion[1] = motion[1] + motion[2] * x
        self.p = _first_guess(self._below, target, is_force, start)
        self.q = np.zeros((2, *shape), np.float32)
        self.bound = np.zeros(shape, np.float32)
        self.slips = np.zeros(shape, np.bool_)
        self._pressed = self._transformed(self.p)
        self.u = self._displacement(self._pressed * layer.spectra["zz"])
        self.lifted = np.zeros_like(self.u)
        self.bend = np.zeros((2, *self.u.shape), np.float32)
        self.depth_m = self.worst_m = 0.0

    def press(self, tolerance: float) -> int:
        """Solve for the pressure; return the number of steps."""
        below = self._below + self.lifted[:, : self._below.shape[1]]
        error, step = np.zeros((2, *self.p.shape), np.float32)
        control = np.array(steps.FIRST_CONTROL)
        for count in range(_MAX_STEPS + 1):
            self.depth_m, self.worst_m = steps.press_step(
                self.p,
                self.u,
                below,
                error,
                step,
                self._layer.stencils[0],
                control,
                self._target,
                self._is_force,
                tolerance if count < _MAX_STEPS else math.inf,
            )
            if self.worst_m <= tolerance * abs(self.depth_m):
                break
            self._pressed = self._transformed(self.p)
            self.u = self._displacement(self._pressed * self._layer.spectra["zz"])
        return count

    def push_aside(self) -> None:
        """Find the displacement along the surface by the pressure, and the limits of the traction."""
        pushed = [self._pressed * self._layer.spectra[name] for name in ("xz", "yz")]
        self.aside = self._displacement(np.stack(pushed))
        self.bound = np.float32(self._friction) * self.p

    def shear(self, tolerance: float) -> int:
        """Solve for the traction, and find how far it lifts the surface; return the number of steps."""
        spectra, bound = self._layer.spectra, self.bound
        wanted = self._motion - self.aside[..., : bound.shape[1]]
        # Pixels that slipped before start on the new limit.
        size = np.hypot(*self.q)
        off = (size > bound) | (self.slips & (size > 0.0))
        self.q *= np.divide(bound, size, out=np.ones_like(size), where=off)
        damping = np.ones_like(bound)
        error, step = np.zeros((2, *self.q.shape), np.float32)
        control = np.array(steps.FIRST_CONTROL)
        self.slips = np.zeros(bound.shape, np.bool_)
        for count in range(_MAX_STEPS + 1):
            along_x, along_y = self._transformed(self.q)
            bent = np.stack(
                [
                    spectra["xx"] * along_x + spectra["xy"] * along_y,
                    spectra["xy"] * along_x + spectra["yy"] * along_y,
                ]
            )
            self.bend = self._displacement(bent)
            left = steps.shear_step(
                self.q,
                self.bend,
                wanted,
                bound,
                self.slips,
                damping,
                error,
                step,
                self._layer.stencils[1:],
                self._layer.own_shear,
                control,
                tolerance if count < _MAX_STEPS else math.inf,
            )
            if left <= tolerance:
                break
        self.lifted = self._displacement(-spectra["xz"] * along_x - spectra["yz"] * along_y)
        return count

    def _transformed(self, loads: Float32) -> Complex64:
        down, across = self._layer.lengths
        spectra: Complex64 = fft(rfft(loads, across), down, axis=-2, overwrite_x=True)
        return spectra

    def _displacement(self, spectra: Complex64) -> Float32:
        rows = self.p.shape[0]
        waves = ifft(spectra, axis=-2, overwrite_x=True)[..., :rows, :]
        displacement: Float32 = irfft(waves, self._layer.lengths[1])
        return displacement


def _first_guess(below: Float32, target: float, is_force: bool, start: float) -> Float32:
    """Return the pressure of a bed of springs with the stiffness ``start``, Pa / m."""
    depth = target
    if is_force:
        # The depth at which the springs of the highest pixels, whose number fits, bear the force.
        heights = np.sort(below[1:-1, 1:-1], axis=None).astype(np.float64)
        depths = (target / start + np.cumsum(heights)) / np.arange(1, heights.size + 1)
        depth = depths[np.count_nonzero(depths > heights) - 1]
    guess: Float32 = np.float32(start) * np.maximum(np.float32(depth) - below, np.float32(0.0))
    if is_force:
        guess *= np.float32(target / guess.sum(dtype=np.float64))
    return guess
