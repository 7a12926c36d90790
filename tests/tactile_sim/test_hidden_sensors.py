"""The sensors by which calibrations are judged have the stated properties."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tactile_sim
from tactile_toolkit.mesh import Mesh
from tests.tactile_sim.hidden_recordings import Recording
from tests.tactile_sim.hidden_sensors import HiddenSensor, digits, draw_sensor
from tests.tactile_sim.solids import block
from tests.tactile_sim.third_sensors import ThirdSensor, draw_third

SIZE = (96, 72)


def phong(seed: int = 3) -> HiddenSensor:
    return draw_sensor(seed, "phong", SIZE)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return phong().record(digits(2), 4, seed=1)


def test_the_same_seed_gives_the_same_recording_and_another_one_another(recording: Recording) -> None:
    again, other = (phong(seed).record(digits(2), 4, seed=1) for seed in (3, 4))
    np.testing.assert_array_equal(again.images, recording.images)
    assert np.abs(other.images.astype(float) - recording.images).mean() > 1
    assert 0.5 < recording.noise_levels < 4


@pytest.mark.parametrize("seed", [1, 100])
def test_a_near_camera_sees_what_is_pressed_in_larger(seed: int) -> None:
    """The area of a step grows with the square of its size; frames wander in brightness if they should."""
    sensor = draw_third(seed, "base", SIZE)
    x_mm, y_mm = sensor._places(np.zeros(sensor._frame_shape))
    step = np.where(np.hypot(x_mm, y_mm) < 5, 1.5, 0.0)
    area = (sensor._projected(step, step) > 0.7).sum() / (step > 0.7).sum()
    assert area == pytest.approx((1 - 1.5 / sensor.camera_mm) ** -2, abs=0.035)  # of edges of pixels
    grey = np.full((*SIZE[::-1], 3), 120.0)
    still, wandering = (draw_third(seed, variant, SIZE) for variant in ("base", "wander"))
    levels = [made._noisy(grey, np.random.default_rng(0)).mean() for made in (still, wandering)]
    assert levels[0] == pytest.approx(120, abs=0.5)
    assert 0.002 < abs(levels[1] / levels[0] - 1) < 0.06


def test_an_elastic_gel_rises_around_a_touch(monkeypatch: pytest.MonkeyPatch) -> None:
    """It keeps its volume: no plate at the height of the gel at rest holds it down."""
    least_mm = []
    project = ThirdSensor._projected

    def measured(sensor: ThirdSensor, frame: np.ndarray, gel_mm: np.ndarray) -> np.ndarray:
        least_mm.append(gel_mm.min())
        return np.asarray(project(sensor, frame, gel_mm))

    monkeypatch.setattr(ThirdSensor, "_projected", measured)
    made = draw_third(1, "base", SIZE).record(digits(2), 1)
    assert min(least_mm) < -0.05
    assert made.depth_m.min() == 0


def test_depth_is_how_far_the_solid_reaches_into_the_gel_at_its_true_pose() -> None:
    sensor = replace(phong(), lens=0.0)
    made = sensor.record({0: Mesh.of(block())}, 3, pose_errors=(0.0, 0.0))
    for number in range(3):
        x_m, y_m, turn = made.true_poses[number]
        window = (SIZE[0] * sensor.pitch_mm / 1e3, SIZE[1] * sensor.pitch_mm / 1e3)
        gel_m = sensor.gel_mm / 1e3
        like = tactile_sim.Sensor(SIZE, window, gel_m, gel_m - made.press_m[number])
        pressed = tactile_sim.render_touch(
            block(), tactile_sim.pose(x_m, y_m, turn_rad=turn), tactile_sim.pose(), like
        )
        np.testing.assert_allclose(made.depth_m[number], np.maximum(gel_m - pressed.depth_m, 0), atol=1e-8)
        # Without errors, the stated poses are the true ones.
        stated = made.object_poses[number, :2] - made.sensor_m[number, :2]
        np.testing.assert_allclose(stated, [x_m, y_m], atol=1e-12)
        assert made.sensor_m[number, 2] == pytest.approx(0.004 + gel_m - made.press_m[number])


def test_stated_poses_have_the_requested_errors() -> None:
    made = phong().record(digits(2), 40)
    off_m = made.object_poses[:, :2] - made.sensor_m[:, :2] - made.true_poses[:, :2]
    assert off_m.std() == pytest.approx(1e-4, rel=0.3)
    assert np.degrees(made.object_poses[:, 2] - made.true_poses[:, 2]).std() == pytest.approx(0.5, rel=0.3)


@pytest.mark.sim
def test_independent_colours_of_taxim_equal_those_of_the_project() -> None:
    pytest.importorskip("taxim", reason="taxim (extra `sim`) is not installed")
    sensor = replace(draw_sensor(0, "published"), noise=0.0)
    made = sensor.record(digits(2), 2)
    like = tactile_sim.Sensor((320, 240), (320 * sensor.pitch_mm / 1e3, 240 * sensor.pitch_mm / 1e3))
    optics = tactile_sim.make_optics("taxim")
    reference = 255 * optics.shades(np.asarray(like.gel_m - made.depth_m, float), like, (320, 240))
    plain = made.backgrounds.mean(axis=0)
    signal = np.abs(reference - plain).mean()
    assert np.abs(reference - made.clean).mean() < 0.25 * signal
    assert np.quantile(np.abs(reference - made.clean), 0.9) < 5
