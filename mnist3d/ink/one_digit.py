"""The one digit in the ink of a page, or everything that was drawn on it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from mnist3d.ink.reflectance import Ink
from mnist3d.ink.refusals import refuse
from tactile_toolkit.array_types import AnyArray, Bool, Float32, Float64, Int64

_RIM, _SPECK, _DOT = 0.05, 0.02, 0.005
"""Shares of the longer side: reach of the border of a scan, least length of a digit and of a dot."""

_PART, _THIN_PART, _GAP, _OTHER = 0.1, 0.4, 0.14, 0.2
"""Shares of the longest piece: least length and thickness of its parts, widest gap, least other digit."""

_SMALLEST, _BLOB, _WIDEST = 0.08, 0.45, 1.5
"""Least size of ink relative to the page, largest ratios of thickness to length and of width to height."""

_SOFT = 0.1
"""Least change within a pixel, as a share of the contrast, at nine tenths of the edges of ink."""

_TOUCHING, _THICK, _ALONG = 0.05, 1.5, 0.5
"""Largest share of the rim of a page that a drawing touches, its thickness there in strokes, and the share of
its own length along the rim."""

NEAR_PX = 2
"""Width of the grey edges of ink, pixels."""


def find_one_digit(mask: Bool, inside: Bool, found: Ink) -> Bool:
    """Return the ink of the one digit.

    Raises ItemError ``no-ink``, ``several-digits``, ``cut-off`` or ``not-a-digit``.
    """
    pieces = _Pieces.of(mask, inside, found)
    labels, piece, numbers, depth = pieces.labels, pieces.piece, pieces.numbers, pieces.depth
    possible = pieces.is_sharp & (pieces.spans > _SPECK * max(mask.shape))
    # Ink along the rim only is the border of a scan.
    possible &= pieces.farthest > _RIM * max(mask.shape)
    if not possible.any():
        refuse("no-ink", sentence="empty-page")
    main = int(np.where(possible, np.bincount(piece)[1:], 0).argmax())
    stroke = float(np.percentile(depth[labels == main + 1], 90))
    possible &= pieces.spans >= _PART * pieces.spans[main]
    possible &= ndimage.maximum(depth[mask], piece, numbers) >= _THIN_PART * stroke
    # Pieces near each other form one digit.
    spans, away = pieces.spans, ndimage.distance_transform_cdt(~np.isin(labels, numbers[possible]))
    groups = ndimage.maximum(ndimage.label(away <= _GAP / 2 * spans[main])[0][mask], piece, numbers)
    digits = np.unique(groups[possible & (spans >= _OTHER * spans[main])])
    if len(digits) > 1:
        refuse("several-digits", len(digits))
    digit = np.isin(labels, numbers[possible & (groups == groups[main])])
    if pieces.from_rim[digit].min() <= NEAR_PX:
        refuse("cut-off")
    _check(digit, float(depth[digit].max()), inside)
    if np.percentile(pieces.slopes[digit & pieces.edges], 10) < _SOFT:
        refuse("not-a-digit", "ink with partly blurred edges", "sharp edges, as of a pen")
    return digit


def find_drawing(mask: Bool, inside: Bool, found: Ink) -> Bool:
    """Return all ink with sharp edges, except the border of a scan and specks.

    Strokes may run to the edge of the page. Raises ItemError ``no-ink``, or ``cut-off`` if something else
    reaches it, such as a finger or the desk: it is thicker than the strokes, or touches much of the edge.
    """
    pieces = _Pieces.of(mask, inside, found)
    piece, numbers, spans = pieces.piece, pieces.numbers, pieces.spans
    sharp = pieces.is_sharp & (spans > _DOT * max(mask.shape))
    at_rim = inside & (pieces.from_rim <= NEAR_PX)
    # The border of a scan lies along the rim; parts of a drawing may lie near it, or run into it.
    along = ndimage.sum(at_rim[mask], piece, numbers) / NEAR_PX
    is_inner = (pieces.farthest > _RIM * max(mask.shape)) | (along < _ALONG * spans)
    if not (sharp & is_inner).any():
        refuse("no-ink", sentence="empty-page")
    depth = pieces.depth
    stroke = float(np.percentile(depth[np.isin(pieces.labels, numbers[sharp & is_inner])], 90))
    # A border is thinner, or longer, than what a pen leaves along the edge.
    is_mark = ndimage.maximum(depth[mask], piece, numbers) >= _THIN_PART * stroke
    is_mark &= spans < _OTHER * max(mask.shape)
    drawing = np.isin(pieces.labels, numbers[sharp & (is_inner | is_mark)])
    touching = drawing & at_rim
    beside = drawing & ndimage.binary_dilation(touching, iterations=2 * math.ceil(stroke))
    if touching.sum() > _TOUCHING * at_rim.sum() or depth[beside].max(initial=0) > _THICK * stroke:
        refuse("cut-off", sentence="drawing-cut-off")
    return drawing


class _Pieces(NamedTuple):
    """The pieces of the ink on a page.

    ``labels`` numbers the piece of each pixel, ``piece`` those of the ink only. The others up to ``farthest``
    have a value for each piece: its longer side, whether its edges are sharp, and its reach from the rim.
    """

    labels: AnyArray
    piece: AnyArray
    numbers: Int64
    spans: Int64
    is_sharp: Bool
    farthest: AnyArray
    depth: Float64
    from_rim: AnyArray
    slopes: Float32
    edges: Bool

    @classmethod
    def of(cls, mask: Bool, inside: Bool, found: Ink) -> _Pieces:
        """Find the pieces; ItemError ``no-ink`` if there are none."""
        labels, count = ndimage.label(mask, np.ones((3, 3)))
        if not count:
            refuse("no-ink", sentence="empty-page")
        numbers, piece = np.arange(1, count + 1), labels[mask]
        depth = np.asarray(ndimage.distance_transform_edt(mask))
        from_rim = ndimage.distance_transform_cdt(np.pad(inside, 1))[1:-1, 1:-1]
        # A blur of a pixel removes noise.
        slopes = ndimage.gaussian_gradient_magnitude(found.reflectance, 1.0) / (1 - found.ink)
        slopes = ndimage.maximum_filter(slopes, 3)
        edges = (depth > 0) & (depth <= 1)
        boxes = ndimage.find_objects(labels)
        spans = np.array([max(part.stop - part.start for part in box) for box in boxes])
        farthest = np.asarray(ndimage.maximum(from_rim[mask], piece, numbers))
        is_sharp = np.asarray(ndimage.median(slopes[edges], labels[edges], numbers)) >= _SOFT
        return cls(labels, piece, numbers, spans, is_sharp, farthest, depth, from_rim, slopes, edges)


def _check(digit: Bool, depth_px: float, inside: Bool) -> None:
    """Refuse ink that is too small, too wide or a blob."""
    height, width = (int(np.ptp(np.flatnonzero(digit.any(axis=axis)))) + 1 for axis in (1, 0))
    small = max(height, width) / min(int(inside.any(axis=axis).sum()) for axis in (0, 1))
    thick, wide = 2 * depth_px / max(height, width), width / height
    for fits, what, expected in (
        (small >= _SMALLEST, f"ink as long as {small:.0%} of the page", f"{_SMALLEST:.0%} or more"),
        (wide <= _WIDEST, f"ink {wide:.1f} times as wide as it is high", f"at most {_WIDEST} times"),
        (thick <= _BLOB, f"ink as thick as {thick:.0%} of its length", f"at most {_BLOB:.0%}"),
    ):
        if not fits:
            refuse("not-a-digit", what, expected)
