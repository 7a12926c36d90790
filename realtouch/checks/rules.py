"""The rules of a check: thresholds with their reasons, and messages; :mod:`realtouch.checks` applies them."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import NamedTuple

from realtouch.touch_options import CheckLimits

WHOLE_ROUND = -1
"""In place of the number of a touch: all touches of a round."""

MAX_ONE_VALUE = 0.95
"""A picture has no content if more than this share of its pixels has one value, in each channel. Noise of
half a level leaves three quarters, that of a camera less than a half."""

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


class Spot(NamedTuple):
    """A picture of a data set: split, number of the row in it, touch and frame."""

    split: str
    row: int
    touch: int
    frame: int = 0


class Fault(NamedTuple):
    """A rule that is broken at a picture, and the value found."""

    rule: str
    at: Spot
    value: float


@dataclass(frozen=True, slots=True)
class FaultRule:
    """Message of a finding; ``{value}`` is the greatest value, other names are options and constants."""

    title: str
    found: str
    expected: str
    next: str

    def expected_text(self, limits: CheckLimits) -> str:
        """Return the expectation, as text."""
        return self.expected.format(**asdict(limits))


RULES: dict[str, FaultRule] = {
    "unreadable-touches": FaultRule(
        "Touches that cannot be read",
        "damaged values or pictures",
        "touches that can be read",
        "run `realtouch verify`, which says what is wrong with each of them",
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
        "compare by time rather than by number of frame, or record with less load",
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
    "times-run-back": FaultRule(
        "Times that are missing or run backwards",
        "times run backwards by {value:.3g} s, or are missing",
        "times that do not decrease",
        "sort frames by time, or write times of one clock that is never set",
    ),
}
"""All rules, in the order of the report."""
