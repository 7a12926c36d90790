"""Scores of the twin of a hidden sensor, by its true properties, which only the tests know."""

from __future__ import annotations

import re
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

import tactile_sim
from tactile_sim.press.pressable import Pressable
from tests.tactile_sim.hidden_recordings import Recording
from tests.tactile_sim.hidden_sensors import Family, HiddenSensor, digits, draw_sensor

TRAIN_DIGITS, HELD_OUT_DIGITS = 5, 77
"""Seeds of the digits for the calibration of a sensor, and of those for its evaluation."""

_UNDETERMINED = re.compile(r"along (-?[\d.]+) degrees of the solid")


@dataclass(frozen=True)
class Score:
    """Scores of one sensor.

    ``image_error`` in parts of the noise; ``background_error`` of the background alone; ``depth_um`` and
    ``flat_um``, of a reader that sees nothing, mean absolute errors; ``pitch_error`` of mm per pixel,
    relative; ``placed`` and ``turned``, shares of the touches within 0.1 mm and 0.5 degrees; ``fit_s`` and
    ``read_s``,
    seconds of the fit and of an image.
    """

    family: str
    seed: int
    image_error: float
    background_error: float
    depth_um: float
    flat_um: float
    pitch_error: float
    placed: float
    turned: float
    fit_s: float
    read_s: float


def recordings_of(recording: Recording, *, has_backgrounds: bool = True) -> tactile_sim.Recordings:
    """Return the parts of a recording that a user has."""
    return tactile_sim.Recordings(
        recording.images,
        recording.object_ids,
        recording.solids,
        recording.backgrounds if has_backgrounds else recording.backgrounds[:0],
        sensor_m=recording.sensor_m,
        object_poses=recording.object_poses,
    )


def rendered(model: tactile_sim.SensorModel, recording: Recording) -> np.ndarray:
    """Return the images that a twin renders of the touches of a recording, at their true poses."""
    pictures = []
    for number, (x_m, y_m, turn_rad) in enumerate(recording.true_poses):
        solid = Pressable.of(recording.solids[int(recording.object_ids[number])], check=False)
        sensor = replace(model.sensor, press_m=model.sensor.gel_m - recording.press_m[number])
        stands = tactile_sim.pose(x_m, y_m, -solid.foot_m, turn_rad=turn_rad)
        pressed = tactile_sim.render_touch(solid, stands, tactile_sim.pose(), sensor)
        pictures.append(model.optics.render(pressed.depth_m[None], sensor, sensor.size_px)[0])
    return np.stack(pictures)


def score(
    sensor: HiddenSensor, touches: int = 20, held_out: int = 10, black: int | None = None
) -> tuple[Score, tactile_sim.SensorModel]:
    """Calibrate a twin with some touches, and evaluate it with touches of other digits.

    ``black`` is the number of a touch whose image is made black.
    """
    fitted = sensor.record(digits(4, TRAIN_DIGITS), touches, seed=0)
    if black is not None:
        fitted.images[black] = 0
    judged = sensor.record(digits(4, HELD_OUT_DIGITS), held_out, seed=1)
    start = time.perf_counter()
    progress: list[tuple[int, int]] = []
    model = tactile_sim.calibrate(recordings_of(fitted), on_progress=lambda *done: progress.append(done))
    assert progress[-1][0] == progress[-1][1]
    fit_s = time.perf_counter() - start
    start = time.perf_counter()
    depth_m = model.read_depth_m(judged.images)
    read_s = (time.perf_counter() - start) / held_out
    noise = judged.noise_levels
    plain = judged.backgrounds.mean(axis=0)
    placed, turned = _placed(model.report["touches"], fitted)
    made = Score(
        sensor.family,
        sensor.seed,
        image_error=_rms(rendered(model, judged) - judged.clean) / noise,
        background_error=_rms(plain - judged.clean) / noise,
        depth_um=1e6 * float(np.abs(depth_m - judged.depth_m).mean()),
        flat_um=1e6 * float(judged.depth_m.mean()),
        pitch_error=abs(model.report["mm_per_px"] / judged.mm_per_px - 1),
        placed=placed,
        turned=turned,
        fit_s=fit_s,
        read_s=read_s,
    )
    return made, model


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt((values.astype(float) ** 2).mean()))


def _placed(touches: Sequence[dict[str, Any]], recording: Recording) -> tuple[float, float]:
    """Return the shares of used touches whose place and turn are right where they are determined."""
    places, turns = [], []
    for each, (x_m, y_m, turn_rad) in zip(touches, recording.true_poses, strict=True):
        if not each["used"]:
            continue
        # The point of the solid under the sensor, in its own frame.
        cosine, sine = np.cos(turn_rad), np.sin(turn_rad)
        point = np.array([-cosine * x_m - sine * y_m, sine * x_m - cosine * y_m])
        away = np.array([each["x_m"], each["y_m"]]) - point
        words = str(each.get("undetermined", ""))
        for found in _UNDETERMINED.findall(words):
            angle = np.radians(float(found))
            along = np.array([np.cos(angle), np.sin(angle)])
            away = away - along * (along @ away)
        places.append(np.hypot(*away) <= 1e-4)
        turn = (each["turn_rad"] - turn_rad + np.pi) % (2 * np.pi) - np.pi
        turns.append(abs(turn) <= np.radians(0.5) or "turn" in words)
    return float(np.mean(places)), float(np.mean(turns))


def named_mistakes(family: Family, seed: int, mistake: str | None) -> set[str]:
    """Return the kinds of mistakes that are found in a recording with one that was planted, or with none."""
    recording = draw_sensor(seed, family).record(digits(4, TRAIN_DIGITS), 20, mistake=mistake)
    return {each.kind for each in tactile_sim.find_mistakes(recordings_of(recording))}


def table(scores: Sequence[Score]) -> str:
    """Return medians and worst tenths as a table in Markdown."""
    names = [name for name in asdict(scores[0]) if name not in ("family", "seed")]
    # For these, small values are bad.
    shares = {"placed", "turned"}
    lines = [f"| {len(scores)} sensors, {scores[0].family} | median | worst tenth |", "| --- | --- | --- |"]
    for name in names:
        values = np.array([getattr(each, name) for each in scores])
        worst = np.quantile(values, 0.1 if name in shares else 0.9)
        lines.append(f"| {name} | {np.median(values):.3g} | {worst:.3g} |")
    return "\n".join(lines)
