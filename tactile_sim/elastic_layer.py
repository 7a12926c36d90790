"""Response of the surface of an elastic layer to a load: influence of one loaded pixel on all others.

The kernel of a pixel is that of the half-space in closed form (Love 1929; Cerruti; Johnson, Contact
Mechanics, sections 3.2 and 3.6) and a smooth correction for the layer of thickness h, bonded to a rigid base.
Directions: x along columns, y upwards, z into the gel. A kernel states the displacement at an offset from
the pixel that bears 1 Pa: "xz" is the displacement along x by pressure; that along z by a traction along x is
its mirror image (reciprocity).
"""

from __future__ import annotations

import functools
import itertools
import math
from typing import TypeAlias

import numpy as np

from tactile_sim import elastic_response, elastic_tables
from tactile_toolkit import arithmetic
from tactile_toolkit.array_types import Float32, Float64, Int64

NAMES = ("zz", "xx", "yy", "xy", "xz", "yz")

_FARTHEST_WAVE = 18.0  # wave numbers of the correction, times h: it has fallen to exp(-2 * 18) there
_NODES, _NODES_PER_RADIUS = 48, 10  # of the integral over waves; per radius, as its waves get shorter
_RADII_PER_LAYER = 64
_NEWTON_STEPS = 5
_LOG_2 = math.log(2.0)
_LOGARITHM_TERMS, _ARCTANGENT_TERMS, _EXPONENTIAL_TERMS, _SQUARINGS = 11, 9, 6, 10
_CACHED = 16  # windows whose kernels are kept, 1 MB each at 86 x 64 pixels

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
    twice = _exponential(2.0 * waves)
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
        Kernels by name, float64, shape ``shape``: "zz", "xx", "yy" are even along both axes, "xy" is odd
        along both, "xz" odd along x and "yz" odd along y.
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
    r = np.sqrt(x * x + y * y)
    log_r = _logarithm(r)
    corners = {
        "xx": y * _logarithm(x + r),
        "yy": x * _logarithm(y + r),
        "xy": -r,
        "x": y * log_r + x * _arctangent(y / x),
        "y": x * log_r + y * _arctangent(x / y),
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
    y, x = (np.arange(count) * (size / layer_m) for count, size in zip(shape, pixel_m[::-1], strict=True))
    x, y = np.meshgrid(x, y)
    far = np.sqrt(x * x + y * y)
    count = math.ceil(float(far[-1, -1]) * _RADII_PER_LAYER) + 3
    radii = np.arange(count) / _RADII_PER_LAYER
    waves, weights = _gauss_legendre(_NODES + math.ceil(_NODES_PER_RADIUS * float(radii[-1])))
    waves, weights = (waves + 1.0) * (_FARTHEST_WAVE / 2), weights * (_FARTHEST_WAVE / 2)
    pressed, along, coupled, across = layer_response(waves, poisson_ratio)
    compressed = 1.0 - poisson_ratio
    integrands = np.stack(
        [
            waves * pressed - compressed,
            (waves * (along + across) - compressed - 1.0) / 2.0,
            (0.5 - poisson_ratio) - waves * coupled,
            (waves * (along - across) - compressed + 1.0) / 2.0,
        ]
    )
    scale = pixel_m[0] * pixel_m[1] / (2.0 * math.pi * layer_m)
    tables = elastic_tables.bessel_integrals(radii, waves, scale * weights * integrands)
    pressed, even, inward, oval = (_interpolated(table, far * _RADII_PER_LAYER) for table in tables)
    x, y = (np.divide(each, far, out=np.zeros_like(far), where=far > 0) for each in (x, y))
    turned = (x * x - y * y) * oval
    return {
        "zz": pressed,
        "xx": even - turned,
        "yy": even + turned,
        "xy": -2.0 * x * y * oval,
        "xz": x * inward,
        "yz": y * inward,
    }


def _interpolated(table: Float64, places: Float64) -> Float64:
    """Return values between those of a table, by the cubic through four of them."""
    first = np.clip(places.astype(np.int64) - 1, 0, len(table) - 4)
    t = places - first
    a, b, c, d = (table[first + number] for number in range(4))
    return (
        -a * (t - 1) * (t - 2) * (t - 3) / 6
        + b * t * (t - 2) * (t - 3) / 2
        - c * t * (t - 1) * (t - 3) / 2
        + d * t * (t - 1) * (t - 2) / 6
    )


def _gauss_legendre(count: int) -> tuple[Float64, Float64]:
    """Return nodes and weights of the Gauss-Legendre rule on -1 to 1, by Newton's method."""
    guesses = [
        arithmetic.cosine_sine(math.pi * (number + 0.75) / (count + 0.5))[0] for number in range(count)
    ]
    nodes = np.array(guesses)
    for _ in range(_NEWTON_STEPS):
        before, here = np.ones(count), nodes
        for order in range(2, count + 1):
            before, here = here, ((2 * order - 1) * nodes * here - (order - 1) * before) / order
        slope = count * (nodes * here - before) / (nodes * nodes - 1.0)
        nodes = nodes - here / slope
    return nodes, 2.0 / ((1.0 - nodes * nodes) * slope * slope)


def _logarithm(values: Float64) -> Float64:
    """Return the natural logarithm of positive numbers."""
    fraction, exponent = np.frexp(values)
    is_small = fraction < math.sqrt(0.5)
    fraction, exponent = np.where(is_small, 2.0 * fraction, fraction), exponent - is_small
    part = (fraction - 1.0) / (fraction + 1.0)
    return exponent * _LOG_2 + 2.0 * _odd_series(part, 1.0, _LOGARITHM_TERMS)


def _arctangent(values: Float64) -> Float64:
    """Return the arctangent: the angle is halved three times, so that its series is short."""
    size = np.abs(values)
    part = np.minimum(size, 1.0 / size)
    for _ in range(3):
        part = part / (1.0 + np.sqrt(1.0 + part * part))
    angle = 8.0 * _odd_series(part, -1.0, _ARCTANGENT_TERMS)
    return np.copysign(np.where(size > 1.0, math.pi / 2 - angle, angle), values)


def _odd_series(part: Float64, sign: float, terms: int) -> Float64:
    square, total = sign * part * part, np.zeros_like(part)
    for term in range(terms, -1, -1):
        total = total * square + 1.0 / (2 * term + 1)
    return part * total


def _exponential(exponents: Float64) -> Float64:
    """Return exp(-exponents): Taylor's series of a 1,024th, squared ten times."""
    small, total = exponents * (-(0.5**_SQUARINGS)), np.ones_like(exponents)
    for term in range(_EXPONENTIAL_TERMS, 0, -1):
        total = 1.0 + total * small / term
    for _ in range(_SQUARINGS):
        total = total * total
    return total


def transform_of(count: int) -> elastic_response.Transform:
    """Return the plan of a transform that is long enough to convolve ``count`` pixels with a kernel."""
    length = min(
        2**twos * 3**threes
        for twos, threes in itertools.product(range(1, 14), range(4))
        if 2**twos * 3**threes >= 2 * count - 1
    )
    radices, rest = [], length
    for radix in (4, 3, 2):
        while rest % radix == 0:
            radices.append(radix)
            rest //= radix
    places, step, reach = np.zeros(length, np.int64), 1, length
    frequency = np.arange(length)
    twiddles = []
    for radix in radices:
        whole = reach
        reach //= radix
        places += frequency // step % radix * reach
        step *= radix
        for number, power in itertools.product(range(reach), range(1, radix)):
            cosine, sine = arithmetic.cosine_sine(2.0 * math.pi * number * power / whole)
            twiddles += [cosine, -sine]
    return elastic_response.Transform(
        length, np.array(radices, np.int64), np.array(twiddles, np.float32), places
    )


@functools.lru_cache(maxsize=_CACHED)
def layer_of(
    shape: tuple[int, int],
    pixel_m: tuple[float, float],
    shear_pa: float,
    poisson_ratio: float,
    layer_m: float,
) -> elastic_response.Layer:
    """Return a layer whose kernels are transformed; those of the last few windows are kept."""
    kernels = pixel_kernels(shape, pixel_m, shear_pa, poisson_ratio, layer_m)
    # Kernels write fields in their whole width, also those of few columns.
    width = field_width(shape[1])
    down, across = transform_of(shape[0]), transform_of(max(shape[1], width // 2 + 1))
    # Two fields are transformed as one, and come out twice as large.
    scale = 0.5 / (down.length * across.length)
    waves = np.arange(_padded(down.length // 2 + 1, elastic_response.LANES))
    waves[down.length // 2 + 1 :] = 0
    frequencies = np.empty(across.length, np.int64)
    frequencies[across.places] = np.arange(across.length)
    tables = [
        (_even_waves(waves, shape[0], down.length), _even_waves(frequencies, shape[1], across.length)),
        (_odd_waves(waves, shape[0], down.length), _odd_waves(frequencies, shape[1], across.length)),
    ]

    def spectrum(name: str) -> Float32:
        odd_y, odd_x = name in ("xy", "yz"), name in ("xy", "xz")
        rows = elastic_tables.product(tables[odd_y][0], kernels[name])
        found = scale * elastic_tables.product(rows, np.ascontiguousarray(tables[odd_x][1].T))
        if name == "xy":
            found = -found
        lanes = found.reshape(-1, elastic_response.LANES, across.length).transpose(0, 2, 1)
        return np.ascontiguousarray(lanes, np.float32).reshape(-1)

    near = np.zeros((2 * shape[0] - 1, 2 * width - 1), np.float32)
    rows, columns = (np.abs(np.arange(1 - count, count)) for count in shape)
    near[:, width - shape[1] : width + shape[1] - 1] = kernels["zz"][rows[:, None], columns[None]]
    own = float(kernels["xx"][0, 0] + kernels["yy"][0, 0]) / 2
    spectra = {name: spectrum(name) for name in NAMES}
    return elastic_response.Layer(across, down, **spectra, near=near.reshape(-1), own_shear=own)


def field_width(columns: int) -> int:
    """Return the width of a field: each half of it is made of whole vectors."""
    return _padded(columns, 2 * elastic_response.LANES)


def _padded(count: int, step: int) -> int:
    return -(-count // step) * step


def _even_waves(frequencies: Int64, count: int, length: int) -> Float64:
    cosines: Float64 = _circle(length)[0][np.outer(frequencies, np.arange(count)) % length]
    cosines[:, 1:] *= 2.0
    return cosines


def _odd_waves(frequencies: Int64, count: int, length: int) -> Float64:
    sines: Float64 = _circle(length)[1][np.outer(frequencies, np.arange(count)) % length]
    return 2.0 * sines


def _circle(length: int) -> Float64:
    return np.array([arithmetic.cosine_sine(2.0 * math.pi * part / length) for part in range(length)]).T
