"""From an image to the ink of a digit: a mask with one meaning only.

The mask that leaves :func:`clean` holds no speck and no pinhole, and no two of its pixels touch at a corner
alone. The numbers of bodies and holes are then the same whether corners connect or not, and the solid that is
built from the mask can be held to them.
"""

from __future__ import annotations

import math
from typing import Any, NoReturn

import numpy as np

from mnist3d.spec import SolidSpec
from tactile_toolkit import mesh
from tactile_toolkit.array_types import AnyArray, Bool, Float64, Int64, UInt8
from tactile_toolkit.errors import ItemError

MIN_SIDE_PX = 8
"""Smaller images cannot show a digit."""

SMALL_PX = 64
"""Images whose longer side is shorter would make a block of a few millimetres: they are to be resampled."""

CONTACT_PX = 3
"""A speck that touches wider ink by at most so many pixels is a speck still."""

MOST_INK = 0.5
"""More ink than such a share of an image is not a digit, but what surrounds its page."""

MOST_BORDER = 0.05
"""Ink that touches more of the border of an image is cut off, or not ink at all."""

PAPER_SHARE = 0.75
"""At least so much of the margin of an image is paper; the margin is a fiftieth of the shorter side wide."""

_CORNERS_CONNECT = np.ones((3, 3), dtype=bool)


_SENTENCES = {
    "bad-shape": "the image has shape {}; expected (H, W) with sides of {} px or more",
    "bad-dtype": "the image has dtype {}; expected grey levels (integers, floats or bool)",
    "not-finite": "{} pixels of the image are NaN or infinite; expected grey levels from 0 to 255",
    "bad-range": "grey levels run from {} to {}; expected 0 to 255, or floats from 0 to 1",
    "too-small": "the image has {} x {} px, which make {:g} mm; expected {} px or more",
    "unclear-ink": "{}: the ink cannot be distinguished from the paper, found {:.0%} of the margin light and "
    "the rest dark, expected nearly all of it to be paper",
    "one-level": "the image has one grey level only ({}); expected dark ink on light paper",
    "no-ink": "no pixel is dark enough to be ink; expected a digit",
    "all-ink": "ink covers {:.0%} of the margin of the image, which would make a slab; expected a digit on "
    "paper, with less than {:.0%} of the margin ink",
    "empty-page": "nothing on the page is as dark as ink and has edges like ink; expected a digit",
    "half-ink": "ink covers {:.0%} of the image, which would make a slab; expected at most half of it",
    "border": "ink touches {:.0%} of the border of the image; expected {:.0%} at most, and paper elsewhere",
    "several-digits": "the page shows {} digits or other pieces of ink; expected one digit",
    "cut-off": "the ink reaches the edge of the page; expected paper on all sides of the digit",
    "not-a-digit": "found {}; expected a digit, {}",
    "only-specks": "no piece of ink is as large as {} mm^2 (min_speck_mm2); expected a digit",
    "topology": "no lattice keeps the {} bodies and {} holes of the ink; the finest has {} and {}",
    "layers": "the layers of the ink, stacked, have {} bodies and {} holes; the ink has {} and {}",
    "vertex-budget": "the digit needs {:,} vertices to keep its {} bodies and {} holes; {:,} were asked for, "
    "and at most {:g} times as many are given",
}
_NEXT = {
    "too-small": "solidify(..., resample=True) draws it again with 500",
    "unclear-ink": "give dark or light (--foreground, ink=), or crop the image",
    "all-ink": "give ink='light' if the ink is the lighter part, or leave room around the digit",
    "several-digits": "cut the picture so that each digit has its own file, or cover the rest",
    "cut-off": "take the picture again with room around the digit, or cut away what surrounds the page",
    "not-a-digit": "leave the picture out, or photograph the digit from nearer, in even light",
    "empty-page": "leave the picture out, or photograph the digit from nearer, in even light",
    "half-ink": "give ink='light' if the ink is the lighter part, or crop the image to its page",
    "border": "leave room around the digit, or crop the image to its page",
    "layers": "leave the digit out, or try method='fast'",
    "vertex-budget": "ask for {5:,} (target_vertices, --vertices)",
}


def refuse(reason: str, *found: Any, sentence: str = "") -> NoReturn:
    """Raise the ItemError of a reason, or of one of its sentences, with what was found."""
    key = sentence or reason
    raise ItemError(reason, _SENTENCES[key].format(*found), next=_NEXT.get(key, "").format(*found))


def ink_of_levels(levels: UInt8, threshold: float | None = None) -> Bool:
    """Return ink (True) from paper, in grey levels from 0 (ink) to 255 (paper).

    Pixels up to the threshold are ink; by default that is Otsu's of the image. Raises ItemError ``no-ink`` or
    ``all-ink``, the latter also when the margin is ink for the most part.
    """
    darkest, lightest = int(levels.min()), int(levels.max())
    if threshold is None and lightest == darkest:
        refuse("no-ink" if darkest > 127 else "all-ink", darkest, sentence="one-level")
    mask = levels <= (otsu_threshold(levels) if threshold is None else threshold)
    if not mask.any():
        refuse("no-ink")
    paper = float(1 - margin(mask).mean())
    if mask.all() or paper <= 1 - PAPER_SHARE:
        refuse("all-ink", 1 - paper, PAPER_SHARE)
    require_paper_around(mask)
    return mask


def require_paper_around(mask: Bool) -> None:
    """Refuse ink that covers more than half of an image, or touches a twentieth of its border.

    Raises ItemError ``all-ink`` or ``cut-off``.
    """
    covered = np.count_nonzero(mask) / mask.size
    if covered > MOST_INK:
        refuse("all-ink", covered, sentence="half-ink")
    border = np.concatenate([mask[0], mask[-1], mask[1:-1, 0], mask[1:-1, -1]])
    touched = float(border.mean())
    if touched > MOST_BORDER:
        refuse("cut-off", touched, MOST_BORDER, sentence="border")


def margin(values: AnyArray) -> AnyArray:
    """Return the pixels along the edge of an image, a fiftieth of the shorter side wide."""
    wide = max(1, min(values.shape) // 50)
    middle = values[wide:-wide]
    parts = (values[:wide], values[-wide:], middle[:, :wide], middle[:, -wide:])
    return np.concatenate([part.ravel() for part in parts])


def paper_is_dark(levels: UInt8, threshold: int, where: str) -> bool:
    """Return whether the margin, which is paper, is dark; `where` names the image.

    Raises ItemError ``unclear-ink`` when less than three quarters of it are on one side of the threshold.
    """
    light = float((margin(levels) > threshold).mean())
    if 1 - PAPER_SHARE < light < PAPER_SHARE:
        refuse("unclear-ink", where, light)
    return light <= 1 - PAPER_SHARE


def levels_and_threshold(pixels: AnyArray, ink: str) -> tuple[UInt8, int | None]:
    """Turn an image of any number type into grey levels from 0 (ink) to 255 (paper).

    Integers are levels from 0 to 255, floats run from 0 to 1 or to 255, bool has two levels. With ``"auto"``
    the margin of the image is paper. Otsu's threshold comes with them where it is known by then. Raises
    ItemError ``bad-shape``, ``bad-dtype``, ``not-finite``, ``bad-range`` or ``unclear-ink``.
    """
    levels = as_levels(pixels)
    threshold = otsu_threshold(levels) if ink == "auto" and levels.min() < levels.max() else None
    if ink == "light" or (threshold is not None and paper_is_dark(levels, threshold, "the image")):
        return 255 - levels, None
    return levels, threshold


def as_levels(pixels: AnyArray) -> UInt8:
    """Turn an image of any number type into grey levels from 0 to 255; ItemError where it has none."""
    image = np.asarray(pixels)
    if image.ndim != 2 or min(image.shape) < MIN_SIDE_PX:
        refuse("bad-shape", image.shape, MIN_SIDE_PX)
    if image.dtype == np.uint8:
        return image
    if image.dtype == np.bool_:
        return np.where(image, np.uint8(255), np.uint8(0))
    if image.dtype.kind not in "iuf":
        refuse("bad-dtype", image.dtype)
    if not np.isfinite(image).all():
        refuse("not-finite", int((~np.isfinite(image)).sum()))
    if image.min() < 0 or image.max() > 255:
        refuse("bad-range", image.min(), image.max())
    if image.dtype.kind == "f" and image.max() <= 1:
        image = image.astype(np.float64) * 255
    return np.round(image).astype(np.uint8)


def otsu_threshold(levels: UInt8) -> int:
    """Return the highest level of the darker of the two groups that differ most (Otsu 1979)."""
    # scikit-image finds the same, but importing it costs every process up to a second.
    # Most of a page is white: the rest is counted.
    counts = np.bincount(levels[levels < 255], minlength=256).astype(np.float64)
    counts[255] = levels.size - counts.sum()
    below = np.cumsum(counts)
    weighted = np.cumsum(counts * np.arange(256))
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = (weighted[-1] * below / below[-1] - weighted) ** 2 / (below * (below[-1] - below))
    return int(np.nanargmax(np.where(np.isfinite(spread), spread, -1.0)))


def clean(mask: Bool, spec: SolidSpec) -> Bool:
    """Take away specks and pinholes and settle contacts at corners, so that 4- and 8-connectivity agree.

    Specks go also where they touch a stroke by a few pixels: they would become fins that no printer makes.

    Raises ItemError ``no-ink`` when nothing but specks was there.
    """
    speck_px, pinhole_px = (
        area / spec.pixel_pitch_mm**2 for area in (spec.min_speck_mm2, spec.min_pinhole_mm2)
    )
    cleaned = np.zeros_like(mask)
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows):
        # Only the window that holds ink is worked on: most of a page is paper.
        window = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
        # Corners first: whole pieces that go later cannot leave a new contact at a corner behind.
        inked = repair_corners(np.pad(mask[window], 1))
        # The first piece is the padding and the paper around the digit, which is not a pinhole.
        inked = ~_without_small(~inked, pinhole_px, first_stays=True)
        inked = _without_small(inked, speck_px)
        cleaned[window] = _without_attached_specks(inked, speck_px)[1:-1, 1:-1]
    if not cleaned.any():
        refuse("no-ink", spec.min_speck_mm2, sentence="only-specks")
    return cleaned


def repair_corners(mask: Bool) -> Bool:
    """Fill one pixel wherever two pixels of ink touch at a corner alone; ink is only ever added."""
    mask = mask.copy()
    while True:
        upper_left, upper_right = mask[:-1, :-1], mask[:-1, 1:]
        lower_left, lower_right = mask[1:, :-1], mask[1:, 1:]
        falling = upper_left & lower_right & ~upper_right & ~lower_left
        rising = upper_right & lower_left & ~upper_left & ~lower_right
        if not (falling.any() or rising.any()):
            return mask
        mask[1:, :-1] |= falling
        mask[1:, 1:] |= rising


def _without_small(mask: Bool, min_px: float, *, first_stays: bool = False) -> Bool:
    """Drop the pieces smaller than a limit; the first one may stay whatever its size."""
    runs, piece = _pieces(mask)
    small = np.bincount(piece, runs[:, 2] - runs[:, 1])[piece] < min_px
    if first_stays:
        small[piece == 0] = False
    if small.any():
        mask = mask.copy()
        for row, begin, end in runs[small].tolist():
            mask[row, begin:end] = False
    return mask


def _pieces(mask: Bool) -> tuple[Int64, Int64]:
    """Return the runs of marked pixels, (row, begin, end) each, and the first run of the piece of each."""
    from mnist3d import kernels

    runs, touching = kernels.runs(mask)
    return runs, mesh.connected(touching[:, 0], touching[:, 1], len(runs))


def _without_attached_specks(mask: Bool, min_px: float) -> Bool:
    """Drop what would be a speck but for a few pixels by which it touches the side of wider ink.

    A thin stroke of the pen reaches further than a round speck of the limit is wide, and stays; so does a
    tip, which sits on ink that grows narrower. The paper around the mask must be one pixel wide.
    """
    from scipy import ndimage

    # What reaches two pixels beyond ink of five pixels is not the roughness of an outline.
    wide = _opened(mask, 2)
    beyond = mask & ~grown(wide)
    if not beyond.any():
        return mask
    cleaned, sides = mask.copy(), grown(_opened(mask, 6))
    labels, _ = ndimage.label(mask & ~wide)
    for label in np.unique(labels[beyond]):
        piece = labels == label
        rows, columns = np.nonzero(piece)
        contact = wide & grown(piece, corners=False)
        is_small = math.pi / 4 * max(np.ptp(rows) + 1, np.ptp(columns) + 1) ** 2 < min_px
        touches = contact.sum() <= CONTACT_PX and not (contact & ~sides).any()
        # Two contacts make a bridge.
        if is_small and touches and ndimage.label(contact, _CORNERS_CONNECT)[1] == 1:
            cleaned &= ~piece
    return repair_corners(cleaned)


def _opened(mask: Bool, radius_px: int) -> Bool:
    """Keep what octagons within the mask cover; they are ``2 * radius_px + 1`` pixels wide."""
    # Shifts of the whole mask take a twelfth of the time of scipy's opening (0.5 and 5.6 ms at radius 6).
    # With and without corners in turn, squares and diamonds add up to octagons.
    paper = ~mask
    for step in range(radius_px):
        paper = grown(paper, corners=step % 2 == 0)
    ink = ~paper
    for step in range(radius_px):
        ink = grown(ink, corners=step % 2 == 0)
    return ink


def grown(mask: Bool, *, corners: bool = True) -> Bool:
    """Widen what is marked by a pixel to all sides, and where corners connect also to those."""
    wider = mask.copy()
    wider[1:] |= mask[:-1]
    wider[:-1] |= mask[1:]
    across = wider.copy() if corners else mask
    wider[:, 1:] |= across[:, :-1]
    wider[:, :-1] |= across[:, 1:]
    return wider


def count_bodies_and_holes(mask: Bool) -> tuple[int, int]:
    """Count the pieces of clean ink and the spots of paper that ink encloses; outside the mask is paper."""
    runs, piece = _pieces(mask)
    bodies = int(np.count_nonzero(piece == np.arange(len(runs))))
    # Bodies less holes are corners less sides and squares of what the centres of neighbouring pixels span.
    beside, below = mask[:, 1:] & mask[:, :-1], mask[1:] & mask[:-1]
    sides = np.count_nonzero(beside) + np.count_nonzero(below)
    euler = np.count_nonzero(mask) - sides + np.count_nonzero(beside[1:] & beside[:-1])
    return bodies, bodies - int(euler)


def join_bodies(mask: Bool, width_px: float) -> Bool:
    """Join pieces of clean ink by straight bars until one is left, so that the digit prints in one piece.

    Each round joins the first piece to the one nearest to it, where the two come closest. A bar reaches into
    the ink at both ends by half its width, so that the joint is as wide as the bar.
    """
    from scipy import ndimage
    from scipy.spatial import cKDTree

    while True:
        labels, count = ndimage.label(mask)
        if count < 2:
            return mask
        # Of all pixels, not of outlines: the nearest of two pieces lie on their outlines anyway.
        here, there = (np.argwhere(part).astype(np.float64) for part in (labels == 1, labels > 1))
        found = cKDTree(there).query(here)
        distances, nearest = np.asarray(found[0]), np.asarray(found[1])
        # Two straight edges are close along a stretch: its middle makes a better bridge than its end.
        close = np.flatnonzero(distances <= distances.min() + 0.5)
        middle = int(close[len(close) // 2])
        mask = repair_corners(mask | _bar(mask.shape, here[middle], there[nearest[middle]], width_px))


def _bar(shape: tuple[int, ...], start: Float64, end: Float64, width_px: float) -> Bool:
    length = float(np.hypot(*(end - start)))
    along = (end - start) / length
    rows, columns = np.ogrid[: shape[0], : shape[1]]
    down, across = rows - start[0], columns - start[1]
    way = down * along[0] + across * along[1]
    aside = across * along[0] - down * along[1]
    # Half a pixel on top joins pieces that lie diagonally, however thin the bar.
    half = max(width_px / 2, 0.75)
    return np.asarray((np.abs(aside) <= half) & (way >= -half) & (way <= length + half))
