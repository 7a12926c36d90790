"""The peer of the press with friction: the same contact in double precision, with transforms of SciPy."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.tactile_sim.elastic_reference import MOST_STEPS, PlainSolver

PASSES = 6


class FrictionSolver(PlainSolver):
    """Conjugate gradients for the pressure and projected ones for the traction, by turns.

    Rows of arrays grow with y; tractions and motions are complex numbers, x + i y.
    """

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        load, middle = np.zeros(self.shape, complex), tuple(count // 2 for count in self.shape)
        load[middle] = 1
        self.own = float(self.tangential(load)[middle].real)

    def pressed(self, heights: np.ndarray, force_n: float, tolerance: float) -> tuple[Any, np.ndarray]:
        """Return pressure and traction at a force."""
        below = heights.max() - heights
        traction, pressure = np.zeros(self.shape, complex), None
        for _ in range(PASSES):
            pressure, _ = self.press(below + self.lifted(traction), force_n, True, pressure, tolerance)
            bound = self.gel.friction * pressure
            traction = self.sheared(bound, -self.sideways(pressure), traction, tolerance)
        return pressure, traction

    def sheared(
        self, bound: np.ndarray, motion_m: np.ndarray, start: np.ndarray, tolerance: float
    ) -> np.ndarray:
        """Return the traction of least energy, at most ``bound``, that keeps the contact in place."""
        loaded = bound > 0
        divisor = np.where(loaded, bound, 1.0)
        traction = self.projected(np.where(loaded, start, 0), bound, np.zeros(self.shape, bool))
        residual = np.where(loaded, motion_m - self.tangential(traction), 0)
        limit = tolerance * np.abs(motion_m[loaded]).max()
        step, last, energy, slipped = np.zeros_like(traction), np.zeros_like(traction), 1.0, None
        for _ in range(MOST_STEPS):
            unit = traction / divisor
            outward = (residual * unit.conj()).real
            slips = loaded & (np.abs(unit) >= 1 - 1e-9) & (outward > 0)
            gradient = np.where(slips, residual - outward * unit, residual)
            if np.abs(gradient).max() <= limit:
                break
            curvature = np.where(slips, outward / divisor, 0.0)
            scaled = gradient / (self.own + curvature)
            factor = 0.0
            if slipped is not None and (slips == slipped).all():
                factor = max(float((scaled.conj() * (gradient - last)).real.sum()) / energy, 0.0)
            step = scaled + factor * np.where(slips, step - (step * unit.conj()).real * unit, step)
            energy, last, slipped = float((scaled.conj() * gradient).real.sum()), gradient, slips
            bend = self.tangential(step) + curvature * step
            length = float((gradient.conj() * step).real.sum() / (step.conj() * bend).real.sum())
            traction = self.projected(np.where(loaded, traction + length * step, 0), bound, slips)
            residual = np.where(loaded, motion_m - self.tangential(traction), 0)
        return traction

    @staticmethod
    def projected(traction: np.ndarray, bound: np.ndarray, slips: np.ndarray) -> np.ndarray:
        """Return the traction, shortened to its bound where it is beyond, or slips."""
        size = np.abs(traction)
        is_bound = (size > bound) | slips
        return np.where(is_bound, traction * bound / np.where(size > 0, size, 1.0), traction)
