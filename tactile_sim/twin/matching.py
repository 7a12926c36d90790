"""Find the poses of touches that were recorded without poses.

The search first looks for poses on the solid whose slopes explain an image with any colours. True poses
agree on the colours of slopes and wrong poses do not, so the colours that explain the most over all images
are chosen. With these colours, the touches whose pose stands out give a first twin, which locates more
touches, and so on. A touch is left out if it fits badly, or fits almost as well in another pose. Along a
straight stroke, only the layers of the print and the lens distinguish poses; the fit reports such
directions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from tactile_sim.press.sensors import SensorModel
from tactile_sim.twin import gel, gel_kernels
from tactile_sim.twin.fitting import Fit, Steps
from tactile_sim.twin.gel import Fitted
from tactile_sim.twin.pose_search import (
    NEAR_M,
    Paint,
    PoseMatches,
    changes_of,
    near_poses,
    poses_by_images,
    poses_by_slopes,
)
from tactile_sim.twin.recordings import Recordings
from tactile_sim.twin.rounds_of_fit import start_fit
from tactile_toolkit.value_types import Bool, Float32, Float64

_SEARCH_PX, _FIT_PX = 40, 80  # widths of the images in the search and in the fit
_HYPOTHESES, _FINALISTS = 25, 8  # colours that each touch proposes, and colours that are refined
_COLOUR_STEPS = 6
_RIDGE_OF_COLOURS = 0.03
_MIDDLE = 1e-3  # share of the image that is coloured alike: lamps are far away from it
_PRESSES = ((0.75,), (0.75, 1.4), (0.5, 0.9, 1.8))  # of each round, as fractions of the usual press depth
_STEPS = 15  # of progress
_SEEDS = 5  # touches to which the first twin is fitted
# Unexplained share of the change of an image: at most 0.45 if poses are right, 0.5 if they are off by 1 mm.
_MAX_UNEXPLAINED = 0.5
_CHECK_STEPS, _GEOMETRY_STEPS = 2, 4
_GEOMETRY = (
    Fitted.SIZE,
    Fitted.LENS,
    Fitted.WIDTH,
    Fitted.CONTACT,
    Fitted.CAMERA,
)
_FIRST_PRESS = 0.9  # press depth that is tried first, as a fraction of the usual one
_RIDGES = (1.0, 0.3, 0.1)  # of each round: a high ridge extends what few touches show
_TRIED, _GOOD = 16, 5  # poses of a touch that are refined by two steps, and by more steps
_MAX_MOVE = np.array([1e-3, 1e-3, 0.1, 4e-4])  # of one step
_SPREAD = np.array([1.5e-3, 1.5e-3, 0.12, 8e-4])  # expected error of a pose
_HUBER = 3.0
_SAME_POSE = (1e-3, 0.17)  # metres and radians: poses that are closer are the same
_MIN_EXPLAINED = 0.75  # share of the change of an image
# Ratios of the error in any other pose to that in the best one: the touch is not searched again; it is used.
_SURE, _STANDS_OUT = 1.3, 1.1
_MAX_ERROR = 2.5  # as a multiple of the median


_Tried: TypeAlias = tuple[float, Float64, float]
"""Error of a pose, levels; the pose; and the height of the sensor, metres, to which the pose refers."""


@dataclass(eq=False, frozen=True)
class _Refined:
    """Poses of a touch (n, 4: x, y, turn, press depth), the best one first, and errors in levels.

    ``error`` is that of the best pose, ``other_error`` that of the next pose, and ``change`` that of
    rendering no contact.
    """

    poses: Float64
    error: float
    other_error: float
    change: float

    @property
    def at(self) -> Float64:
        return np.asarray(self.poses[0])

    @property
    def explained(self) -> float:
        return 1 - (self.error / self.change) ** 2

    @property
    def stands_out(self) -> float:
        return self.other_error / self.error


def are_off(fit: Fit) -> Bool:
    """Return which poses (N,) are too far off for a fit to correct: they explain little of their image."""
    _set_width(fit, _SEARCH_PX)
    fit.ridge, fit.spread[:] = _RIDGES[0], _SPREAD
    for moving in ((), *[_GEOMETRY] * _CHECK_STEPS):
        fit.step(moving)
    for touch in range(len(fit.poses)):
        fit.residual(touch)
    changes = [fit.change(touch) for touch in range(len(fit.poses))]
    return np.asarray(fit.rms / changes > _MAX_UNEXPLAINED)


def found_poses(fit: Fit, off: Bool, start: SensorModel) -> tuple[Float64, Bool]:
    """Search the touches that are off (N,) on the whole solid, with the colours of the others.

    Returns the points under the sensor, turns and press depths of all touches, (N, 4), and which of them are
    likely (N,).
    """
    _set_width(fit, _FIT_PX)
    fit.used = ~off
    for moving in ((), *[_GEOMETRY] * _GEOMETRY_STEPS):
        fit.step(moving)
    poses = np.column_stack([fit.poses[:, :3], [fit.press_m(touch) for touch in range(len(off))]])
    press_m = start.gel_mm / 1e3 - start.press_m
    touches = np.flatnonzero(off).tolist()
    candidates = _search(fit, touches, poses, tuple(share * press_m for share in _PRESSES[-1]), press_m, None)
    _set_width(fit, _FIT_PX)
    refined = [_refined(fit, touch, candidates[touch], _GOOD, 4) for touch in touches]
    likely = ~off
    for touch, result in zip(touches, refined, strict=True):
        poses[touch] = result.at
        likely[touch] = result.explained >= _MIN_EXPLAINED and result.stands_out >= _STANDS_OUT
    return poses, likely


def matched_poses(
    recordings: Recordings, start: SensorModel, near: Float64 | None = None, steps: Steps | None = None
) -> tuple[Float64, Bool]:
    """Return points under the sensor, turns and press depths (N, 4), and which of them are likely (N,).

    ``near`` (N, 3) are stated points and turns, which may be off by up to 5 mm and 17 degrees; touches of
    which they are known count as likely. Those farther away from their solid are searched everywhere on it.
    ``steps`` gets more steps for the search.
    """
    steps = steps or Steps()
    steps.total += _STEPS
    count = len(recordings)
    fit = start_fit(recordings, np.zeros((count, 3)), None, start)
    fit.lamps = gel_kernels.FEW_LAMPS  # to five touches, all of them fit shadows at random
    if near is not None:
        near = _near_solids(fit, near)
    press_m = start.gel_mm / 1e3 - start.press_m
    _set_width(fit, _SEARCH_PX)
    changes = changes_of(fit, range(count))
    colours = _common_colours(list(poses_by_slopes(fit, changes, press_m, near).values()))

    def slopes(surface: Float32, pitch_m: Float64) -> Float32:
        steep = np.stack([*np.gradient(surface, *pitch_m[::-1])], axis=2)
        return np.asarray(steep @ colours, np.float32)

    matches = poses_by_images(fit, changes, slopes, (_FIRST_PRESS * press_m,), press_m, near)
    best = np.array([matches[touch].at[0] for touch in range(count)])
    margins = np.array([matches[touch].margin for touch in range(count)])
    likely = np.isin(np.arange(count), np.argsort(-margins)[:_SEEDS])
    refined: dict[int, _Refined] = {}
    for shares, fit.ridge in zip(_PRESSES, _RIDGES, strict=True):
        steps.advance(_STEPS // len(_PRESSES))
        _learn(fit, best, likely)
        sure = [touch for touch, result in refined.items() if likely[touch] and result.stands_out >= _SURE]
        open_ = [touch for touch in range(count) if touch not in sure]
        worth = _search(fit, open_, best, tuple(share * press_m for share in shares), press_m, near)
        _set_width(fit, _FIT_PX)
        refined |= {touch: _refined(fit, touch, poses, _GOOD, 4) for touch, poses in worth.items()}
        best = np.array([best[touch] if touch in sure else refined[touch].at for touch in range(count)])
        likely = _likely([refined[touch] for touch in range(count)])
        if not likely.any():  # then there is nothing to learn colours from
            break
    return best, likely if near is None else likely | np.isfinite(near[:, 0])


def _near_solids(fit: Fit, near: Float64) -> Float64:
    """Return stated poses (N, 3), NaN for those that no pose on the solid is near to."""
    poses = near.copy()
    for touch, object_id in enumerate(fit.recordings.object_ids.tolist()):
        relief = fit.reliefs[object_id]
        sides_m = relief.corner[2:] * relief.heights_m.shape[::-1]
        below_m = relief.corner[:2] - near[touch, :2]
        if (np.maximum(below_m, -sides_m - below_m) > NEAR_M).any():
            poses[touch] = np.nan
    return poses


def _set_width(fit: Fit, width_px: int) -> None:
    fit.set_shrink(max(1, fit.recordings.size_px[0] // width_px))


def _search(
    fit: Fit,
    touches: list[int],
    best: Float64,
    presses_m: tuple[float, ...],
    most_m: float,
    near: Float64 | None,
) -> dict[int, Float64]:
    """Return the best poses (n, 4) of each touch, refined by two steps."""
    _set_width(fit, _SEARCH_PX)
    matches = poses_by_images(fit, changes_of(fit, touches), _paint_of(fit), presses_m, 1.1 * most_m, near)
    chosen = {}
    for touch, match in matches.items():
        tried = np.concatenate([best[touch][None], match.at[:_TRIED]])
        chosen[touch] = _refined(fit, touch, tried, 0, 0).poses[:_GOOD]
    return chosen


def _likely(results: list[_Refined]) -> Bool:
    errors = np.array([result.error for result in results])
    explained = np.array([result.explained for result in results]) >= _MIN_EXPLAINED
    unique = np.array([result.stands_out for result in results]) >= _STANDS_OUT
    likely = explained & unique
    if likely.any():
        likely &= errors <= _MAX_ERROR * np.median(errors[likely])
    return np.asarray(likely)


def _common_colours(matches: list[PoseMatches]) -> Float64:
    """Return the colours (2, 3) of slopes down and across that explain the most over all images."""
    cuts = np.cumsum([len(match.explained) for match in matches])[:-1]
    products = np.concatenate([match.products for match in matches])
    squares = np.concatenate([match.squares for match in matches])
    ridge = _RIDGE_OF_COLOURS * np.trace(squares, axis1=1, axis2=2).max() * np.eye(2)

    def explained(colours: Float64) -> Float64:
        mixed = (squares @ colours) * colours
        return np.asarray(2 * (products * colours).sum(axis=(1, 2)) - mixed.sum(axis=(1, 2)))

    def total(colours: Float64) -> float:
        return float(sum(max(part.max(), 0.0) for part in np.split(explained(colours), cuts)))

    proposed = [
        np.linalg.solve(match.squares[rank] + ridge, match.products[rank])
        for match in matches
        for rank in range(min(_HYPOTHESES, len(match.explained)))
    ]
    finalists = sorted(proposed, key=total, reverse=True)[:_FINALISTS]
    for rank, first in enumerate(finalists):
        colours = first
        for _ in range(_COLOUR_STEPS):
            parts = np.split(explained(colours), cuts)
            winners = [int(part.argmax()) for part in parts]
            weights = [max(part[winner], 0.0) ** 2 for part, winner in zip(parts, winners, strict=True)]
            chosen = list(zip(matches, winners, weights, strict=True))
            square = sum(weight * match.squares[winner] for match, winner, weight in chosen)
            product = sum(weight * match.products[winner] for match, winner, weight in chosen)
            colours = np.linalg.solve(square, product)
        finalists[rank] = np.asarray(colours)
    return np.asarray(max(finalists, key=total))


def set_pose(fit: Fit, touch: int, at: Float64) -> None:
    """Put a touch at a pose (x, y, turn, press depth)."""
    fit.poses[touch] = *at[:3], 0.0
    fit.set_press(touch, float(at[3]))


def _learn(fit: Fit, at: Float64, likely: Bool) -> None:
    """Fit colours and geometry to the touches whose pose is likely, and update these poses in ``at``."""
    _set_width(fit, _FIT_PX)
    for touch in range(len(at)):
        set_pose(fit, touch, at[touch])
    fit.pose_guess = fit.poses.copy()
    fit.used = likely.copy()
    fit.step()
    for _ in range(_GEOMETRY_STEPS):
        fit.step(_GEOMETRY)
    fit.step()
    for touch in np.flatnonzero(likely).tolist():
        at[touch] = *fit.poses[touch, :3], fit.press_m(touch)


def _paint_of(fit: Fit) -> Paint:
    """Return a function that colours a surface by the response of the fit in the middle of the image."""
    shape = gel.unbent(fit.shape)
    table = gel.response_table(fit.coefficients)

    def paint(surface: Float32, pitch_m: Float64) -> Float32:
        terms = np.zeros((*surface.shape, gel_kernels.TERMS), np.float32)
        terms[..., 0] = terms[..., gel_kernels.COLOURS :] = 1.0
        return gel.response(surface, pitch_m, shape, table, terms, np.full(2, _MIDDLE))

    return paint


def _refined(fit: Fit, touch: int, poses: Float64, good: int, steps: int) -> _Refined:
    """Refine the poses of a touch: two steps from each, then ``steps`` from the ``good`` best ones."""
    image, unsaturated = fit.image(touch)
    change: Float64 = np.asarray((image - fit.behind)[unsaturated], np.float64)
    tried = []
    for at in poses:
        set_pose(fit, touch, at)
        pose = fit.poses[touch].copy()
        level_m = float(fit.level_m[touch])
        tried.append((*_stepped(fit, touch, pose, change, unsaturated, 2), level_m))
    tried = _different(tried)
    for rank, (_, pose, level_m) in enumerate(tried[:good]):
        fit.level_m[touch] = level_m
        tried[rank] = (*_stepped(fit, touch, pose, change, unsaturated, steps), level_m)
    tried = _different(tried)
    at = np.empty((len(tried), 4))
    for rank, (_, pose, level_m) in enumerate(tried):
        fit.poses[touch], fit.level_m[touch] = pose, level_m
        at[rank] = *pose[:3], fit.press_m(touch)
    errors = [*(candidate[0] for candidate in tried), np.inf]
    return _Refined(at, errors[0], errors[1], float(np.sqrt(np.mean(change * change))))


def _different(tried: list[_Tried]) -> list[_Tried]:
    """Return poses in the order of their errors; of poses that are close together, only the best one."""
    kept: list[_Tried] = []
    for candidate in sorted(tried, key=lambda candidate: candidate[0]):
        others = np.array([better[1] for better in kept]).reshape(-1, 4)
        if not near_poses(others, candidate[1], _SAME_POSE).any():
            kept.append(candidate)
    return kept


def _stepped(
    fit: Fit, touch: int, pose: Float64, change: Float64, unsaturated: Bool, steps: int
) -> tuple[float, Float64]:
    """Move a pose by Gauss-Newton steps; return the least error, levels, and its pose."""
    guess = pose
    best = (np.inf, pose)
    for number in range(steps + 1):
        pressed = fit.pressed(touch, pose, fit.shape)
        base = fit.shown(fit.seen(pressed, fit.shape), fit.shape)
        residuals = change - base[unsaturated]
        error = float(np.sqrt(np.mean(residuals * residuals)))
        if error < best[0]:
            best = (error, pose)
        elif error > 1.02 * best[0]:
            break
        if number == steps:
            break
        derivatives = np.array(
            [column[unsaturated].ravel() for column in fit.derivatives(touch, pose, pressed, base)],
            np.float64,
        )
        bound = _HUBER * max(error, 1.0)
        weights = np.repeat(1 / np.maximum(1, np.abs(residuals).max(axis=1) / bound), 3)
        variance = 20 * max(error, 1.0) ** 2 / np.square(_SPREAD)
        square = (derivatives * weights) @ derivatives.T + np.diag(variance)
        slope = (derivatives * weights) @ residuals.ravel() - variance * (pose - guess)
        pose = pose + np.clip(np.linalg.solve(square, slope), -_MAX_MOVE, _MAX_MOVE)
    return best
