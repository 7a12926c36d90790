"""Calibrate a sensor: make its twin from touches of known solids."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from tactile_sim.optics.rendering import require_proportions
from tactile_sim.press.sensors import GELSIGHT_MINI, SensorModel
from tactile_sim.twin import matching, rounds_of_fit
from tactile_sim.twin.fitting import MIN_DRIFT, Fit, Steps
from tactile_sim.twin.gel import Fitted
from tactile_sim.twin.mistakes import MIN_TOUCHES, Mistake, find_mistakes
from tactile_sim.twin.reader import read_depth, train_reader, training_steps
from tactile_sim.twin.recordings import MIN_UNSATURATED, Recordings
from tactile_sim.twin.sensor_health import detail_levels
from tactile_sim.twin.twin import Twin, TwinOptics
from tactile_toolkit import run
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import Bool, Int64
from tactile_toolkit.wording import with_count

_MAX_LIGHT_DRIFT = 0.15  # of the gains of frames, root mean square
# Root mean square by the first round, which is held to stated heights: 0.06 to 0.11 mm if these are right,
# 0.17 to 0.25 mm if they are off by 0.4 mm.
_MAX_HEIGHT_ERROR_M = 1.5e-4
_SURE_SCALE = 3.0  # standard deviations
_MOST_OFF = 0.5  # share of touches that are off: beyond it, all are searched near their stated poses
_MIN_EXPLAINED = 0.4  # of the squared change of an image; the twins of hidden sensors explain 0.8 to 1


@run.one_blas_thread()
def calibrate(
    recordings: Recordings,
    *,
    name: str = "my-sensor",
    start: SensorModel = GELSIGHT_MINI,
    on_progress: Callable[[int, int], None] | None = None,
) -> SensorModel:
    """Make the twin of a sensor from touches of known solids.

    Parameters
    ----------
    recordings : Recordings
        At least 5 touches, better 20, of solids with slopes in all directions.
    name : str
        Name of the sensor in manifests and cards.
    start : SensorModel
        First guess of its geometry, which the fit refines. The size of a pixel should be right within a
        sixth, and the thickness of the gel within a millimetre; the proportions of the image are kept.
    on_progress : callable, optional
        Called with the number of steps done and the total.

    Returns
    -------
    SensorModel
        Sensor with ``optics``, ``read_depth_m`` and ``report``; ``save`` writes it into a folder.

    Raises
    ------
    InputError
        The images have other proportions than those of ``start``, :func:`find_mistakes` finds a fatal
        mistake, fewer than 5 touches can be used, or the solids explain little of the images.

    Notes
    -----
    The fit and the networks of the reader use BLAS: on another processor, the twin may differ in the last
    bits. A given twin renders the same bytes on one kind of processor.
    """
    mistakes = _correctable_mistakes(recordings, start)
    unsaturated_shares = recordings.unsaturated_shares()
    usable = np.flatnonzero(unsaturated_shares >= MIN_UNSATURATED)
    steps = Steps(on_progress, rounds_of_fit.STEPS + training_steps())
    fit = _fitted(recordings, start, mistakes, usable, steps)
    mistakes += [*_off_poses(fit, usable), *_wandering_light(fit), *_other_size(fit)]
    report = {**rounds_of_fit.fit_report(fit), "mistakes": [asdict(mistake) for mistake in mistakes]}
    for touch in np.flatnonzero(unsaturated_shares < MIN_UNSATURATED).tolist():
        report["touches"].insert(touch, _saturated(recordings, touch, unsaturated_shares[touch]))
    shape = fit.shape.copy()
    half_m = fit.half_m(shape)
    shape[Fitted.SIZE] = 0.0
    twin = Twin(shape, half_m, fit.coefficients.astype(np.float32), fit.background, {}, report)
    twin = replace(twin, reader=train_reader(twin, fit, steps=steps))
    report["residual_levels"] = _residual_levels(twin, fit)
    report |= detail_levels(recordings.images)
    return model_of(twin, name)


def _correctable_mistakes(recordings: Recordings, start: SensorModel) -> list[Mistake]:
    """Return the mistakes with which a fit is possible; InputError for any other."""
    # Else pixels would be stretched: the fit keeps their aspect ratio.
    require_proportions(
        recordings.size_px,
        (start.width_px, start.height_px),
        "state the sides of what the images show and their pixels: --start FILE.json",
    )
    mistakes = find_mistakes(recordings, start)
    fatal = [mistake for mistake in mistakes if mistake.is_fatal]
    if fatal:
        raise InputError(
            f"the recordings cannot be fitted ({fatal[0].kind}): {fatal[0].detail}", next="correct them"
        )
    return mistakes


def _fitted(
    recordings: Recordings, start: SensorModel, mistakes: list[Mistake], usable: Int64, steps: Steps
) -> Fit:
    """Run a fit to the usable touches; without stated heights, which is one more mistake, if they are wrong.

    Raises InputError if too few touches can be used, or the solids explain little of the images.
    """
    if any(mistake.kind == "heights" for mistake in mistakes):
        recordings = recordings.without_heights()
    fit = _usable_fit(recordings, start, mistakes, usable, steps)
    error_m = rounds_of_fit.run_coarse(fit, steps)
    if error_m > _MAX_HEIGHT_ERROR_M:
        detail = (
            f"the images contradict the stated heights z_m, by {1e3 * error_m:.2f} mm or more: heights are "
            "not used, but found from the images"
        )
        mistakes.append(Mistake("heights", detail, 1e3 * error_m))
        fit = _usable_fit(recordings.without_heights(), start, mistakes, usable, Steps())
        rounds_of_fit.run_coarse(fit, Steps())
    rounds_of_fit.run_fine(fit, steps)
    _require_explained(fit)
    return fit


def _usable_fit(
    recordings: Recordings, start: SensorModel, mistakes: Sequence[Mistake], usable: Int64, steps: Steps
) -> Fit:
    """Return a fit, ready to run, to the touches whose numbers are ``usable``."""
    if len(usable) < MIN_TOUCHES:
        raise InputError(
            f"{len(usable)} of {with_count(len(recordings), 'images')} can be used: of the others, over "
            f"{1 - MIN_UNSATURATED:.0%} of the pixels are saturated; expected at least {MIN_TOUCHES}",
            next="change the exposure of the camera and record again",
        )
    part = recordings
    if len(usable) < len(recordings):  # else the choice would copy all images
        part = recordings.chosen(usable)
    fit = _first_fit(part, start, steps)
    likely = fit.likely
    if likely.sum() < MIN_TOUCHES:
        raise InputError(
            f"{int(likely.sum())} of {len(recordings)} touches without poses have a pose that stands out; "
            f"expected at least {MIN_TOUCHES}",
            next="give approximate poses, or touch ends and corners of solids, not the middle of strokes",
        )
    fit.used = likely & _of_one_gel(usable, mistakes)
    if fit.used.sum() < MIN_TOUCHES:
        raise InputError(
            f"the gel changed halfway; {with_count(int(fit.used.sum()), 'usable touches')} of one gel; "
            f"expected at least {MIN_TOUCHES}",
            next="calibrate with touches of one gel",
        )
    return fit


def _saturated(recordings: Recordings, touch: int, unsaturated_share: float) -> dict[str, Any]:
    """Return the entry of a saturated image in the report."""
    return {
        "name": recordings.names[touch],
        "object_id": int(recordings.object_ids[touch]),
        "used": False,
        "reason": f"{1 - unsaturated_share:.0%} of its pixels are saturated: black or white",
    }


def _require_explained(fit: Fit) -> None:
    """Raise InputError if touches that were held out are little explained: such a twin would render noise."""
    if fit.explained < _MIN_EXPLAINED:
        raise InputError(
            f"the solids and their poses explain {max(fit.explained, 0):.0%} of how touches that were held "
            f"out change the images; expected at least {_MIN_EXPLAINED:.0%}",
            next="check that solids, poses, heights z_m and images are of the same touches",
        )


def _wandering_light(fit: Fit) -> list[Mistake]:
    """Return the mistake of a light that changes between frames; InputError if it changes too much."""
    drift = fit.light_drift
    if drift > _MAX_LIGHT_DRIFT:
        raise InputError(
            f"the light wanders by {drift:.1%} from frame to frame; expected at most {_MAX_LIGHT_DRIFT:.0%}",
            next="switch off the automatic exposure and white balance of the camera, and record again",
        )
    if drift < MIN_DRIFT:
        return []
    detail = (
        f"the light wanders by {drift:.1%} from frame to frame, which the twin corrects; better switch off "
        "the automatic exposure and white balance of the camera"
    )
    return [Mistake("light", detail, drift)]


def _other_size(fit: Fit) -> list[Mistake]:
    """Rescale a fit to solids that are not as large as their meshes, and return this mistake."""
    scale, deviation = rounds_of_fit.solid_scale(fit)
    if abs(scale - 1) < _SURE_SCALE * deviation:
        return []
    fit.rescale(scale)
    detail = (
        f"the touched solids are {abs(scale - 1):.1%} {'smaller' if scale < 1 else 'larger'} than their "
        f"meshes (within {deviation:.1%}): lengths refer to the solids as they are"
    )
    return [Mistake("scale", detail, scale)]


def _off_poses(fit: Fit, usable: Int64) -> Iterator[Mistake]:
    """Yield the touches whose stated pose did not explain their image, by their numbers ``usable``.

    If these are most touches, the mistake is one of all of them.
    """
    poses = fit.recordings.poses_on_solids()
    if poses is None:
        return
    distances_mm = 1e3 * np.hypot(*(fit.poses[:, :2] - poses[:, :2]).T)
    if fit.off.mean() >= _MOST_OFF:
        usual_mm = float(np.median(distances_mm[fit.off]))
        detail = (
            f"the poses of {fit.off.sum()} of {len(fit.off)} touches do not explain their images; they were "
            f"searched, and found {usual_mm:.1f} mm away in the median; "
            f"{np.count_nonzero(fit.off & ~fit.used)} are left out"
        )
        yield Mistake("pose", detail, usual_mm, tuple(usable[fit.off].tolist()))
        return
    for touch in np.flatnonzero(fit.off).tolist():
        away_mm = float(distances_mm[touch])
        fate = f"it was found {away_mm:.1f} mm away"
        if not fit.used[touch]:
            fate = "and no other pose does: it is left out"
        detail = f"the pose of touch {fit.recordings.names[touch]!r} does not explain its image; {fate}"
        yield Mistake("pose", detail, away_mm, (int(usable[touch]),))


def _of_one_gel(touches: Int64, mistakes: Sequence[Mistake]) -> Bool:
    """Return which of the touches are of one gel: if the gel changed, of the one with more touches."""
    chosen = np.ones(len(touches), bool)
    for mistake in mistakes:
        if mistake.kind == "gel-changed":
            second = np.isin(touches, mistake.touches)
            chosen = max(~second, second, key=np.count_nonzero)
    return chosen


def model_of(twin: Twin, name: str) -> SensorModel:
    """Return the model of a sensor, with its twin."""
    return SensorModel(name, **twin.geometry, source="tactile-sim calibrate", twin=twin)


def _first_fit(recordings: Recordings, start: SensorModel, steps: Steps) -> Fit:
    """Return a fit that starts from the stated poses; from matched ones if these are missing or far off."""
    poses = recordings.poses_on_solids()
    if poses is not None:
        assert recordings.sensor_m is not None, "poses follow from it"
        level_m = recordings.sensor_m[:, 2].copy()
        stated = rounds_of_fit.start_fit(recordings, poses, level_m, start)
        off = matching.are_off(stated)
        if off.mean() < _MOST_OFF:
            if off.any():
                searched, likely = matching.found_poses(stated, off, start)
                poses[off], level_m[off] = searched[off, :3], np.nan
            fit = rounds_of_fit.start_fit(recordings, poses, level_m, start)
            for touch in np.flatnonzero(off).tolist():
                matching.set_pose(fit, touch, searched[touch])
                fit.likely[touch] = likely[touch]
            fit.off = off
            return fit
    matched, likely = matching.matched_poses(recordings, start, poses, steps)
    fit = rounds_of_fit.start_fit(recordings, matched[:, :3], None, start)
    for touch, at in enumerate(matched):
        matching.set_pose(fit, touch, at)
    fit.likely = likely
    if poses is not None:
        fit.off = off
    return fit


def _residual_levels(twin: Twin, fit: Fit) -> float:
    """Return the error of images rendered from the depth read in them: RMS in levels, median over touches."""
    optics = TwinOptics(twin, lens=False)
    sensor = model_of(twin, "twin").sensor
    errors = []
    for touch in np.flatnonzero(fit.used):
        image = fit.recordings.images[touch]
        depth_m = sensor.gel_m - read_depth(twin, image[None]).depth_m.astype(np.float64)
        rendered = 255 * optics.shades(depth_m, sensor, twin.size_px)[0]
        errors.append(float(np.sqrt(np.mean((image - rendered) ** 2))))
    return float(np.median(errors))
