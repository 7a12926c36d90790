"""Strips: sequences of pictures with poses and times, and the faults within one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from realtouch import touch_options
from realtouch.faults import rules
from realtouch.faults.seen import spans_of
from realtouch.poses import Poses
from tactile_toolkit.array_types import Float32, Float64

_MIN_STEPS = 4  # fewer have no usual step
_SAME_M, _SAME_QUATERNION = 1e-7, 1e-6  # a robot at rest measures noise beyond these
_FAR = 10.0  # touches of a round are about this many times farther apart than frames


class Picture(NamedTuple):
    """A picture with content that was decoded to the averages of its cells, shape (12, 16, 3)."""

    spot: rules.Spot
    cells: Float32
    encoded: memoryview


@dataclass(frozen=True, eq=False)
class Strip:
    """The images of a round, or the frames of a clip.

    ``at`` stands for all of them; ``spots``, ``digests`` and ``poses`` have an entry for each picture, whose
    digest is empty if it has no content. ``seen`` are pictures by their numbers. ``time_s`` are the times of
    frames, NaN where missing; empty for images.
    """

    at: rules.Spot
    spots: Sequence[rules.Spot]
    digests: Sequence[bytes]
    seen: Mapping[int, Picture]
    poses: Poses | None
    time_s: Float64


def frozen(strip: Strip, limits: touch_options.CheckLimits) -> Iterator[rules.Fault]:
    """Yield runs of equal pictures, and the motion of the gel during them."""
    same = [one == other != b"" for one, other in pairwise(strip.digests)]
    for start, length in spans_of(same, limits.frozen):
        # A clip is named once, by the last of its frozen frames.
        repeats = {spot.touch: spot for spot in strip.spots[start + 1 : start + length]}.values()
        yield from (rules.Fault("frozen-frames", spot, length) for spot in repeats)
        if strip.poses is None:
            continue
        moved_mm = 1e3 * float(np.linalg.norm(np.ptp(strip.poses.position_m[start : start + length], axis=0)))
        if moved_mm >= limits.motion_mm:
            yield from (rules.Fault("moving-poses", spot, moved_mm) for spot in repeats)


def still(strip: Strip, limits: touch_options.CheckLimits) -> Iterator[rules.Fault]:
    """Yield the runs of equal poses over which pictures change."""
    if strip.poses is None:
        return
    moved = np.abs(np.diff(strip.poses.position_m, axis=0)).max(axis=1, initial=0)
    turned = np.abs(np.diff(strip.poses.quaternion, axis=0)).max(axis=1, initial=0)
    for start, length in spans_of((moved <= _SAME_M) & (turned <= _SAME_QUATERNION), rules.MIN_STILL):
        inside = [each for number, each in strip.seen.items() if start <= number < start + length]
        if len(inside) < 2:
            continue
        cells = np.stack([each.cells for each in inside])
        # An even step of brightness is not a contact.
        cells -= np.median(cells, axis=(1, 2), keepdims=True)
        if np.ptp(cells, axis=0).max() >= rules.MIN_CHANGE:
            concerned = {each.spot.touch: each.spot for each in inside}
            yield from (rules.Fault("still-poses", spot, length) for spot in concerned.values())


def wrong_times(strip: Strip, limits: touch_options.CheckLimits) -> Iterator[rules.Fault]:
    """Yield times that are missing or decrease, or otherwise the longest gap between them."""
    steps = np.diff(strip.time_s)
    if not np.isfinite(strip.time_s).all() or (steps < 0).any():
        known = np.where(np.isfinite(steps), steps, 0.0)
        frame = int(known.argmin()) + 1 if len(steps) else 0
        yield rules.Fault("times-run-back", strip.at._replace(frame=frame), -float(known.min(initial=0.0)))
        return
    usual = float(np.median(steps)) if len(steps) >= _MIN_STEPS else 0.0
    if usual > 0 and steps.max() >= limits.gap * usual:
        after = strip.at._replace(frame=int(steps.argmax()) + 1)
        yield rules.Fault("dropped-frames", after, float(steps.max()) / usual)


def jumps(strip: Strip, limits: touch_options.CheckLimits) -> Iterator[rules.Fault]:
    """Yield the worst step of the poses of a clip, or the images that are far away from all others."""
    if strip.poses is None or len(strip.spots) <= _MIN_STEPS:
        return
    position_mm = 1e3 * strip.poses.position_m
    if strip.at.touch == rules.WHOLE_ROUND:
        far_mm = np.linalg.norm(position_mm - np.median(position_mm, axis=0), axis=1)
        limit = max(_FAR * limits.jump_mm, rules.JUMP_FACTOR * float(np.median(far_mm)))
        for number in np.flatnonzero(far_mm > limit).tolist():
            yield rules.Fault("pose-jumps", strip.spots[number], float(far_mm[number]) / limit)
        return
    quaternion = strip.poses.quaternion / np.linalg.norm(strip.poses.quaternion, axis=1, keepdims=True)
    # A quaternion and its negative are one rotation.
    cosine = np.abs((quaternion[1:] * quaternion[:-1]).sum(axis=1)).clip(0, 1)
    turned_deg = np.degrees(2 * np.arccos(cosine))
    moved_mm = np.linalg.norm(np.diff(position_mm, axis=0), axis=1)
    for steps, least in ((moved_mm, limits.jump_mm), (turned_deg, rules.MIN_TURN_DEG)):
        limit = max(least, rules.JUMP_FACTOR * float(np.percentile(steps, 90)))
        if steps.max() > limit:
            yield rules.Fault("pose-jumps", strip.spots[int(steps.argmax()) + 1], float(steps.max()) / limit)
            return


STRIP_RULES: tuple[Callable[[Strip, touch_options.CheckLimits], Iterator[rules.Fault]], ...] = (
    frozen,
    still,
    wrong_times,
    jumps,
)
"""Rules for a single strip."""
