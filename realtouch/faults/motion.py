"""Poses and times of touches: jumps, standing still, gaps, and times that run back."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from realtouch.faults.rules import JUMP_FACTOR, MIN_STILL, MIN_TURN_DEG, Fault, Spot
from realtouch.faults.seen import runs_of
from realtouch.poses import Poses
from realtouch.stored_round import StoredRound, as_seconds
from realtouch.touch_clips import TouchClip
from realtouch.touch_options import CheckLimits
from tactile_toolkit.array_types import Float64

_FEWEST_STEPS = 4  # fewer have no usual step
_SAME_M, _SAME_QUATERNION = 1e-7, 1e-6  # a robot at rest measures noise beyond these
_FAR = 10.0  # touches of a round lie further apart than frames, by about this factor


def clip_times_s(row: StoredRound, touch: int) -> Float64:
    """Return the times of the frames of a clip as they are stored, shape (N,), seconds; NaN where missing.

    The clock of the file where no times are stored.
    """
    if row.has("time_stamp_rel_seq"):
        return as_seconds(row.cut("time_stamp_rel_seq", 0, touch)[0])
    return TouchClip(row, touch).media_times_s


def time_faults(at: Spot, time_s: Float64, limits: CheckLimits) -> Iterator[Fault]:
    """Yield times that are missing or run back, and else gaps between them; the worst of a clip."""
    steps = np.diff(time_s)
    if not np.isfinite(time_s).all() or (steps < 0).any():
        frame = int(np.argmin(np.where(np.isfinite(steps), steps, -np.inf))) + 1 if len(steps) else 0
        back_s = -float(np.nanmin(np.append(steps[np.isfinite(steps)], 0.0)))
        yield Fault("times-run-back", at._replace(frame=frame), back_s)
        return
    usual = float(np.median(steps)) if len(steps) >= _FEWEST_STEPS else 0.0
    if usual > 0 and steps.max() >= limits.gap * usual:
        frame = int(np.argmax(steps))
        after = at._replace(frame=frame + 1)
        yield Fault("dropped-frames", after, float(steps[frame]) / usual, at._replace(frame=frame))


def clip_jumps(at: Spot, poses: Poses, limits: CheckLimits) -> Iterator[Fault]:
    """Yield the worst jump of the poses of a clip, in position or turn."""
    if len(poses.position_m) <= _FEWEST_STEPS:
        return
    moved_mm = 1e3 * np.linalg.norm(np.diff(poses.position_m, axis=0), axis=1)
    quaternion = poses.quaternion / np.linalg.norm(poses.quaternion, axis=1, keepdims=True)
    # A quaternion and its negative are one rotation.
    cosine = np.abs((quaternion[1:] * quaternion[:-1]).sum(axis=1)).clip(0, 1)
    turned_deg = np.degrees(2 * np.arccos(cosine))
    for steps, least in ((moved_mm, limits.jump_mm), (turned_deg, MIN_TURN_DEG)):
        limit = max(least, JUMP_FACTOR * float(np.percentile(steps, 90)))
        if steps.max() > limit:
            frame = int(np.argmax(steps))
            beside = at._replace(frame=frame)
            yield Fault("pose-jumps", at._replace(frame=frame + 1), float(steps[frame]) / limit, beside)
            return


def far_touches(spots: list[Spot], position_m: Float64, limits: CheckLimits) -> Iterator[Fault]:
    """Yield the touches of a round, at (T, 3), that are far away from all others."""
    if len(spots) <= _FEWEST_STEPS:
        return
    far_mm = 1e3 * np.linalg.norm(position_m - np.median(position_m, axis=0), axis=1)
    limit = max(_FAR * limits.jump_mm, JUMP_FACTOR * float(np.median(far_mm)))
    for touch in np.flatnonzero(far_mm > limit).tolist():
        yield Fault("pose-jumps", spots[touch], float(far_mm[touch]) / limit)


def still_runs(poses: Poses, least: int = MIN_STILL) -> list[tuple[int, int]]:
    """Return start and length of each run of equal poses."""
    moved = np.abs(np.diff(poses.position_m, axis=0)).max(axis=1, initial=0)
    turned = np.abs(np.diff(poses.quaternion, axis=0)).max(axis=1, initial=0)
    return runs_of((moved <= _SAME_M) & (turned <= _SAME_QUATERNION), least)


def moved_mm(poses: Poses, start: int, length: int) -> float:
    """Return how far the gel moves over some poses, millimetres."""
    part = poses.position_m[start : start + length]
    return float(1e3 * np.linalg.norm(np.ptp(part, axis=0)))
