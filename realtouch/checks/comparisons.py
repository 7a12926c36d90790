"""Faults that are found by comparing sections and splits with each other."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from itertools import groupby

import numpy as np
from scipy import stats

from realtouch.checks import picture_measures, rules
from realtouch.checks.sections import Section
from realtouch.touch_options import CheckLimits
from tactile_toolkit.array_types import Float32, Float64, Int64

# Rounds whose names begin with date and time, as in the published sets, are sorted by name.
_DATED = re.compile(r"\d{4}-\d\d-\d\d[_T ]\d\d[-:]\d\d[-:]\d\d")

GELSIGHT_MINI = (
    (37, 95, 101), (57, 106, 123), (60, 106, 124), (40, 89, 103),
    (72, 101, 117), (112, 111, 144), (115, 111, 144), (78, 94, 118),
    (81, 99, 111), (131, 108, 133), (133, 108, 131), (85, 92, 108),
    (65, 89, 81), (98, 98, 96), (99, 98, 96), (67, 83, 80),
)  # fmt: skip
"""Red, green and blue of a bare GelSight Mini in 4 x 4 parts of its picture, row by row, levels: averages of
the background of its calibration in the package taxim 1.4.1. The sample images of the published sets, with
contact, correlate with it by 0.82 to 0.96, and with red and blue exchanged by 0.02 to 0.20."""


def all_comparisons(sections: Sequence[Section], limits: CheckLimits) -> Iterator[rules.Fault]:
    """Yield the faults between sections, and between splits."""
    yield from _equal_pictures(sections)
    yield from _shared_objects(sections)
    yield from _swapped_channels(sections)
    yield from _mixed_markers(sections)
    for gel in _sessions(sections):
        yield from _changes_of_gel(gel, limits)


def _equal_pictures(sections: Sequence[Section]) -> Iterator[rules.Fault]:
    """Yield touches with the same stored pictures, in a split and over splits; frozen images count once."""
    faults = (fault for section in sections for fault in section.faults)
    frozen = {fault.at for fault in faults if fault.rule == "frozen-frames"}
    owners: dict[bytes, list[rules.Spot]] = defaultdict(list)
    for touch in (touch for section in sections for touch in section.touches):
        if touch.spot not in frozen:
            owners[touch.digest].append(touch.spot)
    for spots in owners.values():
        rule = "shared-pictures" if len({spot.split for spot in spots}) > 1 else "duplicate-pictures"
        if len(spots) > 1:
            yield from (rules.Fault(rule, spot, len(spots)) for spot in spots)


def _shared_objects(sections: Sequence[Section]) -> Iterator[rules.Fault]:
    owners: dict[int, list[rules.Spot]] = defaultdict(list)
    for each in (found for section in sections for found in section.rounds):
        if each.object_id is not None:
            owners[each.object_id].append(each.spot)
    for spots in owners.values():
        splits = len({spot.split for spot in spots})
        if splits > 1:
            yield from (rules.Fault("shared-objects", spot, splits) for spot in spots)


def _swapped_channels(sections: Sequence[Section]) -> Iterator[rules.Fault]:
    """Yield the touches whose red and blue are exchanged.

    The colours of a GelSight Mini are known; those of another sensor are compared with the most common ones.
    """
    touches = [touch for section in sections for touch in section.touches]
    if not touches:
        return
    patterns = np.array([touch.pattern for touch in touches])
    known = picture_measures.colour_pattern(
        np.repeat(np.repeat(np.array(GELSIGHT_MINI).reshape(4, 4, 3), 3, 0), 4, 1)
    )
    reference = _most_common(patterns)
    _, order = _gain(reference[None], known, rules.MIN_KNOWN)
    if order[0]:
        reference = known
    gain, order = _gain(patterns, reference)
    numbers = range(len(touches))
    for _, group in groupby(numbers, key=lambda number: touches[number].spot[:2]):
        of_round = np.array(list(group))
        # Contact hides the colours of a few touches; the majority of their round decides.
        is_swapped = order[of_round] == -1
        if 2 * is_swapped.sum() > len(of_round):
            is_swapped[:] = True
        for number in of_round[is_swapped].tolist():
            yield rules.Fault("swapped-channels", touches[number].spot, float(gain[number]))


def _gain(
    patterns: Float32, reference: Float32, least: float = rules.MIN_RESEMBLANCE
) -> tuple[Float64, Int64]:
    """Return how much better patterns fit with red and blue exchanged, and which order of channels fits.

    The order is 1 as stored, -1 with red and blue exchanged, and 0 if neither fits.
    """
    as_is = (patterns @ reference / len(reference)).astype(np.float64)
    swapped = (picture_measures.with_red_as_blue(patterns) @ reference / len(reference)).astype(np.float64)
    gain = swapped - as_is
    is_swapped = (swapped >= least) & (gain >= rules.MIN_GAIN)
    is_usual = (as_is >= least) & (-gain >= rules.MIN_GAIN)
    return gain, is_usual.astype(np.int64) - is_swapped


def _most_common(patterns: Float32) -> Float32:
    """Return the pattern of most touches, some of which have red and blue exchanged; on a tie, the first."""
    _, order = _gain(patterns, patterns[np.argmax(patterns.any(axis=1))])
    most = -1 if np.count_nonzero(order == -1) > np.count_nonzero(order == 1) else 1
    if (order == most).any():
        patterns = patterns[order == most]
    return picture_measures.normalised(np.median(patterns, axis=0))


def _mixed_markers(sections: Sequence[Section]) -> Iterator[rules.Fault]:
    """Yield the rounds with markers if others have none, or those without if they are fewer."""
    marked = [section for section in sections if section.markers]
    plain = [section for section in sections if section.markers == 0]
    if not marked or not plain:
        return
    dots = float(np.median([section.markers for section in marked if section.markers]))
    for each in (found for section in min(plain, marked, key=len) for found in section.rounds):
        yield rules.Fault("mixed-markers", each.spot, dots)


def _sessions(sections: Sequence[Section]) -> list[list[Section]]:
    """Return the sections with each gel, in order of time: by their names, or as they are stored."""
    ordered = [section for section in sections if section.gel is not None]
    if all(_DATED.match(section.rounds[0].name) for section in ordered):
        ordered.sort(key=lambda section: section.rounds[0].name)
    by_gel: dict[object, list[Section]] = defaultdict(list)
    for section in ordered:
        by_gel[str(section.rounds[0].gel), bool(section.markers)].append(section)
    return list(by_gel.values())


def _changes_of_gel(session: Sequence[Section], limits: CheckLimits) -> Iterator[rules.Fault]:
    """Yield the steps of the bare gel from round to round, and its drift."""
    gels = np.stack([section.gel for section in session if section.gel is not None])
    rounds = [section.rounds[0].spot for section in session]
    for index, step in picture_measures.outlying_steps(gels, limits.exposure):
        # A step inside a round also changes the average of its gel; it is reported for its touch.
        around = (fault.rule for each in session[index - 1 : index + 1] for fault in each.faults)
        if "exposure-jumps" not in around:
            yield rules.Fault("exposure-jumps", rounds[index], step)
    if len(gels) < rules.MIN_ROUNDS:
        return
    levels = gels.mean(axis=(1, 2)).astype(np.float64)  # (n, 3)
    third = len(levels) // 3 or 1
    change = np.median(levels[-third:], axis=0) - np.median(levels[:third], axis=0)
    channel = int(np.argmax(np.abs(change)))
    size = float(abs(change[channel]))
    if size < limits.drift:
        return
    trend = abs(float(stats.spearmanr(np.arange(len(levels)), levels[:, channel]).statistic))
    # A change in one step is not drift.
    largest = float(np.abs(np.diff(levels[:, channel])).max())
    if trend >= rules.TREND and largest < size / 2:
        yield from (rules.Fault("gel-drift", spot, size) for spot in rounds[-third:])
