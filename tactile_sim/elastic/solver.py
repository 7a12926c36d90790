"""Solution of a contact by projected gradients: pressure and traction in turn, on transforms of SciPy.

Fields are of single precision and flat, and have a border of one pixel, which is not loaded. Their rows are
counted from the least y.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.fft import fft, ifft, irfft, rfft

from tactile_sim.elastic import steps
from tactile_sim.elastic.layer import Complex64, Layer
from tactile_toolkit.value_types import Float32, Float64

_PRESS_TOLERANCE = 7e-4  # largest error of the gap, relative to the depth
_SHEAR_TOLERANCE = 1e-4  # root mean square of the error along the surface, relative to the largest motion
_MAX_PASSES = 20  # of pressure and shear, each with the displacement that the other one makes
_FIRST_PASS = 30.0  # factor of the tolerances in the first pass, which only starts the others
_MAX_STEPS = 300
# Of a contact that moves. With one pass a step, the force lags behind the motion, and bodies gain energy. At
# 3e-4, the force on a body at rest swings by a thousandth; at 1e-4, by a hundred-thousandth.
# The first pass only predicts the coupling of the second one.
_STEP_TOLERANCES = ((1e-3, 1e-3), (1e-4, 1e-4))  # of pressure and traction, in each pass
_SLOW = 0.03  # share of the depth in a step
_LEAST_MOTION = 2e-3  # share of the depth; at least this much in a step is a motion that goes on
_SIMILAR = (0.7, 1.5)  # ratios of depths within which the last pressure is a good first guess
_FAR_M = 1e6


class Solution(NamedTuple):
    """A solved contact.

    Attributes
    ----------
    fields : ndarray of float64, shape (8, R, C)
        Pressure, traction along x and y, Pa; displacement along x, y and z, metres; 1 where the body touches
        the gel, and where it sticks; row 0 at the greatest y.
    depth_m : float
        How far the highest point is pressed in.
    error : float
        Largest error of the gap, relative to the depth.
    iterations : int
        Steps, all together.
    """

    fields: Float64
    depth_m: float
    error: float
    iterations: int


class ContactProblem:
    """A body that is pressed in, and whose surface moves; see :func:`tactile_sim.solve_contact`.

    Its loads and displacements change while it is solved; they are fields of n pixels. A contact that moves
    on is solved step by step, see :meth:`follow`.

    Parameters
    ----------
    below_m : ndarray of float64, shape (R, C)
        How far the body is below its highest point, metres, row 0 at the greatest y.
    target : float
        Sum of the pressures, Pa, if ``is_force``; else the depth, metres.
    is_force : bool
        What the target is.
    friction : float
        Coefficient of friction.
    motion_m : ndarray of float64, shape (2, R, C)
        How far the body moves along x and y, metres.
    layer : Layer
        Tables for the window.
    start : float
        Pressure per depth of the first guess, Pa / m.

    Attributes
    ----------
    p, u : ndarray of float32, shape (n,)
        Pressure, and the displacement along z by it.
    q, bend, aside : ndarray of float32, shape (2, n)
        Traction, and the displacements along x and y by it, and by the pressure.
    lifted : ndarray of float32, shape (n,)
        Displacement along z by the traction.
    bound, slips : ndarray, shape (n,)
        Greatest traction, and where it is reached.
    depth_m, worst_m : float
        Depth of the press, and the largest error of the gap.
    """

    def __init__(
        self,
        below_m: Float64,
        target: float,
        is_force: bool,
        friction: float,
        motion_m: Float64,
        layer: Layer,
        start: float,
    ) -> None:
        self._layer = layer
        self._target = target
        self._is_force = is_force
        self._friction = friction
        self._start = start
        self._shape = (below_m.shape[0] + 2, below_m.shape[1] + 2)
        self._below = _flat(below_m, _FAR_M)
        self._motion = _flat(motion_m, 0.0)
        self.p = _first_guess(self._below, target, is_force, start)
        self._pressed = self._transformed(self.p)
        self.u = self._displacement(self._pressed * layer.inward)
        self.q, self.bend = np.zeros((2, 2, self.p.size), np.float32)
        self.lifted, self.bound = np.zeros((2, self.p.size), np.float32)
        self.slips = np.zeros(self.p.size, np.bool_)
        self.depth_m = self.worst_m = 0.0
        self._last = (
            self.p,
            self.u,
            self.q,
            self.lifted,
            0.0,
        )  # loads before the last step, and the change in it

    def solve(self) -> Solution:
        """Solve the press and the motion."""
        iterations = 0
        for number in range(_MAX_PASSES):
            looseness = _FIRST_PASS if number == 0 and self._friction > 0.0 else 1.0
            taken = self.press(looseness * _PRESS_TOLERANCE)
            iterations += taken
            if number > 0 and taken == 0:
                break
            self.push_aside()
            if self._friction == 0.0:
                break
            iterations += self.shear(looseness * _SHEAR_TOLERANCE)
        else:
            self.press(math.inf)  # only the error
        return self._solution(iterations)

    def follow(self, below_m: Float64, depth_m: float, motion_m: Float64) -> Solution:
        """Solve the next step of a contact that moves; arguments as of the class, to a depth in metres."""
        below = _flat(below_m, _FAR_M)
        motion = _flat(motion_m, 0.0)
        risen = np.float32(depth_m - self._target) - (below - self._below)
        touches = self.p > 0.0
        change = float(np.abs([risen, *(motion - self._motion)]).max(where=touches, initial=0.0))
        is_similar = _SIMILAR[0] <= depth_m / self._target <= _SIMILAR[1]
        self._below = below
        self._motion = motion
        self._target = depth_m
        self._predict(change, is_similar)
        iterations = 0
        # The coupling of a slow motion is known well enough from the last steps.
        is_slow = is_similar and change < _SLOW * depth_m
        for press_tolerance, shear_tolerance in _STEP_TOLERANCES[is_slow:]:
            iterations += self.press(press_tolerance)
            self.push_aside()
            if self._friction > 0.0:
                iterations += self.shear(shear_tolerance)
        return self._solution(iterations)

    def _predict(self, change: float, is_similar: bool) -> None:
        """Let the loads change as in the last step, in proportion to the motion; not at all at rest."""
        last_p, last_u, last_q, last_lifted, last_change = self._last
        self._last = (self.p.copy(), self.u, self.q.copy(), self.lifted, change)
        # Nearly at rest, it would repeat the errors that are within the tolerance.
        moves = min(change, last_change) > _LEAST_MOTION * self._target
        share = np.float32(min(change / last_change, 1.0) if moves else 0.0)
        self.q += share * (self.q - last_q)
        self.lifted = self.lifted + share * (self.lifted - last_lifted)
        if is_similar:
            self.u = self.u + share * (self.u - last_u)
            self.p = np.maximum(self.p + share * (self.p - last_p), np.float32(0.0))
        else:
            self.p = _first_guess(self._below, self._target, False, self._start)
            self._pressed = self._transformed(self.p)
            self.u = self._displacement(self._pressed * self._layer.inward)

    def _solution(self, iterations: int) -> Solution:
        is_stick = (self.bound > 0.0) & ~self.slips
        along = self.bend + self.aside
        fields = np.vstack([self.p, self.q, along, self.u + self.lifted, self.p > 0.0, is_stick])
        inside = fields.reshape(-1, *self._shape)[:, -2:0:-1, 1:-1].astype(np.float64)
        return Solution(inside, self.depth_m, self.worst_m / self.depth_m, iterations)

    def press(self, tolerance: float) -> int:
        """Solve for the pressure; return the number of steps."""
        below = self._below + self.lifted
        error, step = np.zeros((2, *self.p.shape), np.float32)
        control = np.array(steps.FIRST_CONTROL)
        for count in range(_MAX_STEPS + 1):
            self.depth_m, self.worst_m = steps.press_step(
                steps.PressFields(self.p, self.u, below, error, step),
                self._shape[1],
                self._layer.stencils[0],
                control,
                self._target,
                self._is_force,
                tolerance if count < _MAX_STEPS else math.inf,
            )
            if self.worst_m <= tolerance * abs(self.depth_m):
                break
            self._pressed = self._transformed(self.p)
            self.u = self._displacement(self._pressed * self._layer.inward)
        return count

    def push_aside(self) -> None:
        """Find the displacement along the surface by the pressure, and the limits of the traction."""
        self.aside = self._displacement(self._pressed * self._layer.aside)
        self.bound = np.float32(self._friction) * self.p

    def shear(self, tolerance: float) -> int:
        """Solve for the traction, and find how far it lifts the surface; return the number of steps."""
        layer = self._layer
        bound = self.bound
        motion = self._motion - self.aside
        # Pixels that slipped before start on the new limit.
        size = np.hypot(*self.q)
        off = (size > bound) | (self.slips & (size > 0.0))
        self.q *= np.divide(bound, size, out=np.ones_like(size), where=off)
        damping = np.ones_like(bound)
        error, step = np.zeros((2, *self.q.shape), np.float32)
        control = np.array(steps.FIRST_CONTROL)
        self.slips[:] = False
        for count in range(_MAX_STEPS + 1):
            sheared = self._transformed(self.q)
            bent = layer.along * sheared
            bent += layer.across * sheared[::-1]
            self.bend = self._displacement(bent)
            left = steps.shear_step(
                steps.ShearFields(self.q, self.bend, motion, bound, self.slips, damping, error, step),
                self._shape[1],
                layer.stencils[1:],
                layer.own_shear,
                control,
                tolerance if count < _MAX_STEPS else math.inf,
            )
            if left <= tolerance:
                break
        sheared *= layer.aside
        self.lifted = -self._displacement(sheared[0] + sheared[1])
        return count

    def _transformed(self, loads: Float32) -> Complex64:
        down, across = self._layer.lengths
        waves = rfft(loads.reshape(*loads.shape[:-1], *self._shape), across)
        spectra: Complex64 = fft(waves, down, axis=-2, overwrite_x=True)
        return spectra

    def _displacement(self, spectra: Complex64) -> Float32:
        rows, columns = self._shape
        waves = ifft(spectra, axis=-2, overwrite_x=True)[..., :rows, :]
        displacement = irfft(waves, self._layer.lengths[1])[..., :columns]
        return displacement.reshape(*spectra.shape[:-2], rows * columns)


def _flat(field_m: Float64, border_m: float) -> Float32:
    """Return fields (..., R, C) as the solver has them: (..., n), with a border, from the least y."""
    count, rows, columns = (1, *field_m.shape)[-3:]
    flat = np.full((count, rows + 2, columns + 2), border_m, np.float32)
    flat[:, 1:-1, 1:-1] = field_m[..., ::-1, :]
    return flat.reshape(*field_m.shape[:-2], -1)


def _first_guess(below: Float32, target: float, is_force: bool, start: float) -> Float32:
    """Return the pressure of a bed of springs with the stiffness ``start``, Pa / m."""
    depth = target
    if is_force:
        # The depth at which the springs of the highest pixels, whose number fits, bear the force.
        heights = np.sort(below).astype(np.float64)
        depths = (target / start + np.cumsum(heights)) / np.arange(1, heights.size + 1)
        depth = depths[np.count_nonzero(depths > heights) - 1]
    guess: Float32 = np.float32(start) * np.maximum(np.float32(depth) - below, np.float32(0.0))
    if is_force:
        guess *= np.float32(target / guess.sum(dtype=np.float64))
    return guess
