"""A gel that is elastic: pressure, shear and displacement where a rigid body is pressed into it.

The gel is a linear elastic layer without side faces, bonded to a rigid plate. Contact is that of Signorini
(pressure and gap are not negative, and one of them is zero), friction that of Coulomb.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from tactile_sim import elastic_layer
from tactile_toolkit.array_types import AnyArray, Bool, Float64
from tactile_toolkit.builtin_values import to_builtin
from tactile_toolkit.checked_fields import check_fields, real
from tactile_toolkit.errors import InputError
from tactile_toolkit.touch import MAX_IMAGE_PIXELS

_PASSES = 2  # of pressure and shear, each with the displacement that the other one makes
_MOST_STEPS = 400


@dataclass(frozen=True, slots=True)
class Gel:
    """Material of a gel, and its friction.

    The defaults are those of no particular sensor: soft silicone, which is nearly incompressible. How to find
    the modulus of a gel is stated in the documentation (Forces, shear, markers).

    Attributes
    ----------
    youngs_modulus_pa : float
        Young's modulus, Pa.
    poisson_ratio : float
        Poisson's ratio, 0 to 0.5.
    friction : float
        Coefficient of friction; 0 for a surface that slides freely.

    Raises
    ------
    InputError
        A value is out of range.
    """

    youngs_modulus_pa: float = real(0.2e6, least=1e2, most=1e9)
    poisson_ratio: float = real(0.49, least=0, most=0.5)
    friction: float = real(0.5, least=0, most=1000)

    def __post_init__(self) -> None:
        check_fields(self, "the gel")

    @property
    def shear_modulus_pa(self) -> float:
        """Shear modulus, Pa."""
        return self.youngs_modulus_pa / (2.0 * (1.0 + self.poisson_ratio))


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """The state of a gel into which a body is pressed.

    Axes: x along the columns, y against the rows (row 0 has the greatest y), z from the body into the gel;
    a right-handed frame, as of :func:`tactile_sim.render_touch`. Forces are those of the body on the gel, so
    that of a press is positive along z. Moments are about the centre of the window, on the surface.

    Attributes
    ----------
    depth_m : float
        How far the highest point of the body lies above the surface of the gel at rest, metres.
    pressure_pa : ndarray of float64, shape (H, W)
        Pressure of the body on the gel, Pa; 0 outside of the contact.
    traction_pa : ndarray of float64, shape (H, W, 2)
        Shear stress of the body on the gel along x and y, Pa.
    displacement_m : ndarray of float64, shape (H, W, 3)
        Displacement of the surface along x, y and z, metres; a negative z is a bulge.
    is_contact : ndarray of bool, shape (H, W)
        Where the body touches the gel.
    is_stick : ndarray of bool, shape (H, W)
        Where it sticks: the shear stress is below friction times pressure. Without a slide it is where
        the gel, which the press pushes aside, is held by friction; without friction it is nowhere.
    force_n : tuple of float
        Force of the body on the gel along x, y and z, newtons.
    torque_nm : tuple of float
        Torque of the body on the gel about x, y and z, newton metres: ``(sum y f_z, -sum x f_z,
        sum (x f_y - y f_x))``.
    iterations : int
        Steps of the solvers, all together.
    residual : float
        Largest error of the gap in the contact, relative to the depth.
    """

    depth_m: float
    pressure_pa: Float64
    traction_pa: Float64
    displacement_m: Float64
    is_contact: Bool
    is_stick: Bool
    force_n: tuple[float, float, float]
    torque_nm: tuple[float, float, float]
    iterations: int
    residual: float


def solve_contact(
    height_m: AnyArray,
    pixel_m: float | tuple[float, float],
    gel: Gel,
    *,
    thickness_m: float,
    depth_m: float | None = None,
    force_n: float | None = None,
    slide_m: tuple[float, float] = (0.0, 0.0),
    twist_rad: float = 0.0,
    block_px: int = 1,
) -> Contact:
    """Press a rigid body into a gel, then slide and twist it.

    Press, slide and twist are made at once: the result is that of one step, not of a history. Points of the
    gel are named by where they are at rest; the shape of the body is that under them before the slide.
    No pixel outside of the window is loaded: give the heights under the whole gel, and cut out what an image
    shows. Results depend on the arguments alone.

    Parameters
    ----------
    height_m : array_like, shape (H, W)
        Height of the body under the gel, metres, towards the gel, from any zero; row 0 at the greatest y.
    pixel_m : float or tuple of float
        Size of a pixel, metres, or its width and height.
    gel : Gel
        Material and friction.
    thickness_m : float
        Thickness of the gel, metres; infinite for a half-space.
    depth_m : float, optional
        How far the highest point of the body is pressed in, metres, above 0.
    force_n : float, optional
        The force of the press, newtons, above 0; exactly one of depth and force is given.
    slide_m : tuple of float
        How far the body then moves along x and y, metres; it drags the gel with it, so that a slide along
        +x makes a force along +x.
    twist_rad : float
        How far it turns about the centre of the window, radians, counter-clockwise as seen in the image.
    block_px : int
        Heights are averaged over blocks of this many pixels squared, and the result is brought up to the size of
        ``height_m``; 1 solves every pixel. H and W are multiples of it.

    Returns
    -------
    Contact
        Pressure, traction, displacement, force and torque.

    Raises
    ------
    InputError
        A number is out of range or not finite, or not exactly one of ``depth_m`` and ``force_n`` is given.
    """
    heights, pixel = _checked_heights(height_m), _checked_pixel(pixel_m)
    target = _checked_target(depth_m, force_n)
    slide = _checked_finite("slide_m and twist_rad", (*slide_m, twist_rad))
    _require(thickness_m > 0, f"thickness_m is {thickness_m!r}; expected a number above 0")
    _require(
        block_px >= 1 and not any(count % block_px for count in heights.shape),
        f"block_px is {block_px!r}; expected an integer of which {heights.shape[0]} rows and "
        f"{heights.shape[1]} columns are multiples",
    )
    coarse = heights
    if block_px > 1:
        blocks = heights.reshape(
            heights.shape[0] // block_px, block_px, heights.shape[1] // block_px, block_px
        )
        coarse = blocks.mean((1, 3))
    # The highest point of the body lies higher than the highest mean.
    higher = float(heights.max() - coarse.max())
    value, is_force = target
    if not is_force:
        value = max(value - higher, 1e-9)
    solver = _prepared(coarse.shape, (pixel[0] * block_px, pixel[1] * block_px), gel, float(thickness_m))
    found = solver.solve(coarse[::-1], value, is_force, slide)
    if block_px == 1:
        return found
    return _brought_up(found, heights, higher, block_px)


def _brought_up(coarse: Contact, heights: Float64, higher: float, block_px: int) -> Contact:
    """Bring a solution up to the size of the heights; in the contact the surface is that of the body."""
    from scipy.ndimage import zoom

    def linear(field: AnyArray) -> Float64:
        size = (block_px, block_px, *(1,) * (field.ndim - 2))
        return np.asarray(zoom(field.astype(np.float64), size, order=1, grid_mode=True, mode="nearest"))

    depth = coarse.depth_m + higher
    body = depth - (heights.max() - heights)
    moved = linear(coarse.displacement_m)
    pressure, traction = linear(coarse.pressure_pa), linear(coarse.traction_pa)
    is_contact = (linear(coarse.is_contact) > 0.5) | (body > moved[..., 2])
    moved[..., 2] = np.where(is_contact, body, moved[..., 2])
    return replace(
        coarse,
        depth_m=depth,
        pressure_pa=pressure,
        traction_pa=traction,
        displacement_m=moved,
        is_contact=is_contact,
        is_stick=is_contact & (linear(coarse.is_stick) > 0.5),
    )


def _require(fits: bool, what: str) -> None:
    if not fits:
        raise InputError(what)


def _checked_heights(height_m: AnyArray) -> Float64:
    heights = np.asarray(height_m, np.float64)
    _require(
        heights.ndim == 2 and 0 < heights.size <= MAX_IMAGE_PIXELS,
        f"height_m has shape {heights.shape}; expected (H, W), at most {MAX_IMAGE_PIXELS:,} pixels",
    )
    _require(bool(np.isfinite(heights).all()), "height_m has values that are not finite")
    return heights


def _checked_pixel(pixel_m: float | tuple[float, float]) -> tuple[float, float]:
    pixel = np.asarray(pixel_m, np.float64)
    _require(
        pixel.shape in ((), (2,)) and bool((pixel > 0).all() and np.isfinite(pixel).all()),
        f"pixel_m is {pixel_m!r}; expected a number above 0, metres, or width and height",
    )
    width, height = np.broadcast_to(pixel, 2).tolist()
    return width, height


def _checked_target(depth_m: float | None, force_n: float | None) -> tuple[float, bool]:
    """Return the depth or the force, and whether it is the force."""
    _require((depth_m is None) != (force_n is None), "expected exactly one of depth_m and force_n")
    ((name, value),) = ((n, v) for n, v in (("depth_m", depth_m), ("force_n", force_n)) if v is not None)
    _require(math.isfinite(value) and value > 0, f"{name} is {value!r}; expected a number above 0")
    return float(value), name == "force_n"


def _checked_finite(name: str, values: tuple[float, ...]) -> tuple[float, ...]:
    found = to_builtin(values)
    _require(all(map(math.isfinite, found)), f"{name} are {values!r}; expected finite numbers")
    return tuple(map(float, found))


@lru_cache(maxsize=8)
def _prepared(shape: tuple[int, int], pixel_m: tuple[float, float], gel: Gel, thickness_m: float) -> _Solver:
    return _Solver(shape, pixel_m, gel, thickness_m)


class _Solver:
    """Plain solvers in double precision; y grows with the rows here."""

    def __init__(
        self, shape: tuple[int, int], pixel_m: tuple[float, float], gel: Gel, thickness_m: float
    ) -> None:
        from scipy.fft import next_fast_len, rfft2

        self.shape, self.pixel_m, self.gel = shape, pixel_m, gel
        self.area_m2 = pixel_m[0] * pixel_m[1]
        kernels = elastic_layer.pixel_kernels(
            shape, pixel_m, gel.shear_modulus_pa, gel.poisson_ratio, thickness_m
        )
        self.padded = tuple(next_fast_len(2 * count - 1, True) for count in shape)
        self.at_zero = {name: float(kernel[0, 0]) for name, kernel in kernels.items()}
        parity = {"zz": (1, 1), "xx": (1, 1), "yy": (1, 1), "xy": (-1, -1), "xz": (1, -1), "yz": (-1, 1)}
        self.spectra = {}
        for name, kernel in kernels.items():
            whole = np.zeros(self.padded)
            rows, columns = shape
            whole[:rows, :columns] = kernel
            whole[:rows, -columns + 1 :] = parity[name][1] * kernel[:, :0:-1]
            whole[-rows + 1 :] = parity[name][0] * whole[rows - 1 : 0 : -1]
            self.spectra[name] = rfft2(whole)
        y, x = (
            (np.arange(count) - (count - 1) / 2) * size
            for count, size in zip(shape, pixel_m[::-1], strict=True)
        )
        self.x, self.y = x[None, :], y[:, None]

    def transform(self, field: Float64) -> AnyArray:
        from scipy.fft import rfft2

        return rfft2(field, self.padded)

    def back(self, spectrum: AnyArray) -> Float64:
        from scipy.fft import irfft2

        return irfft2(spectrum, self.padded)[: self.shape[0], : self.shape[1]]

    def normal(self, pressure: Float64) -> Float64:
        return self.back(self.transform(pressure) * self.spectra["zz"])

    def tangential(self, traction: AnyArray) -> AnyArray:
        x, y = self.transform(traction.real), self.transform(traction.imag)
        s = self.spectra
        return self.back(s["xx"] * x + s["xy"] * y) + 1j * self.back(s["xy"] * x + s["yy"] * y)

    def sideways(self, pressure: Float64) -> AnyArray:
        p = self.transform(pressure)
        return self.back(self.spectra["xz"] * p) + 1j * self.back(self.spectra["yz"] * p)

    def lifted(self, traction: AnyArray) -> Float64:
        x, y = self.transform(traction.real), self.transform(traction.imag)
        return -self.back(self.spectra["xz"] * x + self.spectra["yz"] * y)

    def solve(
        self,
        heights: Float64,
        target: float,
        is_force: bool,
        slide: tuple[float, ...],
        tolerance: float = 1e-7,
    ) -> Contact:
        below = heights.max() - heights
        friction = self.gel.friction
        wanted = slide[0] - slide[2] * self.y + 1j * (slide[1] + slide[2] * self.x)
        traction = np.zeros(self.shape, complex)
        pressure, lift = None, np.zeros(self.shape)
        steps = 0
        for _ in range(_PASSES if friction else 1):
            pressure, depth, residual, used = self.press(below + lift, target, is_force, pressure, tolerance)
            steps += used
            if friction:
                across = self.sideways(pressure)
                traction, used = self.shear(friction * pressure, wanted - across, traction, tolerance)
                steps += used
                lift = self.lifted(traction)
        moved = self.tangential(traction) + self.sideways(pressure)
        displacement = np.stack([moved.real, moved.imag, self.normal(pressure) + self.lifted(traction)], 2)
        is_contact = pressure > 0
        is_stick = is_contact & (np.abs(traction) < friction * pressure * (1 - 1e-6))
        force_z = pressure * self.area_m2
        force_x, force_y = traction.real * self.area_m2, traction.imag * self.area_m2
        return Contact(
            float(depth),
            pressure[::-1].copy(),
            np.stack([traction.real, traction.imag], 2)[::-1].copy(),
            displacement[::-1].copy(),
            is_contact[::-1].copy(),
            is_stick[::-1].copy(),
            (float(force_x.sum()), float(force_y.sum()), float(force_z.sum())),
            (
                float((self.y * force_z).sum()),
                float(-(self.x * force_z).sum()),
                float((self.x * force_y - self.y * force_x).sum()),
            ),
            steps,
            float(residual),
        )

    def press(
        self, below: Float64, target: float, is_force: bool, start: Float64 | None, tolerance: float
    ) -> tuple[Float64, float, float, int]:
        """Polonsky and Keer 1999, by conjugate gradients."""
        total = target / self.area_m2
        if start is not None:
            p = start
        elif is_force:
            p = np.full(self.shape, total / below.size)
        else:
            p = np.maximum(target - below, 0.0) * self.gel.youngs_modulus_pa / target
        t, old, keep, depth = np.zeros(self.shape), 1.0, 0.0, target
        error = math.inf
        for step in range(_MOST_STEPS):
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
        return p, depth, error, step

    def shear(
        self, bound: Float64, wanted: AnyArray, start: AnyArray, tolerance: float
    ) -> tuple[AnyArray, int]:
        """Least energy of the shear with |q| <= bound, by projected conjugate gradients."""
        free = bound > 0
        q = np.where(free, start, 0)
        size = np.abs(q)
        over = size > bound
        q[over] *= bound[over] / size[over]
        rest = np.where(free, wanted - self.tangential(q), 0)
        limit = tolerance * np.abs(wanted[free]).max()
        c0 = (self.at_zero["xx"] + self.at_zero["yy"]) / 2
        d, old, before = np.zeros_like(q), 1.0, None
        for step in range(_MOST_STEPS):
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
        return q, step
