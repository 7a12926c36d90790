"""Recordings of a laboratory become data sets by one command each, and equal their source."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import realtouch
from tests.command_line import call
from tests.realtouch import own_recordings as own
from tests.realtouch.own_recordings import Session

LEAST_PSNR_DB = 30.0  # of x264 at CRF 12 and of FFmpeg at its best quality, stored as JPEG of quality 95

MAKERS = (
    *(own.mjpeg_avi, own.h264_mp4, own.png_and_euler),
    *(own.class_folders, own.long_video, own.zarr3_buffer),
)
BY_EXPORT = ("lerobot", "oxt", "flat")


def psnr_db(found: np.ndarray, wanted: np.ndarray) -> float:
    error = np.mean((found.astype(float) - wanted) ** 2)
    return float(10 * np.log10(255**2 / max(error, 1e-9)))


def pixels_of(touches: Any) -> list[np.ndarray]:
    if isinstance(touches[0].round, realtouch.TouchSeqRound):
        return [touch.clip.frames() for touch in touches]
    return [touch.image for touch in touches]


def require_equal(touches: Any, session: Session) -> None:
    """Compare a set with its source: pixels, classes, poses, times and forces."""
    assert len(touches) == len(session.pixels)
    for found, wanted in zip(pixels_of(touches), session.pixels, strict=True):
        if session.lossless:
            np.testing.assert_array_equal(found, wanted)
        else:
            assert psnr_db(found, wanted) > LEAST_PSNR_DB
    if session.labels:
        names = touches.dataset.label_names
        assert [names[label] for label in touches.labels.tolist()] == session.labels
    else:
        assert set(touches.labels.tolist()) == {-1}
    poses = zip(session.position_m, session.quaternion, strict=True)
    for touch, (position_m, quaternion) in zip(touches, poses, strict=False):
        found = touch.clip.poses if position_m.ndim == 2 else touch.gel_pose
        np.testing.assert_allclose(np.asarray(found.translation), position_m, rtol=0, atol=1e-9)
        turned = np.abs((found.rotation.as_quat() * quaternion).sum(axis=-1))
        np.testing.assert_allclose(turned, 1.0, atol=1e-9)
    for touch, time_s in zip(touches, session.time_s, strict=False):
        np.testing.assert_allclose(touch.clip.timestamps_s, time_s, rtol=0, atol=1e-6)
    for touch, force_n in zip(touches, session.force_n, strict=False):
        np.testing.assert_array_equal(touch.extra["force_n"], force_n)


@pytest.fixture(params=MAKERS, ids=lambda make: make.__name__, scope="module")
def made(request: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Session, Path]:
    """A recording and its imports, which tests must not change."""
    if request.param is own.zarr3_buffer:
        pytest.importorskip("zarr", reason="needs zarr, of the extra dev")
    folder = tmp_path_factory.mktemp(request.param.__name__)
    session = request.param(folder / "source")
    assert call("realtouch", "import", session.source, *session.words, "--out", folder / "out") == 0
    return session, folder / "out"


@pytest.mark.one_at_a_desk
def test_a_recording_becomes_a_set_that_equals_it(made: tuple[Session, Path], tmp_path: Path) -> None:
    session, out = made
    touches = realtouch.load(out, "train").touches()
    if session.words[:2] == ("--cut", "contact"):
        assert len(touches) == len(session.pixels)
        for touch, wanted in zip(touches, session.pixels, strict=True):
            window = touch.clip.contact_window
            assert abs((window.stop - window.start) - len(wanted)) <= 3
            middle = len(wanted) // 2
            assert psnr_db(touch.clip[window][middle], wanted[middle]) > LEAST_PSNR_DB
    else:
        require_equal(touches, session)
    assert call("tactile", "verify", out) == 0
    contacts = realtouch.contacts_by_image(touches)
    assert contacts.contact.any()
    for command in ("gallery", "card"):
        written = ("--out", tmp_path / command) if command == "gallery" else ()
        assert call("tactile", command, out, *written) == 0


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("layout", BY_EXPORT)
def test_it_goes_out_and_comes_back(made: tuple[Session, Path], layout: str, tmp_path: Path) -> None:
    _, out = made
    there, back = tmp_path / "there", tmp_path / "back"
    assert call("tactile", "export", out, "--split", "train", "--format", layout, "--out", there) == 0
    assert call("realtouch", "import", there, "--out", back) == 0
    before, after = (realtouch.load(each, "train").touches() for each in (out, back))
    assert len(before) == len(after)
    assert before.labels.tolist() == after.labels.tolist()
    for old, new in zip(before, after, strict=True):
        if layout == "oxt" and hasattr(old.round, "sensor_video"):  # pixels, which a clip has as JPEG again
            assert psnr_db(old.clip.frames(), new.clip.frames()) > 40
        elif layout == "flat" or not hasattr(old.round, "sensor_video"):
            np.testing.assert_array_equal(old.image, new.image)
        else:
            np.testing.assert_array_equal(old.clip.frames(), new.clip.frames())
        if old.round.row.has_poses:
            of_clip = new.round.row.kind == "seq"
            poses = [each.clip.poses if of_clip else each.gel_pose for each in (old, new)]
            tolerance_m = {"lerobot": 1e-6}.get(layout, 1e-9)  # single precision there
            np.testing.assert_allclose(poses[0].translation, poses[1].translation, atol=tolerance_m)
