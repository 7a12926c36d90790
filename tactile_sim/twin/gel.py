"""The gel of a twin: where the solid holds it, it takes its shape; around that it leaves it smoothly.

As in Taxim (Si and Yuan, IEEE Robotics and Automation Letters 7 (2), 2022, section IV), the gel is blurred by
Gaussians of falling width, and after each of them takes the shape of the solid again where it is in contact.
Here the greatest width, the last one, and the share of the press depth from which the solid is in contact are
fitted, and the edge of the contact is as wide as a pixel, so that images change smoothly with all of them.
"""

from __future__ import annotations

from enum import IntEnum
from typing import TypeAlias

import numpy as np

from tactile_sim.taxim_kernels import LANES, blur
from tactile_sim.twin import gel_kernels
from tactile_toolkit.arithmetic import exp_neg
from tactile_toolkit.array_types import Float32, Float64, Int64

_WIDTHS = 6  # Taxim has as many, each about half of the one before it
_REACH = 4.0  # standard deviations of the gel's kernels
_COARSE_PX = 4.0  # standard deviation down to which a map is shrunk before it is blurred
_CAMERA_REACH = 3.0
_LEAST_RIM_M = 1e-6
_MARGIN = 0.12  # of the width of an image
_EDGE = 0.7  # press depth in which the contact begins, in pixels: slopes there are about 1


class Fitted(IntEnum):
    """Places of the geometry of a twin in a vector.

    Logarithms of the sides of the image over those of the first guess; the radial term of the lens; thickness
    of the gel, greatest width of its blur, last width, metres; share of the press depth from which the solid
    is in contact; blur of the camera, metres on the gel.
    """

    WIDE = 0
    HIGH = 1
    LENS = 2
    GEL = 3
    WIDTH = 4
    LAST = 5
    CONTACT = 6
    BLUR = 7


LEAST = np.array([-1.0, -1.0, -0.3, 1e-4, 1e-4, 1e-5, 0.05, 1e-6])
MOST = np.array([1.0, 1.0, 0.3, 0.05, 5e-3, 5e-4, 0.95, 5e-4])
"""Bounds of a geometry."""

WHOLE = np.ones(2)
"""Share of the image, along x and y, of a map that shows all of it."""

Seen: TypeAlias = tuple[Int64, Float32]
"""Entries of the response that each pixel takes part in, and their shares."""


def half_kernel(sigma_px: float, longest: int, reach: float = _CAMERA_REACH) -> Float64:
    """Return half of a Gaussian kernel from the middle on, of at most ``longest`` weights."""
    taps = min(int(np.ceil(reach * sigma_px)) + 1, longest)
    place = np.arange(max(taps, 1)) / max(sigma_px, 1e-3)
    weights = exp_neg(0.5 * place * place)
    total = weights[0]
    for weight in weights[1:]:
        total = total + 2 * weight
    return np.asarray(weights / total)


def margin_px(width_px: int) -> int:
    """Return how many pixels beyond an image its gel is followed: what is pressed in there pulls at it."""
    return round(_MARGIN * width_px)


def gel_surface(
    indentation_m: Float64, pitch_m: Float64, shape: Float64, margin: int = 0, span: Float64 = WHOLE
) -> Float64:
    """Return the surface of the gel as it is seen, (H, W), metres, 0 at rest, negative where pressed in.

    ``indentation_m`` is how far the solid reaches into the gel at rest, with ``margin`` pixels on each side,
    where it counts as no higher than within the image; ``pitch_m`` the size of a pixel; ``span`` the share of
    the image that is shown. The lens is that of ``shape``.
    """
    if margin:
        inner = indentation_m[margin:-margin, margin:-margin]
        indentation_m = np.minimum(indentation_m, inner.max())
    held, contact = np.empty(indentation_m.shape), np.empty(indentation_m.shape)
    edge_m = _EDGE * float(pitch_m[0])
    gel_kernels.touching(contact, held, indentation_m, shape[Fitted.CONTACT], edge_m)
    soft = held.copy()
    for level in range(_WIDTHS):
        blur_gel(soft, shape[Fitted.WIDTH] * 0.5**level / pitch_m)
        gel_kernels.hold(soft, held, contact)
    blur_gel(soft, shape[Fitted.LAST] / pitch_m)
    return seen_through(soft, pitch_m, float(shape[Fitted.LENS]), margin, span)


def own_surface(
    pressed_m: Float64, pitch_m: Float64, shape: Float64, margin: int = 0, span: Float64 = WHOLE
) -> Float64:
    """Return the surface of an elastic gel as it is seen; arguments are as of :func:`gel_surface`.

    ``pressed_m`` is how far the gel itself is pressed in, negative where it rises; only the last blur, which
    is of the skin of the gel, is added.
    """
    soft = np.ascontiguousarray(-pressed_m)
    blur_gel(soft, shape[Fitted.LAST] / pitch_m)
    return seen_through(soft, pitch_m, float(shape[Fitted.LENS]), margin, span)


def seen_through(
    surface: Float64, pitch_m: Float64, lens: float, margin: int = 0, span: Float64 = WHOLE
) -> Float64:
    """Return a map with a margin as it is seen through the lens, without the margin."""
    if not lens:
        return np.ascontiguousarray(
            surface[margin : len(surface) - margin, margin : surface.shape[1] - margin]
        )
    out = np.empty(tuple(side - 2 * margin for side in surface.shape))
    gel_kernels.bend_surface(out, surface, span, margin, lens, across_of(pitch_m, out.shape, span))
    return out


def across_of(pitch_m: Float64, size: tuple[int, ...], span: Float64 = WHOLE) -> float:
    """Return the share of the width in the square of the diagonal of the image, of a part of it (H, W)."""
    wide, high = size[1] * pitch_m[0] / span[0], size[0] * pitch_m[1] / span[1]
    return float(wide * wide / (wide * wide + high * high))


def blur_gel(soft: Float64, sigma_px: Float64) -> None:
    """Blur a map in place; wide blurs are done on a smaller map, whose pixels the next one smooths."""
    factor = max(int(sigma_px.min() // _COARSE_PX), 1)
    small = soft
    if factor > 1:
        small = np.empty(tuple(max(-(-side // factor), LANES) for side in soft.shape))
        gel_kernels.shrink(small, soft, factor)
        # Means of squares, and lines between them, blur too.
        sigma_px = np.sqrt(np.square(sigma_px) - factor**2 / 4) / factor
    rows, columns = small.shape
    across, down = half_kernel(sigma_px[0], columns, _REACH), half_kernel(sigma_px[1], rows, _REACH)
    blur(small, across, down, 1, np.zeros(small.shape, np.bool_), small)
    if factor > 1:
        gel_kernels.grow(soft, small, factor)


def rim_m(soft: Float64, shape: Float64) -> float:
    """Return the depth of the gel at which the contact begins, metres, of a surface as it is seen."""
    return max(-float(shape[Fitted.CONTACT] * soft.min()), _LEAST_RIM_M)


def seen_features(soft: Float64, pitch_m: Float64, shape: Float64) -> Seen:
    """Return which entries of the response each pixel of a surface takes part in."""
    entries = np.empty((soft.size, gel_kernels.ACTIVE), np.int64)
    shares = np.empty(entries.shape, np.float32)
    gel_kernels.features(soft, pitch_m, shape[Fitted.LENS], rim_m(soft, shape), entries, shares)
    return entries, shares


def response(
    seen: Seen, size: tuple[int, int], coefficients: Float64, sigma_px: Float64, span: Float64
) -> Float64:
    """Return the change of the image, levels, shape (H, W, 3); ``size`` is (H, W)."""
    out = np.empty((*size, 3))
    gel_kernels.write_response(out, *seen, coefficients, span)
    blur_colours(out, sigma_px)
    return out


def blur_colours(image: Float64, sigma_px: Float64) -> None:
    """Blur an image (H, W, k) in place, by standard deviations along x and y."""
    rows, columns, many = image.shape
    plane = image.reshape(rows, many * columns)
    across, down = half_kernel(sigma_px[0], columns), half_kernel(sigma_px[1], rows)
    blur(plane, across, down, many, np.zeros(plane.shape, np.bool_), plane)
