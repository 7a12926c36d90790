"""A plain solver of the elastic gel, in double precision, with transforms of SciPy.

Rows of its arrays grow with y. Tractions and motions are complex numbers, x + i y.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from scipy.fft import irfft2, rfft2

from tactile_sim.elastic import layer

PASSES, MOST_STEPS = 6, 400


@dataclasses.dataclass
class PlainContact:
    """As :class:`tactile_sim.ElasticContact`, row 0 at the least y."""

    depth_m: float
    pressure_pa: np.ndarray
    traction_pa: np.ndarray
    displacement_m: np.ndarray


class PlainSolver:
    """Polonsky and Keer's conjugate gradients for the pressure, projected ones for the shear."""

    def __init__(self, shape, pixel_m, gel, thickness_m):
        self.shape, self.gel = shape, gel
        self.area_m2 = pixel_m[0] * pixel_m[1]
        kernels = layer.pixel_kernels(shape, pixel_m, gel.shear_modulus_pa, gel.poisson_ratio, thickness_m)
        self.own = float(kernels["xx"][0, 0] + kernels["yy"][0, 0]) / 2
        self.padded, self.spectra = layer.transforms(kernels)
        y, x = (
            (np.arange(count) - (count - 1) / 2) * size
            for count, size in zip(shape, pixel_m[::-1], strict=True)
        )
        self.x, self.y = x[None, :], y[:, None]

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

    def solve(self, heights, force_n, motion=(0.0, 0.0, 0.0), tolerance=1e-7):
        """Solve at a force; rows of ``heights`` grow with y."""
        below, friction = heights.max() - heights, self.gel.friction
        wanted = motion[0] - motion[2] * self.y + 1j * (motion[1] + motion[2] * self.x)
        traction, pressure, lift = np.zeros(self.shape, complex), None, np.zeros(self.shape)
        for _ in range(PASSES if friction else 1):
            pressure, depth = self.press(below + lift, force_n, True, pressure, tolerance)
            if friction:
                rest = wanted - self.sideways(pressure)
                traction = self.shear(friction * pressure, rest, traction, tolerance)
                lift = self.lifted(traction)
        moved = self.tangential(traction) + self.sideways(pressure)
        displacement = np.stack([moved.real, moved.imag, self.normal(pressure) + lift], 2)
        return PlainContact(depth, pressure, np.stack([traction.real, traction.imag], 2), displacement)

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

    def shear(self, bound, wanted, start, tolerance):
        """Return the traction of least energy with |q| <= bound."""
        free = bound > 0
        q = np.where(free, start, 0)
        size = np.abs(q)
        over = size > bound
        q[over] *= bound[over] / size[over]
        rest = np.where(free, wanted - self.tangential(q), 0)
        limit = tolerance * np.abs(wanted[free]).max()
        c0 = self.own
        d, old, before, last = np.zeros_like(q), 1.0, None, np.zeros_like(q)
        for _ in range(MOST_STEPS):
            out = q / np.where(free, bound, 1.0)
            outward = (rest * out.conj()).real
            slip = free & (np.abs(out) >= 1 - 1e-9) & (outward > 0)
            g = np.where(slip, rest - outward * out, rest)
            if np.abs(g).max() <= limit:
                break
            curved = np.where(slip, outward / np.where(free, bound, 1.0), 0.0)
            z = g / (c0 + curved)
            if before is None or (slip != before).any():
                keep = 0.0
            else:
                keep = max(float((z.conj() * (g - last)).real.sum()) / old, 0.0)
            d = z + keep * np.where(slip, d - (d * out.conj()).real * out, d)
            old, last, before = float((z.conj() * g).real.sum()), g, slip
            bend = self.tangential(d)
            tau = float((g.conj() * d).real.sum() / ((d.conj() * (bend + curved * d)).real.sum()))
            q = np.where(free, q + tau * d, 0)
            size = np.abs(q)
            over = (size > bound) | slip
            q[over] *= bound[over] / size[over]
            rest = np.where(free, wanted - self.tangential(q), 0)
        return q
