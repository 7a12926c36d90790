"""The ink of a digit as an unambiguous mask.

The mask that :func:`clean` returns has no specks, no pinholes and no two pixels that touch at a corner only.
Its numbers of bodies and holes are the same whether corners connect or not, so the solid can be compared with
them.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import ndimage

from mnist3d.compiled_loops import runs_of
from mnist3d.ink.refusals import refuse
from mnist3d.solid_spec import SolidSpec
from tactile_toolkit import mesh
from tactile_toolkit.array_types import Bool, Int64

CONTACT_PX = 3
"""Largest number of pixels at which a speck may touch wider ink."""

_CORNERS_CONNECT = np.ones((3, 3), dtype=bool)


def clean(mask: Bool, spec: SolidSpec) -> Bool:
    """Remove specks and pinholes, and repair corner contacts, so that 4- and 8-connectivity agree.

    Specks that touch a stroke by a few pixels are removed, too: they would become fins that no printer makes.

    Raises ItemError ``no-ink`` if there were only specks.
    """
    speck_px, pinhole_px = (
        area / spec.pixel_pitch_mm**2 for area in (spec.min_speck_mm2, spec.min_pinhole_mm2)
    )
    cleaned = np.zeros_like(mask)
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows):
        # Only the window with ink is processed: most of a page is paper.
        window = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
        # Corners first: removing whole pieces later makes no new corner contact.
        inked = repair_corners(np.pad(mask[window], 1))
        # The first piece is the paper around the digit, which is not a pinhole.
        inked = ~_without_small(~inked, pinhole_px, first_stays=True)
        inked = _without_small(inked, speck_px)
        cleaned[window] = _without_attached_specks(inked, speck_px)[1:-1, 1:-1]
    if not cleaned.any():
        refuse("no-ink", spec.min_speck_mm2, sentence="only-specks")
    return cleaned


def repair_corners(mask: Bool) -> Bool:
    """Fill one pixel wherever two pixels of ink touch at a corner only; no ink is removed."""
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
    """Remove pieces smaller than a limit; the first may stay whatever its size."""
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
    """Return the runs of marked pixels, (row, begin, end) each, and for each the first run of its piece."""
    runs, touching = runs_of(mask)
    return runs, mesh.connected(touching[0], touching[1], len(runs))


def _without_attached_specks(mask: Bool, min_px: float) -> Bool:
    """Remove specks that touch the side of wider ink by a few pixels.

    A thin stroke stays, as it is longer than a round speck of the limit is wide. A tip stays, as it sits on
    ink that grows narrower. The mask must have a border of paper, one pixel wide.
    """
    # The roughness of an outline does not reach two pixels beyond ink that is five pixels wide.
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
        # Ink with two contacts is a bridge.
        if is_small and touches and ndimage.label(contact, _CORNERS_CONNECT)[1] == 1:
            cleaned &= ~piece
    return repair_corners(cleaned)


def _opened(mask: Bool, radius_px: int) -> Bool:
    """Open a mask (erode, then dilate it) by an octagon that is ``2 * radius_px + 1`` pixels wide."""
    # Shifts of the whole mask take 1/12 of the time of scipy's opening (0.5 and 5.6 ms at radius 6).
    # Steps with and without corners in turn add up to octagons.
    paper = ~mask
    for step in range(radius_px):
        paper = grown(paper, corners=step % 2 == 0)
    ink = ~paper
    for step in range(radius_px):
        ink = grown(ink, corners=step % 2 == 0)
    return ink


def grown(mask: Bool, *, corners: bool = True) -> Bool:
    """Dilate a mask by a pixel to its sides and, if corners connect, to its corners."""
    wider = mask.copy()
    wider[1:] |= mask[:-1]
    wider[:-1] |= mask[1:]
    across = wider.copy() if corners else mask
    wider[:, 1:] |= across[:, :-1]
    wider[:, :-1] |= across[:, 1:]
    return wider


def count_bodies_and_holes(mask: Bool) -> tuple[int, int]:
    """Count the pieces of clean ink and the paper spots that ink encloses; outside the mask is paper."""
    runs, piece = _pieces(mask)
    bodies = int(np.count_nonzero(piece == np.arange(len(runs))))
    # Euler's formula over pixel centres: bodies - holes = centres - sides + squares.
    beside, below = mask[:, 1:] & mask[:, :-1], mask[1:] & mask[:-1]
    sides = np.count_nonzero(beside) + np.count_nonzero(below)
    euler = np.count_nonzero(mask) - sides + np.count_nonzero(beside[1:] & beside[:-1])
    return bodies, bodies - int(euler)
