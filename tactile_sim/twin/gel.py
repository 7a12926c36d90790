"""The gel of a twin: it has the shape of the solid in contact, and leaves it smoothly around the contact.

An elastic gel is a layer whose contact is solved. Any other is a surface that is pulled down by the solid. As
in Taxim (Si and Yuan, IEEE Robotics and Automation Letters 7 (2), 2022, section IV), the gel is blurred by
Gaussians of falling width. After each but the last of them, it takes the shape of the solid again where it is
in contact. Here, the greatest width, the last width, the share of the press depth from which the solid is
in contact, and how far the gel rises around a contact are fitted. The edge of the
contact is about as wide as a pixel, so that images change smoothly with all of them.
"""

from __future__ import annotations

from enum import IntEnum
from functools import lru_cache
from typing import TypeAlias

import numpy as np

from tactile_sim.elastic.contact import MAX_LAYERS, Gel, contact_problem, require_residual, surface_of
from tactile_sim.optics import taxim_kernels
from tactile_sim.press.elastic_press import SOLVED_M
from tactile_sim.twin import gel_kernels, surface_kernels, view_kernels
from tactile_toolkit.arithmetic import exp_neg
from tactile_toolkit.value_types import Float32, Float64, Floating, Int64

_WIDTHS = 6  # as in Taxim
_NARROWER = 0.5  # each width over the previous one, about that of Taxim
_REACH = 4.0  # of the gel's kernels, in standard deviations
# Standard deviations in pixels from which a map is halved before it is blurred, and from which it is halved
# again: a smaller map is mirrored at an edge that lies farther away.
_HALVED_PX = (3.7, 7.0)
_MIN_HALVED_PX = 32  # sides of maps that are halved
_CAMERA_REACH = 3.0
_MARGIN = 0.18  # of the width of an image, 3.4 mm for a GelSight Mini
_SMOOTH = 0.02  # standard deviation by which colours at rest are blurred, of the width
_LIGHT_PX = 100  # width of the maps of light; the penumbra is about as wide as their pixels
_REACHES_M = np.geomspace(2.5e-4, 8e-3, 15)  # at which the gel is compared with a pixel
_EDGE = 0.7  # range of depth in which contact begins, in pixels: slopes there are about 1
_FAR_M = 1.0  # below the highest point of a solid, out of reach of the gel
_AROUND = 1.25  # how far around a contact a gel rises, in its thicknesses, standard deviation
_LEAST = np.array([-1.0, -0.3, 1e-4, 1e-4, 1e-5, 0.05, 1e-6, 0.0, -0.5, 0.0, 1.05, 0.05, -1.0, -0.5])
_MOST = np.array([1.0, 0.3, 0.05, 5e-3, 5e-4, 0.95, 5e-4, 60.0, 1.5, 0.499, 2.5, 1.5, 1.5, 0.5])

WHOLE = np.ones(2)
"""Share of the image, along x and y, of a map that shows all of it."""

Features: TypeAlias = tuple[Int64, Float32]
"""Entries of the response that each pixel depends on, by their first coefficients, and their shares."""


class Fitted(IntEnum):
    """Indices of the values of a geometry in its vector.

    ``SIZE`` is the logarithm of the sides of the image over those of the first guess, ``LENS`` is the radial
    term of the lens, ``GEL`` the thickness of the gel, ``WIDTH`` the greatest width of its blur
    and ``LAST`` the last one, metres; ``CONTACT`` is the share of the press depth from which the solid is in
    contact, ``BLUR`` the blur of the camera, metres on the gel, ``CAMERA`` one over the distance of the
    camera from the gel, 1 / metres, and ``RISE`` the share of the volume pressed in by which the gel rises.
    ``POISSON`` is Poisson's ratio of an elastic gel, of which width, contact and rise mean nothing, and 0 of
    any other. ``LAMP_DISTANCE`` is the distance of lamps from the middle of the image, in halves of its
    diagonal, and ``LAMP_HEIGHT`` the height of which theirs above the gel are multiples, over this distance.
    A lamp faces the middle: it sends less light elsewhere by ``LOBE`` times the squared sine of the angle.
    ``FADE`` is how far above its middle what hides half of a lamp reaches, over the same height.
    """

    SIZE = 0
    LENS = 1
    GEL = 2
    WIDTH = 3
    LAST = 4
    CONTACT = 5
    BLUR = 6
    CAMERA = 7
    RISE = 8
    POISSON = 9
    LAMP_DISTANCE = 10
    LAMP_HEIGHT = 11
    LOBE = 12
    FADE = 13


OF_THE_LAMPS = (Fitted.LAMP_DISTANCE, Fitted.LAMP_HEIGHT, Fitted.LOBE, Fitted.FADE)
OF_THE_VIEW = (Fitted.LENS, Fitted.BLUR, Fitted.CAMERA, *OF_THE_LAMPS)
"""Values that change how a gel is seen, and not how it is pressed."""


def bounded(shape: Float64, half_m: Float64, width_px: int) -> Float64:
    """Return the nearest geometry that can be rendered; ``half_m`` are half the sides of the image.

    The contact of an elastic gel that is thinner than a pixel, or has more layers than tables of the solver
    suffice for, is not solved.
    """
    least = _LEAST.copy()
    if shape[Fitted.POISSON] > 0:
        thinnest_m = max(np.hypot(*half_m) / (MAX_LAYERS / 2), 2 * half_m[0] / width_px)
        least[Fitted.GEL] = min(thinnest_m, _MOST[Fitted.GEL])
    return np.clip(shape, least, _MOST)


def unbent(shape: Float64) -> Float64:
    """Return a geometry without lens and perspective, for maps that are already seen through them."""
    return np.where(np.isin(np.arange(len(shape)), (Fitted.LENS, Fitted.CAMERA)), 0.0, shape)


def half_kernel(sigma_px: float, longest: int, reach: float = _CAMERA_REACH) -> Float64:
    """Return half of a Gaussian kernel, from the middle outwards, with at most ``longest`` weights."""
    taps = min(int(np.ceil(reach * sigma_px)) + 1, longest)
    distance = np.arange(max(taps, 1)) / max(sigma_px, 1e-3)
    weights = exp_neg(0.5 * distance * distance)
    total = weights[0]
    for weight in weights[1:]:
        total = total + 2 * weight
    return np.asarray(weights / total)


def margin_px(width_px: int) -> int:
    """Return by how many pixels the gel extends beyond the image: indentations there deform it inside."""
    return round(_MARGIN * width_px)


def gel_surface(
    indentation_m: Floating, pitch_m: Float64, shape: Float64, margin: int = 0, span: Float64 = WHOLE
) -> Float32:
    """Return the surface of the gel as it is seen, (H, W), metres, 0 at rest, negative where pressed in.

    ``indentation_m`` is how far the solid reaches into the gel at rest, with ``margin`` pixels on each side,
    where it counts as no higher than within the image; ``pitch_m`` the size of a pixel; ``span`` the share of
    the image that is shown. The lens is that of ``shape``.
    """
    pressed = pressed_surface(indentation_m, pitch_m, shape, margin)
    return seen_through(pressed, pitch_m, shape, margin, span)


def pressed_surface(indentation_m: Floating, pitch_m: Float64, shape: Float64, margin: int = 0) -> Float32:
    """Return the surface of the gel with its margin, before the camera sees it; see :func:`gel_surface`."""
    press = _elastic_surface if shape[Fitted.POISSON] else _pulled_surface
    return press(indentation_m, pitch_m, shape, margin)


def _elastic_surface(indentation_m: Floating, pitch_m: Float64, shape: Float64, margin: int) -> Float32:
    """Return the surface of an elastic layer that a solid is pressed into."""
    rows, columns = indentation_m.shape
    greatest_m = float(indentation_m[margin : rows - margin, margin : columns - margin].max())
    thickness_m = float(shape[Fitted.GEL])
    block_px = max(1, int(min(SOLVED_M, thickness_m / 4) / max(pitch_m)))
    sides = [(0, -side % block_px) for side in (rows, columns)]
    body_m = np.pad(np.minimum(indentation_m, greatest_m).astype(np.float64), sides)
    blocks = body_m.reshape(len(body_m) // block_px, block_px, -1, block_px).mean(axis=(1, 3))
    soft = np.zeros(indentation_m.shape, np.float32)
    deepest_m = float(blocks.max())
    if deepest_m > 0:
        size_m = tuple((block_px * pitch_m).tolist())
        # Where the solid does not reach the gel at rest, the gel may rise.
        below_m = np.where(blocks > 0, deepest_m - blocks, _FAR_M)
        material = Gel(poisson_ratio=float(shape[Fitted.POISSON]), friction=0.0)
        problem = contact_problem(
            below_m,
            size_m,
            material,
            thickness_m,
            (deepest_m, False),
            np.zeros((2, *blocks.shape)),
        )
        solution = problem.solve()
        require_residual(solution.error, solution.iterations)
        into_m, _ = surface_of(solution.fields[5:7], np.where(body_m > 0, body_m, -np.inf), block_px)
        soft[:] = -into_m[:rows, :columns]
    surface_kernels.soften(soft, soft, gel_blur(shape[Fitted.LAST] / pitch_m, soft.shape), 0)
    return soft


def _pulled_surface(indentation_m: Floating, pitch_m: Float64, shape: Float64, margin: int) -> Float32:
    """Return the surface of a gel that is pulled down around a solid, by Gaussians."""
    sigmas_m = [*(shape[Fitted.WIDTH] * _NARROWER ** np.arange(_WIDTHS)), shape[Fitted.LAST]]
    blurs = tuple(gel_blur(sigma_m / pitch_m, indentation_m.shape) for sigma_m in sigmas_m)
    # Pixels around the image that are seen: three, and more through a lens with a positive term.
    bent = 0.0 if shape[Fitted.LENS] < 0 else shape[Fitted.LENS]
    around_px = 3 + int(bent * max(indentation_m.shape) / 2)
    insets = []
    for blur in reversed(blurs):
        around_px += max(len(blur.across), len(blur.down)) << blur.halvings
        insets.append(max(margin - around_px, 0))
    share = float(shape[Fitted.CONTACT])
    edge_m = _EDGE * float(pitch_m[0])
    around = gel_blur(_AROUND * shape[Fitted.GEL] / pitch_m, indentation_m.shape)
    rise = float(shape[Fitted.RISE])
    return surface_kernels.press_gel(
        indentation_m, margin, blurs, tuple(reversed(insets)), around, rise, share, edge_m
    )


def own_surface(
    pressed_m: Floating, pitch_m: Float64, shape: Float64, margin: int = 0, span: Float64 = WHOLE
) -> Float32:
    """Return the surface of an elastic gel as it is seen; the arguments are those of :func:`gel_surface`.

    ``pressed_m`` is how far the gel itself is pressed in, negative where it rises; only the last blur, that
    of the skin of the gel, is applied.
    """
    soft = np.asarray(-pressed_m, np.float32, order="C")
    surface_kernels.soften(soft, soft, gel_blur(shape[Fitted.LAST] / pitch_m, soft.shape), 0)
    return seen_through(soft, pitch_m, shape, margin, span)


def seen_through(
    surface: Floating, pitch_m: Float64, shape: Float64, margin: int = 0, span: Float64 = WHOLE
) -> Float32:
    """Return heights with a margin, metres, as the camera sees them through the lens, without the margin."""
    lens = float(shape[Fitted.LENS])
    camera = float(shape[Fitted.CAMERA])
    if not lens and not camera:
        return np.ascontiguousarray(
            surface[margin : len(surface) - margin, margin : surface.shape[1] - margin]
        )
    out = np.empty(tuple(side - 2 * margin for side in surface.shape), np.float32)
    across = _across_of(pitch_m, out.shape, span)
    surface_kernels.bend_surface(out, surface, span, margin, lens, camera, across)
    return out


def _across_of(pitch_m: Float64, size: tuple[int, ...], span: Float64) -> float:
    """Return the squared width over the squared diagonal of an image of which a part (H, W) is shown."""
    wide = size[1] * pitch_m[0] / span[0]
    high = size[0] * pitch_m[1] / span[1]
    return float(wide * wide / (wide * wide + high * high))


@lru_cache(maxsize=256)
def _blur(
    sigma_px: tuple[float, float], size: tuple[int, int], reach: float, halved_px: float
) -> surface_kernels.Blur:
    (sigma_x, sigma_y), (rows, columns), halvings = sigma_px, size, 0
    while min(sigma_x, sigma_y) >= halved_px and columns >= _MIN_HALVED_PX:
        # Halving and doubling blur too: each has a variance of 3 / 4 square pixels.
        sigma_x, sigma_y = (np.sqrt(sigma * sigma - 1.5) / 2 for sigma in (sigma_x, sigma_y))
        rows = (rows + 1) // 2
        columns = (columns + 1) // 2
        halvings = halvings + 1
        halved_px = _HALVED_PX[1]
    across = half_kernel(sigma_x, columns, reach)
    down = half_kernel(sigma_y, rows, reach)
    return surface_kernels.Blur(halvings, across.astype(np.float32), down.astype(np.float32))


def gel_blur(sigma_px: Float64, size: tuple[int, ...]) -> surface_kernels.Blur:
    """Return the kernels of a blur of the gel from its standard deviations along x and y."""
    return _blur((float(sigma_px[0]), float(sigma_px[1])), (size[0], size[1]), _REACH, _HALVED_PX[0])


def view_of(
    size: tuple[int, ...], pitch_m: Float64, shape: Float64, span: Float64 = WHOLE
) -> view_kernels.SurfaceView:
    """Return how a surface (H, W) of a size is seen through the lens of ``shape``."""
    (pitch_x, pitch_y), (span_x, span_y) = pitch_m.tolist(), span.tolist()
    across = _across_of(pitch_m, size, span)
    lens, camera = shape[[Fitted.LENS, Fitted.CAMERA]].tolist()
    half_x, half_y = size[1] * pitch_x / (2 * span_x), size[0] * pitch_y / (2 * span_y)
    distance, height, lobe, fade = shape[[*OF_THE_LAMPS]].tolist()
    ring_m = distance * float(np.hypot(half_x, half_y))
    lamp_m = height * ring_m
    lamps = ring_m, lamp_m, lobe, fade * lamp_m
    return view_kernels.SurfaceView(pitch_x, pitch_y, span_x, span_y, lens, across, camera, *lamps)


def surface_features(
    soft: Float32, pitch_m: Float64, shape: Float64, lamps: Int64 = gel_kernels.ALL_LAMPS
) -> Features:
    """Return the entries of the response that each pixel of a surface depends on, and their shares.

    An entry is the index of its first coefficient; those of ``lamps`` are the last ones.
    """
    entries = np.empty((soft.size, gel_kernels.SLOPED + len(lamps)), np.int64)
    shares = np.empty(entries.shape, np.float32)
    light, scale = _lamp_light(soft, pitch_m, shape, lamps)
    view = view_of(soft.shape, pitch_m, shape)
    gel_kernels.features(soft, light, scale, view, lamps, entries, shares)
    return entries, shares


def position_terms(at_rest: Float32, span: Float64 = WHOLE, mean: Floating | None = None) -> Float32:
    """Return the terms of each pixel, (H, W, TERMS), from the image of the gel at rest (H, W, 3).

    Colours at rest tell how bright each lamp is at a place: the response grows with them. ``span`` is the
    share of the image that is shown, and ``mean`` its mean colours, by default those of ``at_rest``.
    """
    rows, columns, _ = at_rest.shape
    x = span[0] * (np.arange(1, 2 * columns, 2) / columns - 1)
    y = span[1] * (1 - np.arange(1, 2 * rows, 2) / rows)
    out = np.empty((rows, columns, gel_kernels.TERMS), np.float32)
    across, up = np.broadcast_arrays(x, y[:, None])
    for term, values in enumerate((1.0, across, up, across * across, across * up, up * up)):
        out[..., term] = values
    smooth = at_rest.astype(np.float32)
    blur_colours(smooth, _SMOOTH * columns / span[0] * np.ones(2))
    means = at_rest.mean(axis=(0, 1)) if mean is None else mean
    out[..., gel_kernels.COLOURS :] = smooth / np.maximum(means, 1.0)
    return out


def _lamp_light(
    soft: Float32, pitch_m: Float64, shape: Float64, lamps: Int64, span: Float64 = WHOLE
) -> tuple[Float32, float]:
    """Return the light of lamps on a map of at most :data:`_LIGHT_PX`, and how much smaller the map is."""
    scale = 1.0
    while soft.shape[1] > _LIGHT_PX and len(soft) >= _MIN_HALVED_PX:
        soft = surface_kernels.halved(soft)
        scale /= 2
    view = view_of(soft.shape, pitch_m / scale, shape, span)
    # Back through the lens, to first order: light goes straight, and a camera sees the tops of walls moved.
    back = np.where(np.isin(np.arange(len(shape)), (Fitted.LENS, Fitted.CAMERA)), -shape, shape)
    flat = seen_through(soft, pitch_m / scale, back, span=span)
    return gel_kernels.lamp_light(soft, flat, view, _REACHES_M, lamps), scale


def response_table(coefficients: Floating) -> Float32:
    """Return coefficients (COEFFICIENTS, 3) in the layout of :func:`response`."""
    table = np.zeros((gel_kernels.ENTRIES, gel_kernels.TERMS, 4), np.float32)
    slopes, lamps = np.split(coefficients, [-gel_kernels.LAMPS])
    table[: gel_kernels.SLOPES, :, :3] = slopes.reshape(-1, gel_kernels.TERMS, 3)
    table[gel_kernels.SLOPES :, 0, :3] = lamps
    return table.reshape(len(table), -1)


def response(
    soft: Float32,
    pitch_m: Float64,
    shape: Float64,
    table: Float32,
    terms: Float32,
    span: Float64 = WHOLE,
) -> Float32:
    """Return how a surface changes the image, levels, (H, W, 3).

    ``table`` is a :func:`response_table`, and ``terms`` are the :func:`position_terms` of its pixels.
    """
    out = np.empty((*soft.shape, 3), np.float32)
    lamps = np.flatnonzero(table[gel_kernels.SLOPES :].any(axis=1))
    light, scale = _lamp_light(soft, pitch_m, shape, lamps, span)
    view = view_of(soft.shape, pitch_m, shape, span)
    gel_kernels.render_response(out, soft, light, scale, view, terms, table, lamps)
    blur_colours(out, shape[Fitted.BLUR] / pitch_m)
    return out


def blur_colours(image: Float32, sigma_px: Float64) -> None:
    """Blur an image (H, W, k) in place, by standard deviations along x and y."""
    rows, columns, many = image.shape
    blur = _blur((float(sigma_px[0]), float(sigma_px[1])), (rows, columns), _CAMERA_REACH, np.inf)
    plane = image.reshape(rows, many * columns)
    taxim_kernels.blur(plane, blur.across, blur.down, many, None, plane)
