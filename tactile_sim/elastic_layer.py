"""How the surface of an elastic layer answers a load: influence of one loaded pixel on all others.

The kernel of a pixel is that of the half-space in closed form (Love 1929; Cerruti; Johnson, Contact Mechanics,
sections 3.2 and 3.6) and a smooth correction for the layer, bonded to a rigid base, of thickness h.
Directions: x along columns, y upwards, z into the gel. A kernel states the displacement at an offset from
the pixel that bears 1 Pa: "xz" is the displacement along x by pressure; that along z by a traction along x is
its mirror image (reciprocity).
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from tactile_toolkit.array_types import Float64

NAMES = ("zz", "xx", "yy", "xy", "xz", "yz")

_FARTHEST_WAVE = 18.0  # wave numbers of the correction, times h: it has fallen to exp(-2 * 18) there
_WAVES, _RADII = 1600, 600

Kernels: TypeAlias = dict[str, Float64]
"""By name: displacement per pressure, m / Pa, shape (H, W), at offsets of 0 or more pixels along y and x."""


def layer_response(waves: Float64, poisson_ratio: float) -> tuple[Float64, Float64, Float64, Float64]:
    """Return the response Z, A, N, B of a bonded layer to waves of load, times G / h.

    With l along the wave and t across it, u_z = Z p - i N q_l, u_l = A q_l + i N p, u_t = B q_t.

    Parameters
    ----------
    waves : ndarray of float64
        Wave number times thickness of the layer, above 0.
    poisson_ratio : float
        Poisson's ratio.

    Returns
    -------
    tuple of ndarray
        Z, A, N and B in the shape of ``waves``; displacement times G / (h * pressure).
    """
    # Above and below are multiplied by 2 exp(-2a), against overflow.
    twice = np.exp(-2.0 * waves)
    fourth = twice * twice
    kappa = 3.0 - 4.0 * poisson_ratio
    below = 2.0 * kappa * (1.0 + fourth) + twice * 2.0 * (4.0 * waves**2 + 1.0 + kappa**2)
    sinh, flat = 2.0 * kappa * (1.0 - fourth), 8.0 * waves * twice
    scale = (1.0 - poisson_ratio) / waves / below
    cosh = 1.0 + fourth - 2.0 * twice
    coupled = 2.0 * (1.0 - 2.0 * poisson_ratio) * kappa * cosh - 8.0 * waves**2 * twice
    return (
        scale * (sinh - flat),
        scale * (sinh + flat),
        coupled / (2.0 * waves * below),
        (1.0 - twice) / (1.0 + twice) / waves,
    )


def pixel_kernels(
    shape: tuple[int, int],
    pixel_m: tuple[float, float],
    shear_pa: float,
    poisson_ratio: float,
    layer_m: float,
) -> Kernels:
    """Return the influence of a pixel that bears 1 Pa, at offsets of 0 or more pixels.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns.
    pixel_m : tuple of float
        Width and height of a pixel, metres.
    shear_pa : float
        Shear modulus G, Pa.
    poisson_ratio : float
        Poisson's ratio.
    layer_m : float
        Thickness of the layer, metres; infinite for a half-space.

    Returns
    -------
    dict
        Kernels by name, float64, shape ``shape``: "zz", "xx", "yy" are even along both axes, "xy" is odd along
        both, "xz" odd along x and "yz" odd along y.
    """
    kernels = _half_space(shape, pixel_m, poisson_ratio)
    if math.isfinite(layer_m):
        for name, kernel in _layer_correction(shape, pixel_m, poisson_ratio, layer_m).items():
            kernels[name] += kernel
    return {name: kernel / shear_pa for name, kernel in kernels.items()}


def _half_space(shape: tuple[int, int], pixel_m: tuple[float, float], poisson_ratio: float) -> Kernels:
    """Kernels of the half-space, times G: sums over the corners of the loaded pixel."""
    y, x = ((np.arange(count + 1) - 0.5) * size for count, size in zip(shape, pixel_m[::-1], strict=True))
    x, y = x[None, :], y[:, None]
    r = np.hypot(x, y)
    log_r = np.log(r)
    corners = {
        "xx": y * np.log(x + r),
        "yy": x * np.log(y + r),
        "xy": -r,
        "x": y * log_r + x * np.arctan(y / x),
        "y": x * log_r + y * np.arctan(x / y),
    }
    sums = {
        name: each[1:, 1:] - each[1:, :-1] - each[:-1, 1:] + each[:-1, :-1] for name, each in corners.items()
    }
    compressed, turn = 1.0 - poisson_ratio, 1.0 / (2.0 * math.pi)
    inward = -(1.0 - 2.0 * poisson_ratio) / (4.0 * math.pi)
    return {
        "zz": turn * compressed * (sums["xx"] + sums["yy"]),
        "xx": turn * (sums["xx"] + compressed * sums["yy"]),
        "yy": turn * (sums["yy"] + compressed * sums["xx"]),
        "xy": turn * poisson_ratio * sums["xy"],
        "xz": inward * sums["x"],
        "yz": inward * sums["y"],
    }


def _layer_correction(
    shape: tuple[int, int], pixel_m: tuple[float, float], poisson_ratio: float, layer_m: float
) -> Kernels:
    """Layer less half-space, times G: the load of a pixel acts at its centre, as the correction is smooth."""
    from scipy.special import j0, j1  # importing scipy takes a fifth of a second

    y, x = (np.arange(count) * size for count, size in zip(shape, pixel_m[::-1], strict=True))
    x, y = np.meshgrid(x, y)
    far = np.hypot(x, y)
    radii = np.linspace(0.0, far.max() / layer_m, _RADII)
    # Gauss-Legendre nodes
    nodes, weights = np.polynomial.legendre.leggauss(_WAVES // 10)
    waves = (nodes + 1.0) * _FARTHEST_WAVE / 2.0
    weights = weights * _FARTHEST_WAVE / 2.0
    pressed, along, coupled, across = layer_response(waves, poisson_ratio)
    compressed = 1.0 - poisson_ratio
    phase = waves[:, None] * radii[None, :]
    first = j0(phase)
    second = j1(phase)
    third = np.divide(2.0 * second, phase, out=np.zeros_like(phase), where=phase > 0) - first
    third[:, 0] = 0.0

    def integral(integrand: Float64, bessel: Float64) -> Float64:
        return np.interp(far / layer_m, radii, (weights * integrand) @ bessel)

    mean = (waves * (along + across) - compressed - 1.0) / 2.0
    difference = (waves * (along - across) - compressed + 1.0) / 2.0
    scale = pixel_m[0] * pixel_m[1] / (2.0 * math.pi * layer_m)
    cosine, sine = (np.divide(each, far, out=np.zeros_like(far), where=far > 0) for each in (x, y))
    round_ = integral(mean, first)
    oval = integral(difference, third)
    radial = -integral(waves * coupled - (0.5 - poisson_ratio), second)
    found = {
        "zz": integral(waves * pressed - compressed, first),
        "xx": round_ - (cosine**2 - sine**2) * oval,
        "yy": round_ + (cosine**2 - sine**2) * oval,
        "xy": -2.0 * cosine * sine * oval,
        "xz": cosine * radial,
        "yz": sine * radial,
    }
    return {name: scale * each for name, each in found.items()}
