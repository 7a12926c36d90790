"""Contact by time, by the height of the gel, and by pictures; arrays only.

Which frames of a clip show contact follows from the registered times (:func:`contact_window`), as in the
paper. Whether a touch met an object follows from the height at which the gel stopped
(:func:`contact_heights_m`), the rule of the paper's authors. If frames are equal, the earlier one is chosen.

By pictures, contact follows from how much of a picture differs from a background, by default the median.
Grey is what OpenCV and JPEG call luma (ITU-R BT.601), in integers: (4899 R + 9617 G + 1868 B + 8192) >> 14.

The results are exact, the same on every machine.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from tactile_toolkit.checked_fields import check_fields, integer, real
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import AnyArray, Float64, Floating, UInt8

ContactMethod = Literal["contact_start", "contact_end", "peak", "best"]
CONTACT_METHODS: tuple[ContactMethod, ...] = get_args(ContactMethod)
"""Names of the ways to choose one frame: see :meth:`realtouch.TouchClip.contact_index`."""
CLOCK_TOLERANCE_S = 1e-4
"""Times within this tolerance are equal, seconds: rounding of single precision in the first half hour."""

_SHAPES = {3: "(H, W, 3)", 4: "(N, H, W, 3)"}

_DECODED_AT_ONCE = 64  # pictures of a clip
_DECODED_BYTES = 64 << 20  # of these pictures; if they are large, there are fewer

# Number of values of each picture that are processed at once; those of 90 frames fit into a core's cache.
_PIXELS_AT_ONCE = 1 << 13
Representation = Literal["signed", "grey", "absolute"]
REPRESENTATIONS: tuple[Representation, ...] = get_args(Representation)


def require_method(method: str) -> ContactMethod:
    """Return a method by name; InputError if there is no such method."""
    for known in CONTACT_METHODS:
        if known == method:
            return known
    raise InputError(f"unknown frame method {method!r}; expected one of {', '.join(CONTACT_METHODS)}")


def contact_window(time_s: Float64, start_s: float, end_s: float) -> slice:
    """Return the frames between the first and the last registered contact, both included.

    ``time_s``, shape (N,), does not decrease. ``start`` is the first frame at or after ``start_s``, ``stop``
    one more than the last at or before ``end_s``; times within :data:`CLOCK_TOLERANCE_S` count as equal. If
    no frame lies between them, the frame nearest to ``end_s`` (the earlier of two equally near) is returned,
    so that a window is empty only for a clip without frames.
    """
    start = int(time_s.searchsorted(start_s - CLOCK_TOLERANCE_S, side="left"))
    stop = int(time_s.searchsorted(end_s + CLOCK_TOLERANCE_S, side="right"))
    if start < stop or not len(time_s):
        return slice(start, stop)
    nearest = int(np.argmin(np.abs(time_s - end_s)))
    return slice(nearest, nearest + 1)


def contact_heights_m(z_m: Floating, recalibrate_z: bool = True, plate_z_m: float = math.nan) -> Float64:
    """Return the height above the plate at which the gel stopped, for each touch of a round, (T,), metres.

    ``z_m`` is the height of the gel at the deepest press of each touch, cell frame; NaN where it is not
    known, and so is the result then. The zero of z drifts by up to 3 mm between rounds: ``recalibrate_z``
    takes the deepest touch of the round as the plate, or ``plate_z_m`` unless it is NaN: the deepest touch
    may have been taken out of the round.
    """
    heights = np.asarray(z_m, np.float64)
    if not recalibrate_z or not len(heights):
        return heights
    if math.isnan(plate_z_m):
        plate_z_m = np.fmin.reduce(heights)
    return heights - plate_z_m


def median_in_memory(pictures: UInt8) -> UInt8:
    """Return the median of n pictures in memory, shape (n, H, W, 3), n >= 1; see :func:`median_of`.

    The median is found bit by bit, a few pixels at a time, in an eighth of the time of counting values.
    """
    values = pictures.reshape(len(pictures), -1)
    starts = range(0, values.shape[1], _PIXELS_AT_ONCE)
    parts = (values[:, start : start + _PIXELS_AT_ONCE] for start in starts)
    median = np.concatenate([_median_by_bits([[part]] * 8, 1) for part in parts])
    return median.reshape(pictures.shape[1:])


def median_of(batches: Callable[[], Iterable[UInt8]]) -> UInt8:
    """Return the exact median of the pictures of batches, shape (H, W, 3).

    ``batches`` is called twice and returns at least one batch, shape (n, H, W, 3). For an even number of
    pictures, the median is the mean of the two middle values, rounded down.
    """
    # Four bits at a time: 15 counts of each value of a 320 x 240 picture take 14 MB, 255 would take 235 MB.
    return _median_by_bits((batches() for _ in range(2)), 4)


def _median_by_bits(passes: Iterable[Iterable[UInt8]], bits: int) -> UInt8:
    """Return the median of each pixel; each pass over the pictures finds some of its bits, highest first.

    The value at rank k of the sorted pictures is the largest value that at most k pictures are below.
    """
    values: list[UInt8] = []  # for the middle rank, or for both middle ranks
    for number, batches in enumerate(passes, 1):
        steps = (np.arange(1, 1 << bits) << (8 - number * bits)).astype(np.uint8)
        total = 0
        below: AnyArray = np.zeros(0, np.int32)
        for batch in batches:
            if not values:
                values = [np.zeros(batch.shape[1:], np.uint8)]
            if not total:
                below = np.zeros((len(values), len(steps), *batch.shape[1:]), np.int32)
            elif below.shape[2:] != batch.shape[1:]:
                (first_height, first_width), (height, width) = below.shape[2:4], batch.shape[1:3]
                raise InputError(
                    f"pictures of {first_width} x {first_height} and of {width} x {height} pixels have no "
                    "common background; expected one size",
                    next="compare pictures of one size at a time",
                )
            total += len(batch)
            counted = np.min_scalar_type(len(batch))
            for counts, value in zip(below, values, strict=True):
                for count, step in zip(counts, steps, strict=True):
                    count += (batch < value + step).sum(axis=0, dtype=counted)
        ranks = sorted({(total - 1) // 2, total // 2})
        # If there are two middle ranks, the first pass turns the one value into two.
        values = [
            values[-index] + ((below[-index] <= rank).sum(axis=0) << (8 - number * bits)).astype(np.uint8)
            for index, rank in enumerate(ranks)
        ]
    return ((values[0].astype(np.int64) + values[-1]) // 2).astype(np.uint8)


def as_pictures(pictures: object, dimensions: tuple[int, ...] = (4,)) -> UInt8:
    """Return pictures as an array of uint8 with three channels; InputError for any other."""
    array = np.asarray(pictures)
    if array.dtype != np.uint8 or array.ndim not in dimensions or array.shape[-1] != 3:
        expected = " or ".join(_SHAPES[count] for count in dimensions)
        raise InputError(
            f"pictures are an array of shape {array.shape}, {array.dtype}; expected {expected}, uint8, or a "
            "clip, a round or touches"
        )
    return array


def _with_background(pictures: object, background: object) -> tuple[UInt8, UInt8]:
    """Return pictures and a background of the same size; InputError for any other."""
    stack = as_pictures(pictures, (3, 4))
    base = as_pictures(background, (3,))
    if stack.shape[-3:] != base.shape:
        raise InputError(
            f"the background has the shape {base.shape}; expected {stack.shape[-3:]}, as the pictures"
        )
    return stack, base


def difference(pictures: UInt8, background: UInt8, representation: Representation = "signed") -> AnyArray:
    """Return the difference from a background.

    Parameters
    ----------
    pictures : ndarray, shape (H, W, 3) or (N, H, W, 3), uint8
        One picture, or several.
    background : ndarray, shape (H, W, 3), uint8
        Background, such as :func:`background` returns.
    representation : str
        ``"signed"``: picture - background; ``"grey"``: (picture - background + 256) // 2, where 128 is equal
        and half of each difference is kept; ``"absolute"``: its absolute value.

    Returns
    -------
    ndarray, the shape of ``pictures``; int16 if signed, else uint8

    Raises
    ------
    InputError
        Arrays of other shapes or types, or another representation.
    """
    if representation not in REPRESENTATIONS:
        raise InputError(f"no difference {representation!r}; expected one of {', '.join(REPRESENTATIONS)}")
    stack, base = _with_background(pictures, background)
    signed = stack.astype(np.int16) - base
    if representation == "signed":
        return signed
    unsigned: AnyArray = np.abs(signed) if representation == "absolute" else (signed + 256) // 2
    return unsigned.astype(np.uint8)


@dataclass(frozen=True)
class ContactThresholds:
    """Thresholds by which a picture shows contact.

    Attributes
    ----------
    min_change : int
        A pixel has changed if the grey of its absolute difference from the background is above this level.
    min_area_px : int
        Least number of changed pixels of a picture with contact.
    min_intensity : float
        Least mean grey of the changed pixels of a picture with contact, levels.
    crop : float
        Share of height and width, around the middle, that is compared; above 0, at most 1.

    Notes
    -----
    The defaults are those of software that uses the published clips (median background of each clip, central
    half of the picture); see :func:`contacts_by_image`.
    """

    min_change: int = integer(10, 0, 255)
    min_area_px: int = integer(40, 0, 1 << 40)
    min_intensity: float = real(12.0, 0, 255)
    crop: float = real(0.5, 1e-6, 1)

    def __post_init__(self) -> None:
        check_fields(self, "the contact thresholds")

    def holds(self, score: ContactScore) -> Any:
        """Return whether pictures with such scores show contact, bool or an array of bool."""
        return (score.area_px >= self.min_area_px) & (score.intensity >= self.min_intensity)

    def window(self, height: int, width: int) -> tuple[slice, slice]:
        """Return the rows and columns that are compared."""
        # At least one or two pixels stay, however small the crop is.
        margins = [min(round(size * (1 - self.crop) / 2), (size - 1) // 2) for size in (height, width)]
        return slice(margins[0], height - margins[0]), slice(margins[1], width - margins[1])


_DEFAULT_RULE = ContactThresholds()


@dataclass(frozen=True, eq=False)
class ContactScore:
    """How much of a picture changed, and by how much; numbers, or arrays of shape (N,) for N pictures.

    Attributes
    ----------
    area_px : int64
        Changed pixels.
    intensity : float64
        Mean grey of the changed pixels, levels; 0 if none has changed.
    """

    area_px: Any
    intensity: Any

    @property
    def total_change(self) -> Any:
        """Sum of the grey levels of all changed pixels; largest where the contact shows best."""
        return np.rint(self.area_px * self.intensity)

    def of_picture(self, number: int) -> ContactScore:
        """Return the score of one of several pictures."""
        return ContactScore(int(self.area_px[number]), float(self.intensity[number]))


def contact_score(pictures: UInt8, background: UInt8, rule: ContactThresholds | None = None) -> ContactScore:
    """Score how clearly pictures show contact.

    Parameters
    ----------
    pictures : ndarray, shape (H, W, 3) or (N, H, W, 3), uint8
        One picture, or several.
    background : ndarray, shape (H, W, 3), uint8
        Picture without contact.
    rule : ContactThresholds, optional
        Threshold of a changed pixel, and crop.

    Returns
    -------
    ContactScore

    Raises
    ------
    InputError
        As :func:`difference`.
    """
    rule = rule or _DEFAULT_RULE
    stack, base = _with_background(pictures, background)
    rows, columns = rule.window(*base.shape[:2])
    score = _score(stack.reshape(-1, *base.shape)[:, rows, columns], base[rows, columns], rule.min_change)
    return score.of_picture(0) if stack.ndim == 3 else score


def _score(pictures: UInt8, base: UInt8, min_change: int) -> ContactScore:
    area, total = np.zeros(len(pictures), np.int64), np.zeros(len(pictures), np.int64)
    for number, picture in enumerate(pictures):
        # The larger minus the smaller value fits into eight bits.
        change = (np.maximum(picture, base) - np.minimum(picture, base)).astype(np.int32)
        grey = (4899 * change[..., 0] + 9617 * change[..., 1] + 1868 * change[..., 2] + 8192) >> 14
        changed = grey[grey > min_change]
        area[number], total[number] = changed.size, changed.sum()
    return ContactScore(area, total / np.maximum(area, 1))


def best_of(
    frames: UInt8, rule: ContactThresholds | None = None, base: UInt8 | None = None
) -> tuple[int, ContactScore]:
    """Return the frame of a clip, shape (N, H, W, 3), with the greatest total change, and its score.

    If several frames have the same change, the earliest is returned. The background ``base`` is by default
    the median of the clip. Raises InputError if there is no frame.
    """
    rule = rule or _DEFAULT_RULE
    if not len(frames):
        raise InputError("the clip holds no frame; expected at least one")
    if base is None:
        # Only the window of the rule is needed.
        rows, columns = rule.window(*frames.shape[1:3])
        cropped = np.ascontiguousarray(frames[:, rows, columns])
        scores = _score(cropped, median_in_memory(cropped), rule.min_change)
    else:
        scores = contact_score(frames, base, rule)
    best = int(np.argmax(scores.total_change))
    return best, scores.of_picture(best)


def contact_by_pictures(
    pictures: Sequence[bytes], size: tuple[int, int], decode: Callable[[bytes], UInt8]
) -> tuple[tuple[int, int], bool]:
    """Return the first and last picture that show contact, and True; else the best picture twice, and False.

    The pictures are encoded, and of one ``size`` (height, width). The background is the median of the clip:
    of at most 64 pictures, spread evenly over the clip, so that a long clip takes little time and memory.
    """
    rule = _DEFAULT_RULE
    rows, columns = rule.window(*size)
    height, width = rows.stop - rows.start, columns.stop - columns.start
    at_once = min(_DECODED_AT_ONCE, max(1, _DECODED_BYTES // (3 * height * width)))

    def decoded(some: Sequence[bytes]) -> UInt8:
        cropped = np.empty((len(some), height, width, 3), np.uint8)
        for number, picture in enumerate(some):
            cropped[number] = decode(picture)[rows, columns]  # a view would keep the whole picture
        return cropped

    samples = decoded(pictures[:: -(-len(pictures) // at_once)])
    base = median_in_memory(samples)
    if len(samples) == len(pictures):
        scores = [_score(samples, base, rule.min_change)]
    else:
        parts = (pictures[start : start + at_once] for start in range(0, len(pictures), at_once))
        scores = [_score(decoded(part), base, rule.min_change) for part in parts]
    in_contact = np.flatnonzero(np.concatenate([rule.holds(score) for score in scores]))
    if len(in_contact):
        return (int(in_contact[0]), int(in_contact[-1])), True
    best = int(np.concatenate([score.total_change for score in scores]).argmax())
    return (best, best), False
