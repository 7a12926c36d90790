"""Response of the surface of an elastic layer to a load: influence of one loaded pixel on all others.

The kernel of a pixel is that of the half-space in closed form (Love 1929; Cerruti; Johnson, Contact
Mechanics, sections 3.2 and 3.6) and a smooth correction for the layer of thickness h, bonded to a rigid base.
Directions: x along columns, y upwards, z into the gel. A kernel states the displacement at an offset from
the pixel that bears 1 Pa: "xz" is the displacement along x by pressure; that along z by a traction along x is
its mirror image (reciprocity).
"""

from __future__ import annotations

import functools
import math
import threading
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit import run
from tactile_toolkit.value_types import Float32, Float64

NAMES = ("zz", "xx", "yy", "xy", "xz", "yz")

_SIGNS = {"zz": (1, 1), "xx": (1, 1), "yy": (1, 1), "xy": (-1, -1), "xz": (1, -1), "yz": (-1, 1)}
"""Sign of a kernel at mirrored offsets along y and along x."""

_FARTHEST_WAVE = 18.0  # wave numbers of the correction, times h: it has fallen to exp(-2 * 18) there
_NODES, _NODES_PER_RADIUS = 48, 10  # of the integral over waves; per radius, as its waves get shorter
_RADII_PER_LAYER = 64
_CACHED = 16  # windows whose tables are kept, 0.6 MB each at 86 x 64 pixels

Complex64: TypeAlias = NDArray[np.complex64]
Complex128: TypeAlias = NDArray[np.complex128]
Kernels: TypeAlias = dict[str, Float64]
"""By name: displacement per pressure, m / Pa, shape (H, W), at offsets of 0 or more pixels along y and x."""

_making = threading.Lock()


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """An elastic layer under a window of pixels.

    Attributes
    ----------
    lengths : tuple of int
        Lengths of the Fourier transforms along y and x.
    inward : ndarray of complex64, shape (Y, X)
        Transform of the displacement along z by pressure, "zz".
    along, across : ndarray of complex64, shape (2, Y, X), (Y, X)
        Those by traction: "xx" and "yy", and "xy".
    aside : ndarray of complex64, shape (2, Y, X)
        Those of the displacement along x and y by pressure, "xz" and "yz".
    stencils : ndarray of float32, shape (3, 4)
        Approximate pressure and tractions along x and y for a displacement: weights of a pixel, of its
        neighbours along x and along y, and of its diagonal neighbours, Pa / m.
    own_shear : float
        Displacement of a pixel by its own traction, m / Pa.
    """

    lengths: tuple[int, int]
    inward: Complex64
    along: Complex64
    across: Complex64
    aside: Complex64
    stencils: Float32
    own_shear: float


@functools.lru_cache(maxsize=_CACHED)
def layer_of(
    shape: tuple[int, int],
    pixel_m: tuple[float, float],
    shear_pa: float,
    poisson_ratio: float,
    layer_m: float,
) -> Layer:
    """Return the tables of a layer; the arguments are those of :func:`pixel_kernels`."""
    # A stencil reaches over three pixels, also in smaller windows.
    shape = (max(shape[0], 3), max(shape[1], 3))
    # The last bits depend on the number of threads.
    with _making, run.one_blas_thread():
        kernels = pixel_kernels(shape, pixel_m, shear_pa, poisson_ratio, layer_m)
        stencils = np.array([_stencil(kernels[name]) for name in ("zz", "xx", "yy")], np.float32)
    lengths, spectra = transforms(kernels)
    own = float(kernels["xx"][0, 0] + kernels["yy"][0, 0]) / 2
    single = {name: spectrum.astype(np.complex64) for name, spectrum in spectra.items()}
    return Layer(
        lengths,
        single["zz"],
        np.stack([single["xx"], single["yy"]]),
        single["xy"],
        np.stack([single["xz"], single["yz"]]),
        stencils,
        own,
    )


def transforms(kernels: Kernels) -> tuple[tuple[int, int], dict[str, Complex128]]:
    """Return lengths of Fourier transforms along y and x, and those of the kernels, of the real kind along x.

    The transforms are so long that a window and the influence of its pixels do not overlap.
    """
    from scipy.fft import next_fast_len, rfft2

    rows, columns = kernels["zz"].shape
    lengths = (next_fast_len(2 * rows - 1, True), next_fast_len(2 * columns - 1, True))
    spectra = {}
    for name, (sign_y, sign_x) in _SIGNS.items():
        whole = np.zeros(lengths)
        whole[:rows, :columns] = kernels[name]
        whole[:rows, -columns + 1 :] = sign_x * kernels[name][:, :0:-1]
        whole[-rows + 1 :] = sign_y * whole[rows - 1 : 0 : -1]
        spectra[name] = rfft2(whole)
    return lengths, spectra


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
        Kernels by name, float64, shape ``shape``: "zz", "xx", "yy" are even along both axes, "xy" is odd
        along both, "xz" odd along x and "yz" odd along y.
    """
    kernels = _half_space(shape, pixel_m, poisson_ratio)
    if math.isfinite(layer_m):
        for name, kernel in _layer_correction(shape, pixel_m, poisson_ratio, layer_m).items():
            kernels[name] += kernel
    return {name: kernel / shear_pa for name, kernel in kernels.items()}


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
    sinh = 2.0 * kappa * (1.0 - fourth)
    flat = 8.0 * waves * twice
    scale = (1.0 - poisson_ratio) / waves / below
    cosh = 1.0 + fourth - 2.0 * twice
    coupled = 2.0 * (1.0 - 2.0 * poisson_ratio) * kappa * cosh - 8.0 * waves**2 * twice
    return (
        scale * (sinh - flat),
        scale * (sinh + flat),
        coupled / (2.0 * waves * below),
        np.tanh(waves) / waves,
    )


def _half_space(shape: tuple[int, int], pixel_m: tuple[float, float], poisson_ratio: float) -> Kernels:
    """Kernels of the half-space, times G: sums over the corners of the loaded pixel."""
    y, x = ((np.arange(count + 1) - 0.5) * size for count, size in zip(shape, pixel_m[::-1], strict=True))
    x, y = np.meshgrid(x, y)
    r = np.hypot(x, y)
    corners = {
        "xx": y * np.log(x + r),
        "yy": x * np.log(y + r),
        "xy": -r,
        "x": y * np.log(r) + x * np.arctan(y / x),
        "y": x * np.log(r) + y * np.arctan(x / y),
    }
    sums = {
        name: value[1:, 1:] - value[1:, :-1] - value[:-1, 1:] + value[:-1, :-1]
        for name, value in corners.items()
    }
    compressed = 1.0 - poisson_ratio
    turn = 1.0 / (2.0 * math.pi)
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
    from scipy.special import j0, j1

    y, x = (np.arange(count) * (size / layer_m) for count, size in zip(shape, pixel_m[::-1], strict=True))
    x, y = np.meshgrid(x, y)
    far = np.hypot(x, y)
    radii = np.arange(math.ceil(far[-1, -1] * _RADII_PER_LAYER) + 3) / _RADII_PER_LAYER
    nodes, weights = np.polynomial.legendre.leggauss(_NODES + math.ceil(_NODES_PER_RADIUS * radii[-1]))
    waves = (nodes + 1.0) * (_FARTHEST_WAVE / 2)
    pressed, along, coupled, across = layer_response(waves, poisson_ratio)
    compressed = 1.0 - poisson_ratio
    phases = radii[:, None] * waves
    zeroth = j0(phases)
    first = j1(phases)
    phases[0] = 1.0  # the second function is 0 there, as the first one
    second = 2.0 * first / phases - zeroth
    second[0] = 0.0
    weights *= pixel_m[0] * pixel_m[1] / (4.0 * math.pi * layer_m) * _FARTHEST_WAVE
    tables = (
        zeroth @ (weights * (waves * pressed - compressed)),
        zeroth @ (weights * (waves * (along + across) - compressed - 1.0) / 2.0),
        first @ (weights * ((0.5 - poisson_ratio) - waves * coupled)),
        second @ (weights * (waves * (along - across) - compressed + 1.0) / 2.0),
    )
    normal, even, inward, oval = (_interpolated(table, far * _RADII_PER_LAYER) for table in tables)
    far[0, 0] = 1.0
    cosine = x / far
    sine = y / far
    turned = (cosine * cosine - sine * sine) * oval
    return {
        "zz": normal,
        "xx": even - turned,
        "yy": even + turned,
        "xy": -2.0 * cosine * sine * oval,
        "xz": cosine * inward,
        "yz": sine * inward,
    }


def _interpolated(table: Float64, positions: Float64) -> Float64:
    """Return values between those of a table, by the cubic through four of them."""
    first = np.clip(positions.astype(np.int64) - 1, 0, len(table) - 4)
    t = positions - first
    a, b, c, d = (table[first + number] for number in range(4))
    return (
        -a * (t - 1) * (t - 2) * (t - 3) / 6
        + b * t * (t - 2) * (t - 3) / 2
        - c * t * (t - 1) * (t - 3) / 2
        + d * t * (t - 1) * (t - 2) / 6
    )


def _stencil(kernel: Float64) -> tuple[float, float, float, float]:
    """Return the middle row of the inverse influence of a patch of 3 x 3 pixels.

    Applied to an error of the displacement, it is nearly the load that is missing.
    """
    row, column = np.divmod(np.arange(9), 3)
    influence = kernel[np.abs(row[:, None] - row), np.abs(column[:, None] - column)]
    middle = np.linalg.inv(influence)[4]
    return middle[4], middle[5], middle[7], middle[8]
