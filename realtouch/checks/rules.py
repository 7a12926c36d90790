"""Rules of a check: thresholds with their reasons, messages, and the measures of pictures that they limit.

Measures are averages over cells, steps of brightness, numbers of markers, and runs of equal pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from PIL import Image
from scipy import ndimage

from tactile_toolkit.touch import decode_image
from tactile_toolkit.value_types import Bool, Float32, Float64, Floating, UInt8

MAX_NAMED = 20
"""Touches that a finding names; it counts the others."""
WHOLE_ROUND = -1
"""In place of the number of a touch: all touches of a round."""
MAX_ONE_VALUE = 0.95
"""A picture has no content if more than this share of its pixels has one value, in each channel. Noise of
half a level leaves 68 %, that of a camera less than a half."""
MIN_BRIGHTEST = 8.0
"""A picture whose brightest cell is darker is black, levels of 255: above the noise of a covered camera."""
NOISE_FACTOR = 6.0
"""A step counts if it is at least this many times the median step: a normal distribution exceeds 6 standard
deviations once in 500 million."""
MIN_RESEMBLANCE, MIN_GAIN = 0.75, 0.4
"""Colours resemble the reference with red and blue exchanged by this correlation, and this much better than
as they are. The sample images of the published sets have 0.82 to 0.96 as they are, 0.02 to 0.20 exchanged."""
MIN_KNOWN = 0.85
"""Most of a set must resemble a GelSight Mini by this correlation to be judged by its colours; the published
sample without a wide contact has 0.96, and other sensors are lit from other sides."""
MIN_DOTS, MAX_SPECKS, MAX_UNEVENNESS = 20, 9, 0.3
"""A gel has markers if it shows at least ``MIN_DOTS`` dark dots (a GelSight Mini has 63) and the standard
deviation of the distances to their nearest neighbours is at most ``MAX_UNEVENNESS`` times their mean. It has
no markers if there are at most ``MAX_SPECKS`` dots."""
TREND, MIN_ROUNDS = 0.7, 5
"""Least rank correlation of brightness and order that counts as drift, and least number of rounds."""
MIN_STILL, MIN_CHANGE = 5, 20.0
"""A pose is frozen if it stays the same over at least ``MIN_STILL`` touches or frames, while a part of the
picture changes by at least ``MIN_CHANGE`` levels: pictures of a gel without contact change by 1 to 3."""
JUMP_FACTOR, MIN_TURN_DEG = 8.0, 20.0
"""A position jumps if its step exceeds the option, and ``JUMP_FACTOR`` times the 90th percentile of the
steps; a rotation jumps if it exceeds ``MIN_TURN_DEG``, and the same multiple of its percentile."""
NEAR, MIN_CONTACT = 0.65, 10.0
"""Pictures are near duplicates if the brightness of no cell differs by ``NEAR`` levels, and that of one by
``MIN_CONTACT`` from the median of its rounds, as pictures without contact are all alike. A picture that was
encoded again at quality 90 differs by 0.2, or at half the size by 0.5."""
MAX_CLOCK_DIFFERENCE = 0.05
"""Largest difference between the median step of the time stamps of a clip and that of its file, as a share:
stamps in whole milliseconds differ by up to 2 % at 60 Hz."""
ROWS, COLUMNS = 12, 16
"""Cells of a picture whose averages are compared: 1.2 mm of a GelSight Mini, which shows 18.9 x 14.2 mm."""
_UNEVEN = 3.0  # levels; the cells of a constant JPEG differ by up to 2
_BLOCK_PX = 16  # side of a block of JPEG with subsampled colours
_PATCHES = 4  # per side of the coarse pattern by which colours are recognised
_OTHER_WAY = 10  # percent of the cells that may change in the other direction
# Least contrast of a dot: levels, share of the brightness around it, standard deviations of noise.
_DOT_CONTRAST, _DOT_SHARE, _DOT_NOISE = 6.0, 0.06, 4.0
# Dots of GelSight, DIGIT and similar sensors are 1/14 to 1/8 of the width of the picture apart. As shares of
# this width: the side of the surroundings of a dot, the least distance of two dots, the blur.
_SURROUNDINGS, _APART, _BLUR = 1 / 8, 1 / 24, 1 / 320
_DEVIATION_PER_MAD = 1.4826  # of a normal distribution: standard deviation over median absolute deviation


class Spot(NamedTuple):
    """A picture of a data set: split, number of the row in it, touch and frame."""

    split: str
    row: int
    touch: int
    frame: int = 0


class Fault(NamedTuple):
    """A rule that is broken at a picture, and the value found.

    ``stays`` if the picture may stay when the others with this fault are left out: the first of duplicates.
    """

    rule: str
    at: Spot
    value: float
    stays: bool = False


@dataclass(frozen=True, slots=True)
class LeaveOut:
    """Touches that `tactile select --without` leaves out: some of a round, or all if ``touches`` is None.

    ``row`` is the number of the round in its split.
    """

    split: str
    row: int
    round: str
    touches: tuple[int, ...] | None


@dataclass(frozen=True, slots=True)
class FaultRule:
    """Message of a finding; ``{value}`` is the greatest value, other names are options and constants."""

    title: str
    found: str
    expected: str
    next: str


@dataclass(frozen=True)
class RecordingFinding:
    """One fault of the recordings of a data set.

    Attributes
    ----------
    rule : str
        Name of the rule, for example ``frozen-frames``.
    found, expected : str
        The value found and the threshold, each with its unit.
    splits : str
        The splits concerned.
    touches : tuple of str
        The touches concerned, at most the first 20, as ``ROUND:TOUCH``, or ``ROUND:0-255`` for all of a
        round; with the split before it if there are several.
    count : int
        Number of all touches concerned.
    next : str
        A sentence with the next step.
    leave_out : tuple of LeaveOut
        All touches concerned except those that may stay: the first of duplicates, or what is in the smallest
        of several splits.
    """

    rule: str
    found: str
    expected: str
    splits: str
    touches: tuple[str, ...]
    count: int
    next: str
    leave_out: tuple[LeaveOut, ...]


RULES: dict[str, FaultRule] = {
    "unreadable-touches": FaultRule(
        "Touches that cannot be read",
        "damaged values or pictures",
        "touches that can be read",
        "run `tactile verify`, which says what is wrong with each of them",
    ),
    "empty-pictures": FaultRule(
        "Empty arrays, and pictures without content",
        "no pictures, black ones, or {value:.0%} of the pixels with one value",
        f"at most {MAX_ONE_VALUE:.0%} of pixels with one value, and some above {MIN_BRIGHTEST:g} levels",
        "check the camera and its cable, and leave these touches out",
    ),
    "frozen-frames": FaultRule(
        "Frozen frames",
        "{value:.0f} equal pictures in a row",
        "fewer than {frozen} equal pictures in a row",
        "read each frame of the camera once, and record these touches again or leave them out",
    ),
    "dropped-frames": FaultRule(
        "Dropped frames",
        "a time step of {value:.3g} times the median step of its clip",
        "steps of less than {gap:g} times the median step",
        "compare by time, not by frame number, or record with less load on the computer",
    ),
    "exposure-jumps": FaultRule(
        "Exposure jumps",
        "nine tenths of the picture change by {value:.3g} levels or more, the same way",
        f"less than {{exposure:g}} levels, or than {NOISE_FACTOR:g} times the median step",
        "fix exposure and white balance of the camera; subtract the background of each part on its own",
    ),
    "swapped-channels": FaultRule(
        "Channels in another order",
        "colours fit with red and blue exchanged, by a correlation greater by {value:.2f}",
        f"colours in one order; a correlation greater by less than {MIN_GAIN:g}",
        "OpenCV gives blue, green, red: exchange the channels of these touches and make the set again",
    ),
    "gel-drift": FaultRule(
        "Drift of the bare gel",
        "the bare gel changes by {value:.3g} levels over the session",
        "a change of less than {drift:g} levels",
        "subtract the background of each round, `realtouch.background(round)`, before you compare rounds",
    ),
    "mixed-markers": FaultRule(
        "Gels with and without markers",
        "{value:.0f} dots on the gel, and none in other rounds",
        "markers in all rounds or in none",
        "keep gels with and without markers in sets of their own",
    ),
    "duplicate-pictures": FaultRule(
        "Duplicates",
        "{value:.0f} touches with the same stored pictures",
        "each picture once in a split",
        "leave all but one of them out, and compare the poses of what you keep",
    ),
    "near-duplicates": FaultRule(
        "Near duplicates",
        "{value:.0f} touches with contact whose pictures are nearly equal, as if encoded again",
        f"pictures with contact of which a part differs by {NEAR:g} levels",
        "leave all but one of them out, above all if they are in two splits",
    ),
    "shared-pictures": FaultRule(
        "The same picture in two splits",
        "{value:.0f} touches of several splits with the same stored pictures",
        "no picture in two splits",
        "leave them out of all splits but one: results on the others would be too good",
    ),
    "shared-objects": FaultRule(
        "The same object in two splits",
        "an object in {value:.0f} splits",
        "each object in one split",
        "keep all rounds of an object in one split: results on the others would be too good",
    ),
    "still-poses": FaultRule(
        "Poses that do not move with the pictures",
        "{value:.0f} poses in a row are the same while the pictures change",
        f"fewer than {MIN_STILL} equal poses while a part of the picture changes by {MIN_CHANGE:g} levels",
        "read the pose at the time of each picture, or leave the poses out",
    ),
    "moving-poses": FaultRule(
        "Poses that move while pictures are frozen",
        "the gel moves by {value:.3g} mm while the picture is the same",
        "less than {motion_mm:g} mm while pictures are the same",
        "read each frame of the camera once, and record these touches again or leave them out",
    ),
    "pose-jumps": FaultRule(
        "Poses that jump",
        "a step of {value:.3g} times the limit",
        f"at most {{jump_mm:g}} mm and {MIN_TURN_DEG:g} degrees, or {JUMP_FACTOR:g} times most other steps",
        "check the units, the order of the quaternion and the robot for lost packets",
    ),
    "two-clocks": FaultRule(
        "Two clocks",
        "time stamps and the rate that the file of a clip states differ by {value:.0%}",
        f"at most {MAX_CLOCK_DIFFERENCE:.0%}",
        "trust the time stamps, and write the rate of the camera to its files",
    ),
    "times-run-back": FaultRule(
        "Times that are missing or run backwards",
        "times run backwards by {value:.3g} s, or are missing",
        "times that do not decrease",
        "sort frames by time, or write times of one clock that is never set",
    ),
}
"""All rules, in the order of the report."""


def cells_of(encoded: bytes | memoryview) -> Float32:
    """Decode a picture to the averages of its cells, shape (12, 16, 3); ValueError if it is damaged."""
    pixels = decode_image(encoded, least_px=COLUMNS)
    shrunk = Image.fromarray(pixels).resize((COLUMNS, ROWS), Image.Resampling.BOX)
    return np.asarray(shrunk, np.float32)


def brightness_of(encoded: bytes | memoryview) -> Float32:
    """Decode a picture to the brightness of its cells above their median, shape (192,), levels."""
    pixels = decode_image(encoded, least_px=4 * COLUMNS)
    grey = Image.fromarray(pixels.mean(axis=2, dtype=np.float32))
    cells = np.asarray(grey.resize((COLUMNS, ROWS), Image.Resampling.BILINEAR), np.float32).ravel()
    return cells - np.median(cells)


def share_of_one_value(encoded: bytes | memoryview, cells: Float32) -> float:
    """Return the share of pixels that have the median value, in the channel where it is least.

    A black picture has the share 1. A picture whose cells differ has the share 0, and is not decoded in full.
    Even a gel that is lit evenly has noise. JPEG makes the lower and the right edge of a constant picture
    uneven, so these edges are left out.
    """
    if float(cells.max()) < MIN_BRIGHTEST:
        return 1.0
    if float(np.ptp(cells, axis=(0, 1)).max()) > _UNEVEN:
        return 0.0
    pixels = decode_image(encoded)
    if min(pixels.shape[:2]) > 2 * _BLOCK_PX:
        pixels = pixels[:-_BLOCK_PX, :-_BLOCK_PX]
    inner = pixels.reshape(-1, 3)
    return float((inner == np.median(inner, axis=0)).mean(axis=0).min())


def brightness_steps(cells: Float32) -> Float64:
    """Return the least change, in levels, of nine tenths of the cells in one direction, shape (n - 1,).

    ``cells`` have the shape (n, 12, 16, 3). A contact changes only a part of the picture, or makes one side
    brighter and the other darker; then the step is 0.
    """
    change = np.diff(cells.mean(axis=3).reshape(len(cells), -1), axis=0)
    if not len(change):
        return np.zeros(0)
    low, high = np.percentile(change, (_OTHER_WAY, 100 - _OTHER_WAY), axis=1)
    steps: Float64 = np.maximum(np.maximum(low, -high), 0.0)
    return steps


def outlying_steps(cells: Float32, least: float) -> list[tuple[int, float]]:
    """Return the index of each picture at which the brightness jumps, and the jump in levels.

    A jump of fewer than ``least`` levels does not count. A jump back to the brightness before is not listed.
    """
    steps = brightness_steps(cells)
    if not len(steps):
        return []
    usual_step = 0.0
    if len(steps) > 1:
        usual_step = np.median(np.sort(steps)[:-1])  # without the largest, which is the one in question
    limit = max(least, NOISE_FACTOR * float(usual_step))
    jumps: list[tuple[int, float]] = []
    usual = 0  # the last picture before the first step
    for step in np.flatnonzero(steps >= limit).tolist():
        is_back = bool(jumps) and brightness_steps(cells[[usual, step + 1]])[0] < limit
        if is_back:
            usual = step + 1
            continue
        if not jumps:
            usual = step
        jumps.append((step + 1, float(steps[step])))
    return jumps


def colour_pattern(cells: Float32) -> Float32:
    """Return the mean colours of 4 x 4 patches of a picture, normalised, shape (48,)."""
    shape = (_PATCHES, ROWS // _PATCHES, _PATCHES, COLUMNS // _PATCHES, 3)
    return normalised(cells.reshape(shape).mean(axis=(1, 3)).ravel())


def normalised(pattern: Floating) -> Float32:
    """Subtract the mean of a pattern and divide by its standard deviation; zeros for a constant pattern."""
    deviation = float(pattern.std()) or 1.0
    scaled: Float32 = ((pattern - pattern.mean()) / deviation).astype(np.float32)
    return scaled


def with_red_as_blue(patterns: Float32) -> Float32:
    """Return colour patterns, shape (..., 48), with red and blue exchanged."""
    return patterns.reshape(*patterns.shape[:-1], -1, 3)[..., ::-1].reshape(patterns.shape)


def count_markers(background: UInt8) -> int | None:
    """Return the number of dots of a marker gel, 0 if it has none, None if that is uncertain.

    Dots are local minima of brightness, clearly darker than their surroundings, at even distances.
    """
    grey = background.mean(axis=2, dtype=np.float64)
    width_px = grey.shape[1]
    around = ndimage.uniform_filter(grey, max(3, round(width_px * _SURROUNDINGS)))
    # Blur gives a dot of several equal pixels a single darkest pixel.
    darkness = ndimage.gaussian_filter(around - grey, width_px * _BLUR)
    # The median ignores dots, which cover less than half of the picture.
    noise = _DEVIATION_PER_MAD * np.median(np.abs(darkness - np.median(darkness)))
    least = np.maximum(np.maximum(_DOT_CONTRAST, _DOT_NOISE * noise), _DOT_SHARE * around)
    peaks = darkness == ndimage.maximum_filter(darkness, max(3, round(width_px * _APART)))
    dots = np.argwhere(peaks & (darkness > least))
    if len(dots) <= MAX_SPECKS:
        return 0
    squared = ((dots[:, None] - dots[None]) ** 2).sum(axis=2).astype(np.float64)
    np.fill_diagonal(squared, np.inf)
    nearest = np.sqrt(squared.min(axis=1))
    if len(dots) < MIN_DOTS or nearest.std() > MAX_UNEVENNESS * nearest.mean():
        return None
    return len(dots)


def spans_of(same: Sequence[bool] | Bool, least: int) -> list[tuple[int, int]]:
    """Return start and length of each run of at least ``least`` equal entries.

    ``same``, shape (n - 1,), states whether entry i + 1 equals entry i.
    """
    marks = np.concatenate([[False], np.asarray(same, bool), [False]])
    edges = np.flatnonzero(marks[1:] != marks[:-1])
    pairs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return [(start, stop - start + 1) for start, stop in pairs if stop - start + 1 >= least]
