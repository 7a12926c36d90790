"""Maps of depth: their files, and the sets that `tactile-sim depth` writes."""

from __future__ import annotations

import json
import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import realtouch
from realtouch.convert import media_conversions
from realtouch.touches.media import decode_map, encode_map
from tactile_toolkit.errors import InputError
from tests.command_line import call
from tests.realtouch import factories


@dataclass(frozen=True)
class Reading:
    depth_m: np.ndarray
    error_m: np.ndarray


class GreyReader:
    """Reads a micrometre from each level of red."""

    def __init__(self, folder: str) -> None:
        if folder.endswith("missing"):
            raise InputError("no calibrated sensor")

    def read_depth(self, images: np.ndarray, *, fast: bool = False) -> Reading:
        red = images[..., 0].astype(np.float32) * np.float32(1e-6)
        return Reading(red, np.full_like(red, 2e-5 if fast else 1e-5))

    def to_dict(self) -> dict[str, Any]:
        return {"name": "grey"}


@pytest.fixture
def images(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(media_conversions, "_load_sensor", GreyReader)
    media_conversions._reader.cache_clear()
    return factories.bare_set(tmp_path / "images", "single")


def test_maps_keep_micrometres_and_refuse_what_they_cannot_hold() -> None:
    rng = np.random.default_rng(3)
    depth_m = rng.uniform(0, 0.065, (13, 17)).astype(np.float32)
    back = decode_map(encode_map(depth_m))
    assert back.dtype == np.float32
    assert np.abs(back - depth_m).max() < 0.51e-6
    assert (decode_map(encode_map(np.full((2, 2), -1.0))) == 0).all()
    for wrong in (np.array([[np.nan]]), np.array([[0.07]])):
        with pytest.raises(InputError, match=r"expected finite numbers of at most 0\.065535 m"):
            encode_map(wrong)
    for other in (factories.encoded(Image.new("L", (4, 4)), "PNG"), b"", encode_map(depth_m)[:60]):
        with pytest.raises(ValueError, match="expected a"):
            np.asarray(decode_map(other))


@pytest.mark.parametrize("fast", [False, True])
def test_a_set_gains_depth_in_metres_and_keeps_all_else(images: Path, tmp_path: Path, fast: bool) -> None:
    arguments = ["--fast"] if fast else []
    out = tmp_path / "depths"
    assert call("tactile-sim", "depth", images, "--sensor", "a", "--out", out, "-q", *arguments) == 0
    for split in ("train", "test"):
        before, after = realtouch.load(images, split), realtouch.load(out, split)
        assert len(before) == len(after)
        for old, new in zip(before, after, strict=True):
            assert len(new.depth_m) == len(new.depth_error_m) == new.touch_count
            np.testing.assert_array_equal(new.sensor_image[:], old.sensor_image[:])
            expected = old.sensor_image[:][..., 0] * 1e-6
            np.testing.assert_allclose(new.depth_m[:], expected, atol=1e-9)
            assert new.depth_m[[]].shape == (0, *expected.shape[1:])
            np.testing.assert_allclose(new.depth_error_m[0], (1 + fast) * 1e-5, atol=1e-9)
            np.testing.assert_allclose(new.extra["depth_max_m"], expected.max(axis=(1, 2)), rtol=1e-6)
            assert [each.shape for each in new.depth_m] == [each.shape[:2] for each in new.sensor_image]
    touch = pickle.loads(pickle.dumps(realtouch.load(out, "train").touches()[1]))
    np.testing.assert_allclose(touch.depth_m, touch.image[..., 0] * 1e-6, atol=1e-9)
    assert (touch.depth_error_m > 0).all()
    # The manifest names the sensor by its content, and a second run finds the set finished.
    options = json.loads((out / "manifest.json").read_text())["spec"]["options"]
    assert options["sensor"] == {"name": "grey"}
    assert options["fast"] is fast
    assert call("tactile", "verify", out, "-q") == 0
    card = (out / "README.md").read_text()
    assert "PNG of 16 bits, um" in card
    assert "tactile-sim depth" in card


def test_further_conversions_keep_the_maps_of_the_touches_that_they_keep(images, tmp_path):
    realtouch.add_depth(images, tmp_path / "depths", "a")
    realtouch.select(tmp_path / "depths", tmp_path / "some", split="train", limit=1)
    realtouch.resize(tmp_path / "depths", tmp_path / "small", 24, 18)
    (kept,) = realtouch.load(tmp_path / "some", "train")
    assert kept.depth_m[0].shape == kept.sensor_image[0].shape[:2]
    np.testing.assert_array_equal(kept.with_touches([1]).depth_m[0], kept.depth_m[1])
    small = realtouch.load(tmp_path / "small", "train")[0]
    assert small.sensor_image[0].shape[:2] == (18, 24)
    assert small.depth_m[0].shape == small.depth_error_m[0].shape == (18, 24)
    assert small.depth_m[0].mean() == pytest.approx(kept.depth_m[0].mean(), rel=0.01)
    # Read again, the maps are replaced.
    realtouch.add_depth(tmp_path / "depths", tmp_path / "again", "a", fast=True)
    assert realtouch.load(tmp_path / "again", "train")[0].depth_error_m[0][0, 0] == pytest.approx(2e-5)


def test_sets_without_depth_are_named(images: Path, tmp_path: Path) -> None:
    touch = realtouch.load(images, "train").touches()[0]
    with pytest.raises(InputError, match="depth_um"):
        _ = touch.depth_m
    clips = factories.bare_set(tmp_path / "clips", "seq")
    with pytest.raises(InputError, match=r"holds clips.*realtouch stills"):
        realtouch.add_depth(clips, tmp_path / "out", "a")
    with pytest.raises(InputError, match="no calibrated sensor"):
        realtouch.add_depth(images, tmp_path / "out", "missing")
