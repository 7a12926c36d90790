"""Figures with limits distinguish a changed sensor from an unchanged one."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tactile_sim.twin.sensor_health import SensorHealth, check_sensor, detail_levels, images_of
from tactile_toolkit.errors import InputError
from tests.tactile_sim.hidden_recordings import Recording
from tests.tactile_sim.hidden_sensors import HiddenSensor, digits, draw_sensor

SIZE = (120, 90)


@dataclass
class PerfectTwin:
    """Knows the depth and the image without noise of each touch of a hidden sensor."""

    of: HiddenSensor
    recording: Recording
    width_px: int = SIZE[0]
    height_px: int = SIZE[1]
    report: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.report = {"noise_levels": self.recording.noise_levels, "residual_levels": 0.0}
        flat = np.zeros(self.of._frame_shape)
        self.plain = self.of._camera(self.of._shown(flat, flat))

    def read_depth_m(self, images: np.ndarray) -> np.ndarray:
        # The most similar image of the recording, even if the gel has changed.
        known = self.recording.images.astype(float)
        rows = [int(((known - each) ** 2).mean(axis=(1, 2, 3)).argmin()) for each in images.astype(float)]
        return self.recording.depth_m[rows].astype(np.float32)

    def render_read(self, depth_m: np.ndarray) -> np.ndarray:
        pictures = []
        for each in depth_m:
            errors = np.abs(self.recording.depth_m - each).max(axis=(1, 2))
            clean = self.plain if each.max() < 1e-6 else self.recording.clean[int(errors.argmin())]
            pictures.append(np.rint(clean).astype(np.uint8))
        return np.stack(pictures)


@pytest.fixture(scope="module")
def twin() -> PerfectTwin:
    # The greatest noise of hidden sensors.
    sensor = replace(draw_sensor(4, "phong", SIZE), noise=3.0, jpeg=85)
    return PerfectTwin(sensor, sensor.record(digits(2), 12, seed=1))


def health(twin: PerfectTwin, images: np.ndarray) -> SensorHealth:
    return check_sensor(twin, images)  # type: ignore[arg-type]


def test_a_sensor_that_did_not_change_is_below_half_of_each_limit(twin: PerfectTwin) -> None:
    rng = np.random.default_rng(2)
    again = np.stack([twin.of._noisy(each, rng) for each in twin.recording.clean])
    found = health(twin, again)
    assert found.ok
    assert found.images == 12
    by_name = {each.name: each.value / each.limit for each in found.figures}
    assert by_name.pop("residual") == pytest.approx(1 / 1.5, rel=0.05)
    assert max(by_name.values()) < 0.5
    assert all(isinstance(each["value"], float) for each in found.to_dict()["figures"])


@pytest.mark.parametrize(
    ("change", "figures"),
    [
        (lambda images: np.clip(images * 1.08, 0, 255), {"colour gain", "background drift"}),
        (lambda images: images * [1.0, 0.93, 1.0], {"colour gain", "background drift"}),
        (lambda images: np.clip(images.astype(float) + 130, 0, 255), {"saturation", "background drift"}),
        (lambda images: images + 6 * np.sign(np.sin(np.arange(SIZE[0]) / 4))[:, None], {"residual"}),
    ],
)
def test_each_change_is_seen_in_its_figures(twin: PerfectTwin, change: Any, figures: set[str]) -> None:
    found = health(twin, np.asarray(np.rint(change(twin.recording.images)), np.uint8))
    assert figures <= {each.name for each in found.figures if not each.ok}
    assert not found.ok


def test_a_gel_with_markers_is_seen(twin: PerfectTwin) -> None:
    marked = replace(twin.of, markers=True)._marker_field(SIZE[1], SIZE[0])[..., None]
    found = health(twin, np.asarray(twin.recording.images * marked, np.uint8))
    (markers,) = [each for each in found.figures if each.name == "markers"]
    assert not markers.ok
    assert markers.value > 0.02


def compressed(images: np.ndarray) -> np.ndarray:
    pictures = []
    for image in images:
        stream = io.BytesIO()
        Image.fromarray(image).save(stream, "JPEG", quality=75, subsampling=2)
        pictures.append(np.asarray(Image.open(stream)))
    return np.stack(pictures)


def enlarged(images: np.ndarray) -> np.ndarray:
    return images.repeat(2, axis=1).repeat(2, axis=2)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (compressed, r"more likely the recording.*0\.\d+ times in colour: they were compressed otherwise"),
        (
            enlarged,
            "more likely the recording.*images have 240 x 180 pixels, those of the calibration 120 x 90",
        ),
        (np.copy, "^the sensor has changed: calibrate it again$"),
        (lambda images: np.clip(compressed(images) * 1.08, 0, 255), "^the sensor has changed"),
    ],
)
def test_another_compression_or_size_is_named_as_the_cause(
    twin: PerfectTwin, change: Any, words: str
) -> None:
    sensor = replace(twin.of, jpeg=0)
    raw = PerfectTwin(sensor, sensor.record(digits(2), 12, seed=1))
    raw.report |= detail_levels(raw.recording.images)
    usual = raw.recording.images
    assert not health(raw, usual).cause
    images = np.asarray(change(usual), np.uint8)
    (residual,) = [figure.value for figure in health(raw, images).figures if figure.name == "residual"]
    raw.report["noise_levels"] *= residual / 2  # so that the residual is 2, and its limit 1.5
    found = health(raw, images)
    assert not found.ok
    assert re.search(words, found.cause)
    assert found.to_dict()["cause"] == found.cause


def test_too_few_images_are_refused(twin: PerfectTwin) -> None:
    with pytest.raises(InputError, match=r"4 images to compare.*at least 5"):
        health(twin, twin.recording.images[:4])


def test_another_light_in_which_contact_is_seen_everywhere_is_a_change(twin: PerfectTwin) -> None:
    covered = replace(twin, recording=replace(twin.recording, depth_m=np.full((12, *SIZE[::-1]), 1e-3)))
    found = health(covered, np.asarray(twin.recording.images * 0.8, np.uint8))
    assert {"background drift", "colour gain"} <= {each.name for each in found.figures if not each.ok}


def test_images_are_read_from_folders_and_data_sets(twin: PerfectTwin, tmp_path: Any) -> None:
    twin.recording.write(tmp_path)
    found = images_of(tmp_path / "images")
    assert len(found) == 12
    np.testing.assert_array_equal(found[3], twin.recording.images[3])
    assert [len(images_of(tmp_path / "images", most)) for most in (1, 5)] == [1, 5]
    (tmp_path / "images" / "0000.png").write_bytes(b"no image")
    with pytest.raises(InputError, match=r"0000\.png.*cannot be read as an image"):
        images_of(tmp_path / "images")
