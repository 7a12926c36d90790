"""Grey levels: of images of any type and size, and of coloured drawings; and which of them are paper.

Grey levels alone lose light colours: the grey of an orange sun is nearer to white paper than to a black
outline. In coloured drawings a pixel is compared with the paper by its largest difference in a channel.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NoReturn

import numpy as np
import scipy  # loads its parts when they are used: those of pictures take a third of a second
from PIL import Image

from tactile_toolkit.arithmetic import exp_neg
from tactile_toolkit.errors import ItemError
from tactile_toolkit.value_types import AnyArray, Bool, Float32, Floating, UInt8
from tactile_toolkit.wording import with_count

_SENTENCES = {
    "bad-shape": "the image has shape {}; expected (H, W) with sides of {} px or more",
    "bad-dtype": "the image has dtype {}; expected grey levels (integers, floats or bool)",
    "not-finite": "{}: found NaN or infinity in {}, expected finite levels",
    "bad-pixels": "{}: found pixels from {:g} to {:g}, expected 0 to {:g}",
    "too-small": "the image has {} x {} px, so that the solid would be {:g} mm long; expected {} px or more",
    "unclear-ink": "{}: the ink cannot be distinguished from the paper, found {:.0%} of the margin light and "
    "the rest dark, expected nearly all of it to be paper",
    "one-level": "the image has one grey level only ({}); expected dark ink on light paper",
    "no-ink": "no pixel is dark enough to be ink; expected a digit",
    "all-ink": "ink covers {:.0%} of the margin of the image, which would make a slab; expected a digit on "
    "paper, with less than {:.0%} of the margin ink",
    "empty-page": "no part of the page is as dark as ink and has edges like ink; expected a digit",
    "half-ink": "ink covers {:.0%} of the image, which would make a slab; expected at most {:.0%} of it",
    "border": "ink touches {:.0%} of the border of the image; expected {:.0%} at most, and paper elsewhere",
    "several-digits": "the page shows {} digits or other pieces of ink; expected one digit",
    "cut-off": "the ink reaches the edge of the page; expected paper on all sides of the digit",
    "drawing-cut-off": "much ink, or something thicker than the strokes, reaches the edge of the page; "
    "expected paper there",
    "not-a-digit": "found {}; expected {} for a digit",
    "only-specks": "no piece of ink is as large as {} mm^2 (min_speck_mm2); expected a digit",
    "topology": "no lattice keeps the topology of the ink (bodies: {}, holes: {}); the finest has {} and {}",
    "layers": "the stack of layers has another topology than the ink (bodies: {}, holes: {}); the ink has {} "
    "and {}",
    "vertex-budget": "the digit needs {:,} vertices to keep its topology (bodies: {}, holes: {}); the budget "
    "is {:,}, and at most {:g} times as many are allowed",
}
_NEXT = {
    "bad-shape": "give one image of grey levels, at least as large",
    "bad-dtype": "convert the image to uint8, from 0 to 255",
    "not-finite": "repair or rescale this image in the file, or leave it out",
    "bad-pixels": "repair or rescale this image in the file, or leave it out",
    "too-small": "leave pixel_mm out, or give a larger image",
    "unclear-ink": "give dark or light (ink=, --foreground), or crop the image",
    "all-ink": "give ink='light' (--foreground light) if the ink is lighter, or leave room around it",
    "several-digits": "cut the picture so that each digit has its own file, or cover the rest",
    "cut-off": "take the picture again with room around the digit, or cut away what surrounds the page",
    "drawing-cut-off": "take the picture again without fingers and with room around the page, or cut away "
    "what surrounds it",
    "not-a-digit": "leave the picture out, or photograph the digit from closer, in even light",
    "empty-page": "leave the picture out, or photograph the digit from closer, in even light",
    "only-specks": "make the solid larger, or draw with a thicker pen",
    "half-ink": "give ink='light' (--foreground light) if the ink is lighter, or crop the image to its page",
    "border": "leave room around the digit, or crop the image to its page",
    "layers": "leave the digit out, or try method='fast'",
    "vertex-budget": "raise target_vertices (--vertices) to {5:,}",
}

MIN_SIDE_PX = 8
"""Smaller images cannot show a digit."""

SMALL_PX = 64
"""Least length of the longer side; smaller images would make a block of a few millimetres."""

PAPER_SHARE = 0.75
"""Least share of the margin of an image that is paper; the margin is 1/50 of the shorter side wide."""

MAX_INK, MAX_DRAWN = 0.5, 0.95
"""Ink that covers more of an image than this share surrounds its page, and is no digit, or no drawing."""

MAX_BORDER = 0.05
"""Ink that touches more of the border of an image than this share is cut off, or not ink at all."""

_WHITE = 255

_SLACK = 0.5 / _WHITE
"""Values may lie half a level outside the scale, by rounding when a file was written."""

DIFFERENT = 32
"""Least difference of ink from paper in one channel, grey levels; noise of JPEG near edges is half of it."""

CHROMATIC = 0.15
"""Least difference between the reflectances of channels where ink of a photograph has a colour."""

_SQUARE = np.ones((3, 3), bool)

# Largest range of levels within 3 x 3 pixels of an evenly coloured part.
_EVEN = 16

# Pixels that an edge is wide; ink is compared with the darkest ink so near.
_EDGE_PX = 3

# Limits for a graphic: largest difference of paper from its level, least level of paper, least share of the
# margin that is paper, and of the picture that is paper or ink.
_SAME = 8
_LIGHT = 200
_EVEN_MARGIN = 0.95
_PLAIN = 0.97

# Longer side at which these shares are exact enough.
_ENOUGH_PX = 700

# Least share of the picture that grey levels lose before colours are compared.
_LOST = 2e-4

SIDE_PX = 500
"""Side of the square sheet that every source returns: 100 mm at the published 0.2 mm per pixel."""

# Samples per original pixel at which the ink is smoothed before it is drawn.
_MESH = 5

# Standard deviation of that blur, original pixels.
_BLUR_PX = 0.6
_PAPER = 255


def refuse(reason: str, *figures: object, sentence: str = "") -> NoReturn:
    """Raise the ItemError of a reason; ``sentence`` chooses another message of the same reason."""
    key = sentence or reason
    raise ItemError(reason, _SENTENCES[key].format(*figures), next=_NEXT.get(key, "").format(*figures))


def as_levels(pixels: AnyArray) -> UInt8:
    """Convert an image of any number type to grey levels from 0 to 255.

    Integers are levels from 0 to 255, floats run from 0 to 1 or to 255, bool has two levels. Raises ItemError
    ``bad-shape``, ``bad-dtype``, ``not-finite`` or ``bad-pixels``.
    """
    image = np.asarray(pixels)
    if image.ndim != 2 or min(image.shape) < MIN_SIDE_PX:
        refuse("bad-shape", image.shape, MIN_SIDE_PX)
    if image.dtype == np.uint8:
        return image
    if image.dtype.kind not in "biuf":
        refuse("bad-dtype", image.dtype)
    full_scale = _WHITE
    if image.dtype.kind in "bf" and image.max() <= 1:
        full_scale = 1
    return as_grey(image, full_scale, "the image")


def as_grey(values: AnyArray, full_scale: float, picture_name: str) -> UInt8:
    """Convert brightness, 0 for black and `full_scale` for white, to the nearest grey levels.

    `picture_name` names file and row. Raises ItemError ``"not-finite"`` for NaN or infinite values, and
    ``"bad-pixels"`` for values more than half a grey level outside the scale.
    """
    if values.dtype == np.uint8 and full_scale == _WHITE:
        return np.array(values, order="C")
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        refuse("not-finite", picture_name, with_count(int(np.count_nonzero(~np.isfinite(values))), "pixels"))
    low, high = float(values.min()), float(values.max())
    slack = full_scale * _SLACK
    if low < -slack or high > full_scale + slack:
        refuse("bad-pixels", picture_name, low, high, full_scale)
    if values.dtype.kind in "iu" and full_scale == _WHITE:
        return values.astype(np.uint8, order="C")
    levels = np.rint(values.astype(np.float64) * (_WHITE / full_scale))
    return np.clip(levels, 0, _WHITE).astype(np.uint8, order="C")


def dark_on_light(pixels: AnyArray, ink: str) -> tuple[UInt8, int | None]:
    """Return grey levels in which ink is dark, and their Otsu threshold if it was computed.

    With ``"auto"`` the margin of the image is paper. Raises ItemError ``unclear-ink``, and the reasons of
    :func:`as_levels`.
    """
    levels = as_levels(pixels)
    threshold = None
    if ink == "auto" and levels.min() < levels.max():
        threshold = otsu_threshold(levels)
    if ink == "light" or (threshold is not None and paper_is_dark(levels, threshold, "the image")):
        return _WHITE - levels, None
    return levels, threshold


def margin(values: AnyArray) -> AnyArray:
    """Return the pixels along the edge of an image, 1/50 of the shorter side wide."""
    wide = max(1, min(values.shape) // 50)
    middle = values[wide:-wide]
    parts = (values[:wide], values[-wide:], middle[:, :wide], middle[:, -wide:])
    return np.concatenate([part.ravel() for part in parts])


def paper_is_dark(levels: UInt8, threshold: int, picture_name: str) -> bool:
    """Return whether the margin, which is paper, is dark; `picture_name` names the image.

    Raises ItemError ``unclear-ink`` when less than three quarters of it are on one side of the threshold.
    """
    light = float((margin(levels) > threshold).mean())
    if 1 - PAPER_SHARE < light < PAPER_SHARE:
        refuse("unclear-ink", picture_name, light)
    return light <= 1 - PAPER_SHARE


def otsu_threshold(levels: UInt8) -> int:
    """Return the highest level of the darker of the two groups that differ most (Otsu 1979)."""
    # Most of a page is white, so only the rest is counted.
    counts = np.bincount(levels[levels < 255], minlength=256).astype(np.float64)
    counts[255] = levels.size - counts.sum()
    below = np.cumsum(counts)
    weighted = np.cumsum(counts * np.arange(256))
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = (weighted[-1] * below / below[-1] - weighted) ** 2 / (below * (below[-1] - below))
    return int(np.nanargmax(np.where(np.isfinite(spread), spread, -1.0)))


def require_paper_around(mask: Bool, most_ink: float = MAX_INK) -> None:
    """Refuse ink that covers more than a share of an image, or touches more than 1/20 of its border.

    Raises ItemError ``all-ink`` or ``cut-off``.
    """
    covered = np.count_nonzero(mask) / mask.size
    if covered > most_ink:
        refuse("all-ink", covered, most_ink, sentence="half-ink")
    border = np.concatenate([mask[0], mask[-1], mask[1:-1, 0], mask[1:-1, -1]])
    touched = float(border.mean())
    if touched > MAX_BORDER:
        refuse("cut-off", touched, MAX_BORDER, sentence="border")


def unlike_paper(colours: UInt8) -> UInt8:
    """Return how much each pixel differs from the paper: the largest difference in a channel.

    Parameters
    ----------
    colours : ndarray of uint8, shape (H, W, C)
        The paper has the median colour of the margin.

    Returns
    -------
    ndarray of uint8, shape (H, W)
    """
    paper = np.median(
        np.stack([margin(colours[..., channel]) for channel in range(colours.shape[2])]), axis=1
    )
    difference = np.abs(colours.astype(np.int16) - paper.astype(np.int16)).max(axis=2)
    return np.asarray(difference, np.uint8)


def is_graphic(colours: UInt8) -> bool:
    """Return whether a picture is a graphic on light paper, such as a logo, however much of it is ink.

    Its paper has one level up to the margin, and only the edges of its ink lie between paper and ink.
    """
    step = max(1, max(colours.shape) // _ENOUGH_PX)
    colours = np.atleast_3d(colours)[::step, ::step]
    difference = unlike_paper(colours)
    is_paper = difference <= _SAME
    is_ink = difference >= DIFFERENT
    if not is_paper.any() or colours[is_paper].min() < _LIGHT:
        return False
    return bool(margin(is_paper).mean() >= _EVEN_MARGIN and (is_paper | is_ink).mean() >= _PLAIN)


def loses_colours(difference: UInt8, dark: Bool) -> bool:
    """Return whether parts that differ from the paper are not in the ink that grey levels show."""
    lost = (difference >= DIFFERENT) & ~scipy.ndimage.binary_dilation(dark, iterations=_EDGE_PX)
    return bool(np.count_nonzero(scipy.ndimage.binary_opening(lost, _SQUARE)) > _LOST * lost.size)


def ink_of_colours(difference: UInt8) -> UInt8:
    """Return grey levels, 0 for ink of any colour and 255 for paper, from differences to the paper.

    The edge of ink lies where the difference is half of that of the ink beside it, as for black ink. Evenly
    coloured parts are ink however light they are.
    """
    side = 2 * _EDGE_PX + 1
    beside = np.maximum(scipy.ndimage.maximum_filter(difference, side), DIFFERENT).astype(np.float32)
    levels = np.rint(255 * np.clip(1 - difference / beside, 0, 1)).astype(np.uint8)
    spread = scipy.ndimage.maximum_filter(difference, 3) - scipy.ndimage.minimum_filter(difference, 3)
    even = scipy.ndimage.maximum_filter((difference >= DIFFERENT) & (spread <= _EVEN), 3)
    # Between a light part and its dark outline, the edge of the outline belongs to neither.
    inked = even | (levels < 128)
    filled = scipy.ndimage.binary_closing(inked, iterations=_EDGE_PX) & (difference >= DIFFERENT)
    levels[filled & ~(levels < 128) & scipy.ndimage.binary_dilation(even, iterations=_EDGE_PX)] = 0
    return levels


def colourfulness(reflectances: Float32) -> Float32:
    """Return how much channels of a photograph differ: much in coloured ink, little in shadows and black ink.

    Parameters
    ----------
    reflectances : ndarray of float32, shape (3, H, W)
        Channels divided by the paper around each pixel; paper is 1 in each.
    """
    # A blur of a pixel removes the noise of cameras, which is coloured.
    smooth = [scipy.ndimage.gaussian_filter(channel, 1.0) for channel in reflectances]
    return np.asarray(np.max(smooth, axis=0) - np.min(smooth, axis=0), np.float32)


def fit(pixels: UInt8, side: int = SIDE_PX) -> UInt8:
    """Fit a dark-on-light image of any size into a square sheet: aspect kept, centred on white paper.

    Larger images are shrunk with antialiasing, smaller ones go through :func:`enlarge`. An image of the size
    of the sheet, 500 x 500 px by default, is returned unchanged.
    """
    height, width = pixels.shape
    if height == width == side:
        return pixels
    scale = side / max(height, width)
    height, width = max(1, round(height * scale)), max(1, round(width * scale))
    if scale > 1:
        resized = enlarge(pixels, (height, width))
    else:
        resized = np.asarray(Image.fromarray(pixels).resize((width, height), Image.Resampling.LANCZOS))
    sheet = np.full((side, side), _PAPER, np.uint8)
    top, left = (side - height) // 2, (side - width) // 2
    sheet[top : top + height, left : left + width] = resized
    return sheet


def enlarge(pixels: UInt8, size: tuple[int, int]) -> UInt8:
    """Enlarge a small dark-on-light image so that its outlines become smooth curves, some 3 px wide.

    The outline is where the interpolating cubic spline through the pixels crosses half ink. That curve still
    winds around the pixel rows (greys of small images are often clipped), so the ink it bounds is smoothed by
    a Gaussian of 0.6 original pixels before the outline is drawn: enough to straighten a slanted edge, too
    little to close a loop or cut a stroke of one pixel.
    """
    ink = 1 - pixels.astype(np.float32) / np.float32(_PAPER)
    rows, columns = (_spline_matrix(count) for count in ink.shape)
    solid = np.clip((_both_ways(rows, columns, ink) - 0.5) * 4 + 0.5, 0, 1)
    down, across = (_blur_matrix(count, out) for count, out in zip(ink.shape, size, strict=True))
    levels = _both_ways(down, across, solid)
    # The blur has widened the edge; it is made steeper again about half ink.
    gain = max(1.0, _BLUR_PX * size[0] / ink.shape[0])
    levels -= np.float32(0.5)
    levels *= np.float32(-_PAPER * gain)
    levels += np.float32(_PAPER / 2)
    np.clip(levels, 0, _PAPER, out=levels)
    return np.rint(levels, out=levels).astype(np.uint8)


def _centres(count: int, out: int) -> Floating:
    """Return the centres of `out` pixels in the coordinates of `count` pixels over the same length."""
    return (np.arange(out) + 0.5) * (count / out) - 0.5


def _cubic_basis(count: int, at: Floating) -> Floating:
    """Return cubic B-splines of `count` knots at some positions; outer knots are repeated beyond the edge."""
    margin = 3
    t = np.abs(at[:, None] - np.arange(-margin, count + margin))
    beyond = np.clip(2 - t, 0, None)
    bumps: Floating = np.where(t < 1, 2 / 3 - t * t + t * t * t / 2, beyond * beyond * beyond / 6)
    basis: Floating = bumps[:, margin : margin + count].copy()
    basis[:, 0] += bumps[:, :margin].sum(axis=1)
    basis[:, -1] += bumps[:, margin + count :].sum(axis=1)
    return basis


def _both_ways(down: scipy.sparse.csr_array, across: scipy.sparse.csr_array, values: AnyArray) -> Float32:
    return np.ascontiguousarray((down @ (across @ values.T).T), dtype=np.float32)


# Both matrices depend on sizes only, and cost more to build than to use. Most sources have one size.
@lru_cache(maxsize=8)
def _spline_matrix(count: int) -> scipy.sparse.csr_array:
    knots = _cubic_basis(count, np.arange(count, dtype=np.float64))
    fine = _cubic_basis(count, _centres(count, count * _MESH))
    return _sparse(_solved(knots.T, fine.T).T)


def _solved(matrix: Floating, right: Floating) -> Floating:
    """Solve equations with a tridiagonal, diagonally dominant matrix."""
    # LAPACK rounds differently on other processors.
    pivots = matrix.diagonal().copy()
    left = right.copy()
    for row in range(1, len(matrix)):
        share = matrix[row, row - 1] / pivots[row - 1]
        pivots[row] -= share * matrix[row - 1, row]
        left[row] -= share * left[row - 1]
    left[-1] /= pivots[-1]
    for row in range(len(matrix) - 2, -1, -1):
        left[row] = (left[row] - matrix[row, row + 1] * left[row + 1]) / pivots[row]
    return left


@lru_cache(maxsize=8)
def _blur_matrix(count: int, out: int) -> scipy.sparse.csr_array:
    fine = count * _MESH
    distance = (_centres(fine, out)[:, None] - np.arange(fine)) / (_BLUR_PX * _MESH)
    return _sparse(exp_neg(0.5 * distance * distance))


def _sparse(weights: Floating) -> scipy.sparse.csr_array:
    """Keep the weights that matter, and scale each row to a sum of 1.

    Sparse products sum in a fixed order. The order of dense products depends on the number of threads, so the
    same image would give other bytes on a busy machine.
    """
    near = np.where(np.abs(weights) > 1e-5, weights, 0)
    return scipy.sparse.csr_array((near / near.sum(axis=1, keepdims=True)).astype(np.float32))
