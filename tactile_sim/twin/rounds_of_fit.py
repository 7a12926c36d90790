"""Run a fit from coarse to fine images, leave out the touches that fit badly, and report the result."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from tactile_sim.press.sensors import SensorModel
from tactile_sim.twin.fitting import FIRST_DRIFT, MIN_DRIFT, Fit, Steps
from tactile_sim.twin.gel import OF_THE_VIEW, Fitted
from tactile_sim.twin.mistakes import MIN_TOUCHES
from tactile_sim.twin.recordings import Recordings, Relief
from tactile_toolkit.value_types import Float64

# First guesses, close to Taxim's calibration of the GelSight Mini.
_WIDTH_M = 9e-4
_LAST_M = 6e-5
_CONTACT = 0.6
_BLUR_M = 6e-5
_LAMP_DISTANCE = 1.28  # 15 mm for a GelSight Mini
_LAMP_HEIGHT = 0.3
_LOBE = 0.5  # between lamps that send light evenly, and diodes
_RISE = 0.15  # between that of gels that are pulled down, and that of elastic ones, 0.5 to 0.8
# Expected errors of poses: x and y, metres; turn, radians; press depth, metres.
_SPREAD = np.array([2e-4, 2e-4, 0.015, 1e-4])
_UNKNOWN_PRESS_M = 5e-4
_MATCHED_SPREAD = np.array([1e-3, 1e-3, 0.08])


class _Round(NamedTuple):
    """Width of the images, steps, moving geometry, and ridge, which leaves more to lamps and geometry."""

    width_px: int
    steps: int
    moving: tuple[Fitted, ...]
    ridge: float


_PULLED = tuple(value for value in Fitted if value is not Fitted.POISSON)
# The blur by the skin of an elastic gel stays: images hardly change with it where it is less than a pixel.
_ELASTIC = (Fitted.SIZE, Fitted.GEL, Fitted.POISSON, *OF_THE_VIEW)
_COARSE_ROUND = _Round(80, 6, tuple(value for value in _PULLED if value is not Fitted.LAST), 1.0)
# Only elastic gels rise: by 0.4 to 0.9 after the first round, others by -0.1 to 0.1.
_ELASTIC_RISE = 0.3
_POISSON_RATIO = 0.48  # of silicones, first guess
_PULLED_ROUNDS = [_Round(160, 10, _PULLED, 0.1)]
_ELASTIC_ROUNDS = [_Round(80, 6, _ELASTIC, 1.0), _Round(160, 4, _ELASTIC, 0.1)]

_PASSES = 3
STEPS = _COARSE_ROUND.steps + sum(each.steps for each in _PULLED_ROUNDS) + _PASSES

_SETTLED_MOVE = 0.015  # a round ends after a step that is smaller, in parts of the expected spread
_MISFIT = 3.0  # as a multiple of the median error
_LOOSE_M = 1e-4
_LOOSE_RAD = np.deg2rad(0.5)


def start_fit(recordings: Recordings, positions: Float64, level_m: Float64 | None, start: SensorModel) -> Fit:
    """Return a fit that starts from a geometry, and from points under the sensor and turns (N, 3).

    ``level_m`` (N,) are the heights of the sensor, NaN where unknown; None if poses were found by matching.
    """
    reliefs = {key: Relief.of(recordings.mesh(key)) for key in recordings.solids}
    of_gel = (start.gel_mm / 1e3, _WIDTH_M, _LAST_M, _CONTACT)
    shape = np.array([0.0, 0.0, *of_gel, _BLUR_M, 0.0, _RISE, 0.0, _LAMP_DISTANCE, _LAMP_HEIGHT, _LOBE, 0.0])
    guess_m = np.array([start.width_mm, start.height_mm]) / 2e3
    count = len(recordings)
    poses = np.column_stack([positions, np.zeros(count)])
    spread = np.tile(_SPREAD, (count, 1))
    known = np.zeros(count)
    if level_m is not None:
        known = level_m.copy()
    fit = Fit(recordings, reliefs, guess_m, shape, poses, known, spread, recordings.gel_at_rest())
    missing = np.isnan(known) if level_m is not None else np.ones(count, bool)
    spread[missing, 3] = _UNKNOWN_PRESS_M
    if level_m is None:  # poses were found by matching
        spread[:, :3] = _MATCHED_SPREAD
    for touch in np.flatnonzero(missing).tolist():
        fit.set_press(touch, start.gel_mm / 1e3 - start.press_m)
    return fit


def run_coarse(fit: Fit, steps: Steps) -> float:
    """Run the first round of a fit; return how far it moves stated heights, RMS in metres.

    What all touches have in common is the thickness of the gel.
    """
    # Without gains: as long as touches are not explained, their shadows look like another light.
    _run_round(fit, steps, _COARSE_ROUND, FIRST_DRIFT)
    fit.choose_lamps()
    known = fit.used & (fit.spread[:, 3] < _UNKNOWN_PRESS_M)
    moved_m = fit.poses[known, 3]
    return float(np.std(moved_m)) if known.sum() > 1 else 0.0


def run_fine(fit: Fit, steps: Steps) -> None:
    """Run the rest of a fit: fine images, and then the response and the background in full size."""
    rounds = _PULLED_ROUNDS
    if fit.shape[Fitted.RISE] > _ELASTIC_RISE:
        fit.shape[Fitted.POISSON] = fit.shape_guess[Fitted.POISSON] = _POISSON_RATIO
        rounds = _ELASTIC_ROUNDS
    for settings in rounds:
        _run_round(fit, steps, settings)
    fit.choose_ridge()
    fit.set_shrink(1)
    for _ in range(_PASSES):
        fit.step()
        fit.refresh_background()
        steps.advance()


def _run_round(fit: Fit, steps: Steps, settings: _Round, least_drift: float = MIN_DRIFT) -> None:
    fit.set_shrink(max(1, round(fit.recordings.size_px[0] / settings.width_px)))
    fit.ridge = settings.ridge
    fit.step()
    for number in range(settings.steps):
        moved = fit.step(settings.moving)
        steps.advance()
        if moved < _SETTLED_MOVE:
            steps.advance(settings.steps - 1 - number)
            break
    leave_out_misfits(fit)
    fit.refresh_gains(least_drift)


def solid_scale(fit: Fit) -> tuple[float, float]:
    """Return the size of the touched solids over that of their meshes, and its standard deviation.

    The images only tell where meshes were touched; the stated positions are those on the solids. Without
    enough stated positions, the size is 1 and its deviation infinite.
    """
    # A stated turn that is off by 0.5 degrees moves a point 20 mm away more than the errors of positions.
    poses = fit.recordings.poses_on_solids(fit.poses[:, 2])
    trusted = fit.used & ~fit.off
    if poses is None or trusted.sum() < MIN_TOUCHES:
        return 1.0, np.inf
    stated = poses[trusted, :2] - poses[trusted, :2].mean(axis=0)
    matched = fit.poses[trusted, :2] - fit.poses[trusted, :2].mean(axis=0)
    square = float((matched * matched).sum()) + 1e-12
    scale = float((stated * matched).sum()) / square
    return scale, float(np.std(stated - scale * matched) / np.sqrt(square))


def leave_out_misfits(fit: Fit) -> None:
    """Leave out the touches whose error is far above that of the others."""
    for touch in range(len(fit.poses)):
        fit.residual(touch)
    bound = _MISFIT * np.median(fit.rms[fit.used])
    fit.used = fit.used & (fit.rms <= bound)


def fit_report(fit: Fit) -> dict[str, Any]:
    """Return the results of a fit as JSON values."""
    half_m = fit.half_m(fit.shape)
    width, height = fit.recordings.size_px
    pitch_mm = float(np.sqrt(np.prod(2e3 * half_m / [width, height])))
    shape = {value.name.lower(): float(fit.shape[value]) for value in Fitted}
    gel_values = {"gel_blur_mm": 1e3 * shape["width"], "contact": shape["contact"]}
    if shape["poisson"]:
        gel_values = {"poisson_ratio": shape["poisson"]}
    return {
        "mm_per_px": pitch_mm,
        "lens_k1": shape["lens"],
        "camera_mm": 1e3 / max(shape["camera"], 0.1),
        "gel_mm": 1e3 * shape["gel"],
        **gel_values,
        "camera_blur_px": 1e3 * shape["blur"] / pitch_mm,
        "ridge": fit.ridge,
        "noise_levels": fit.noise,
        "light_drift": fit.light_drift,
        "image_error_levels": float(np.median(fit.rms[fit.used])),
        "touches": [_touch(fit, touch) for touch in range(len(fit.poses))],
    }


def _touch(fit: Fit, touch: int) -> dict[str, Any]:
    x_m, y_m, turn_rad, _ = (float(value) for value in fit.poses[touch])
    values: dict[str, Any] = {
        "name": fit.recordings.names[touch],
        "object_id": int(fit.recordings.object_ids[touch]),
        "x_m": x_m,
        "y_m": y_m,
        "turn_rad": turn_rad,
        "press_m": fit.press_m(touch),
        "error_levels": float(fit.rms[touch]),
        "used": bool(fit.used[touch]),
    }
    if not fit.likely[touch]:
        return {**values, "reason": "no place on the solid stands out against the others"}
    if not fit.used[touch]:
        return {
            **values,
            "reason": f"its error is {fit.rms[touch]:.1f} levels, that of the others "
            f"{np.median(fit.rms[fit.used]):.1f}",
        }
    return {**values, **spread_of(fit, touch)}


def spread_of(fit: Fit, touch: int) -> dict[str, Any]:
    """Return the standard deviations of a pose, and the direction in which it is not determined."""
    noise = (fit.rms[touch] / fit.noise) ** 2
    floor = np.diag(1e-6 / np.square(_SPREAD))
    values, vectors = np.linalg.eigh(fit.information[touch] + floor * noise)
    # Where images are far from linear, the variance may not exceed that before the fit.
    values = np.maximum(values, noise * floor.diagonal().min())
    covariance = noise * (vectors / values) @ vectors.T
    along, directions = np.linalg.eigh(covariance[:2, :2])
    deviation = np.sqrt(np.diag(covariance))
    undetermined = []
    if along[1] > _LOOSE_M**2:
        angle = np.rad2deg(np.arctan2(directions[1, 1], directions[0, 1])) % 180
        undetermined.append(
            f"along {angle:.0f} degrees of the solid's frame, by {1e3 * np.sqrt(along[1]):.2f} mm"
        )
    if deviation[2] > _LOOSE_RAD:
        undetermined.append(f"the turn, by {np.rad2deg(deviation[2]):.1f} degrees")
    return {
        "x_std_m": float(deviation[0]),
        "y_std_m": float(deviation[1]),
        "turn_std_rad": float(deviation[2]),
        "undetermined": "; ".join(undetermined),
    }
