"""`realtouch reproduce --calibrate` on touches of a hidden sensor, stored like the published ones."""

from __future__ import annotations

import inspect
import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import tactile_sim
from tactile_sim.twin.calibration import model_of
from tactile_toolkit.mesh import pack_mesh
from tests.command_line import call
from tests.realtouch.factories import RoundTruth, TouchTruth, single_rows, write_set
from tests.tactile_sim.hidden_sensors import Recording, digits, draw_sensor
from tests.tactile_sim.made_up_twin import made_up_twin
from tests.tactile_sim.twin_scores import recordings_of

TOUCHES, ON_PLATE = 4, 2  # of each round


def touch_of(image: np.ndarray, position_m: np.ndarray, turn_rad: float, *, is_on_digit: bool) -> TouchTruth:
    """Return a touch of one frame; the gel looks down."""
    quaternion = np.array([[np.cos(turn_rad / 2), np.sin(turn_rad / 2), 0.0, 0.0]])
    return TouchTruth(1, 0, 0, 0, is_on_digit, position_m[None], quaternion, image[None])


def rounds_of(made: Recording) -> list[dict]:
    """Return a row for each solid: its touches, and some of the bare plate."""
    rows = []
    for solid in sorted(made.solids):
        chosen = np.flatnonzero(made.object_ids == solid)
        # Solids are not turned; instead, the sensor is turned the other way.
        touches = []
        for number in chosen:
            turn = made.object_poses[number, 2]
            away = made.sensor_m[number, :2] - made.object_poses[number, :2]
            back = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
            at_m = np.array([*(back @ away), made.sensor_m[number, 2]])
            touches.append(touch_of(made.images[number], at_m, -turn, is_on_digit=True))
        free_m = np.array([0.05, 0.05, made.sensor_m[chosen, 2].min() - 0.007])
        touches += [touch_of(made.backgrounds[n], free_m, 0.0, is_on_digit=False) for n in range(ON_PLATE)]
        places = np.array([each.position_m[0, :2] for each in touches])
        truth = RoundTruth(f"2023-09-28_15-00-{solid:02d}_0-0", solid, solid, 1, 0.0, touches, places)
        (row,) = single_rows([truth], png)
        rows.append({**row, "info.object_pose.position": np.zeros(3)})
    return rows


def png(pixels: np.ndarray) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG")
    return stream.getvalue()


@pytest.fixture(scope="module")
def made() -> Recording:
    return draw_sensor(3, "phong", (96, 72)).record(digits(3), 3 * TOUCHES)


@pytest.fixture
def folder(made: Recording, tmp_path: Path) -> Path:
    write_set(tmp_path / "set", {"train": rounds_of(made), "test": rounds_of(made)}, "single")
    (tmp_path / "solids").mkdir()
    for number, solid in made.solids.items():
        (tmp_path / "solids" / f"{number}.stl").write_bytes(pack_mesh(solid, ".stl"))
    return tmp_path


def reproduce(folder: Path) -> Path:
    out = folder / "out"
    words = ("reproduce", folder / "set", "--calibrate", out, "--solids", folder / "solids", "-q")
    assert call("realtouch", *words) == 0
    return out


def test_touches_of_digits_are_calibrated_with(made, folder, monkeypatch) -> None:
    """The twin is made of the touches of solids, with their poses; figures and sheet are written.

    `test_twin.py` shows that such recordings are explained.
    """
    given, takes = [], inspect.signature(tactile_sim.calibrate)

    def calibrated(recordings, **options):
        takes.bind(recordings, **options)
        given.append(recordings)
        report = {"image_error_levels": 1.0, "noise_levels": 1.0, "residual_levels": 0.0}
        background = np.full((72, 96, 3), 100.0, np.float32)
        return model_of(replace(made_up_twin(), background=background, report=report), "mine")

    monkeypatch.setattr(tactile_sim, "calibrate", calibrated)
    out = reproduce(folder)
    (recordings,) = given
    assert tactile_sim.find_mistakes(recordings) == []
    order = np.argsort(made.object_ids, kind="stable")
    np.testing.assert_array_equal(recordings.object_ids, made.object_ids[order])
    np.testing.assert_array_equal(recordings.images, made.images[order])
    np.testing.assert_allclose(recordings.places()[:, :2], recordings_of(made).places()[order, :2], atol=1e-6)
    turns = recordings.places()[:, 2] - recordings_of(made).places()[order, 2]
    np.testing.assert_allclose(np.sin(turns / 2), 0, atol=1e-6)
    figures = json.loads((out / "figures.json").read_text())
    assert figures["report"]["noise_levels"] == 1.0
    assert figures["held_out"]["images"] == len(made.images)
    with Image.open(out / "figures.png") as sheet:
        assert sheet.size == (6 * 96, 3 * 72)
