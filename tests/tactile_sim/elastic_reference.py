"""Response of the elastic gel, and a press without friction, in double precision by transforms of SciPy.

Rows of its arrays grow with y. Tractions and motions are complex numbers, x + i y.
"""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
from scipy.fft import irfft2, rfft2

from tactile_sim.elastic import layer

MOST_STEPS = 400


class PlainSolver:
    """Displacements by loads, and Polonsky and Keer's conjugate gradients for the pressure."""

    def __init__(self, shape, pixel_m, gel, thickness_m):
        self.shape, self.gel = shape, gel
        self.area_m2 = pixel_m[0] * pixel_m[1]
        kernels = layer.pixel_kernels(shape, pixel_m, gel.shear_modulus_pa, gel.poisson_ratio, thickness_m)
        self.padded, self.spectra = layer.transforms(kernels)

    def transform(self, field):
        return rfft2(field, self.padded)

    def back(self, spectrum):
        return irfft2(spectrum, self.padded)[: self.shape[0], : self.shape[1]]

    def normal(self, pressure):
        return self.back(self.transform(pressure) * self.spectra["zz"])

    def tangential(self, traction):
        x, y = self.transform(traction.real), self.transform(traction.imag)
        s = self.spectra
        return self.back(s["xx"] * x + s["xy"] * y) + 1j * self.back(s["xy"] * x + s["yy"] * y)

    def sideways(self, pressure):
        p = self.transform(pressure)
        return self.back(self.spectra["xz"] * p) + 1j * self.back(self.spectra["yz"] * p)

    def lifted(self, traction):
        x, y = self.transform(traction.real), self.transform(traction.imag)
        return -self.back(self.spectra["xz"] * x + self.spectra["yz"] * y)

    def displacement_m(self, pressure, traction):
        """Return displacements along x, y and z, (H, W, 3)."""
        moved = self.tangential(traction) + self.sideways(pressure)
        return np.stack([moved.real, moved.imag, self.normal(pressure) + self.lifted(traction)], 2)

    def solve(self, heights, force_n):
        """Press without friction to a force; rows of ``heights`` grow with y."""
        pressure, _ = self.press(heights.max() - heights, force_n, True)
        return SimpleNamespace(displacement_m=self.displacement_m(pressure, np.zeros(self.shape, complex)))

    def press(self, below, target, is_force, start=None, tolerance=1e-7):
        """Return pressure and depth: Polonsky and Keer, Wear 231, 1999."""
        total = target / self.area_m2
        if start is not None:
            p = start
        elif is_force:
            p = np.full(self.shape, total / below.size)
        else:
            p = np.maximum(target - below, 0.0) * self.gel.youngs_modulus_pa / target
        t, old, keep, depth = np.zeros(self.shape), 1.0, 0.0, target
        error = math.inf
        for step in range(MOST_STEPS):
            gap = self.normal(p) + below
            contact = p > 0
            depth = gap[contact].mean() if is_force else target
            gap -= depth
            error = np.abs(gap[contact]).max() / depth if contact.any() else math.inf
            if step and error < tolerance and gap.min() > -tolerance * depth:
                break
            square = float((gap[contact] ** 2).sum())
            t = np.where(contact, gap + keep * (square / old) * t, 0.0)
            old = square
            r = self.normal(t)
            if is_force:
                r -= r[contact].mean()
            tau = float((gap * t)[contact].sum() / (r * t)[contact].sum())
            p = np.maximum(np.where(contact, p - tau * t, 0.0), 0.0)
            joined = (p == 0) & (gap < 0)
            keep = 0.0 if joined.any() else 1.0
            p[joined] -= tau * gap[joined]
            if is_force:
                p *= total / p.sum()
        return p, float(depth)
