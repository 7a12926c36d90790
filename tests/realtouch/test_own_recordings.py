"""Recordings of a laboratory become data sets by one command each, and equal their source."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

import realtouch
from tests.command_line import call
from tests.realtouch import factories
from tests.realtouch.factories import TouchTruth
from tests.realtouch.images_of_others import write_table
from tests.realtouch.videos_of_others import packets_of

TOUCHES = factories.make_round(3, 4, (96, 72), (30, 40), noise=1.0).touches
LABELS = ["mug", "fork"] * 2


def force_of(touch: TouchTruth) -> np.ndarray:
    """Return forces, newtons, nearly all of which float32 rounds."""
    return np.where(np.arange(touch.frames) >= touch.contact_start, 1.1, 0.1) + 0.01 * np.arange(touch.frames)


def videos(home: Path) -> tuple[str, ...]:
    """Write an AVI for each touch, poses and forces at the rate of the camera, and a table of classes."""
    for number, touch in enumerate(TOUCHES):
        (home / f"take{number}.avi").write_bytes(factories.encode_avi(touch.pixels))
        columns = [touch.time_s, *1000 * touch.position_m.T, *touch.quaternion.T, force_of(touch)]
        names = ("time_s", "x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw", "force_n")
        rows = np.transpose(columns).tolist()
        write_table(home, [dict(zip(names, row, strict=True)) for row in rows], f"take{number}.csv")
    lines = [{"file": f"take{number}.avi", "object": label} for number, label in enumerate(LABELS)]
    write_table(home, lines, "labels.csv")
    return ("--map", "label=object", "--map", "pose=x_mm,y_mm,z_mm,qx,qy,qz,qw")


def images(home: Path) -> tuple[str, ...]:
    """Write images, and a table in millimetres and degrees."""
    names = ("x", "y", "z", "roll_deg", "pitch_deg", "yaw_deg")
    lines: list[dict[str, Any]] = []
    for number, touch in enumerate(TOUCHES):
        Image.fromarray(touch.pixels[touch.peak]).save(home / f"{number}.png")
        euler = Rotation.from_quat(touch.quaternion[touch.peak]).as_euler("xyz", degrees=True)
        pose = [*1000 * touch.position_m[touch.peak], *euler]
        others = {"thing": LABELS[number], "Fz": force_of(touch)[touch.peak], "operator": "ann"}
        lines.append({"picture": f"{number}.png", **dict(zip(names, pose, strict=True)), **others})
    write_table(home, lines)
    words = ("--map", "image=picture", "--map", "label=thing", "--map", "force_n=Fz", "--length-unit", "mm")
    return (*words, "--map", f"pose={','.join(names)}", "--euler", "xyz")


@pytest.mark.parametrize("write", [videos, images])
def test_a_recording_becomes_a_set_that_equals_it(write: Callable[[Path], Any], tmp_path: Path) -> None:
    home, out = tmp_path / "home", tmp_path / "out"
    home.mkdir()
    assert call("realtouch", "import", home, *write(home), "--out", out) == 0
    touches = realtouch.load(out, "train").touches()
    names = touches.dataset.label_names
    assert [names[label] for label in touches.labels.tolist()] == LABELS
    for number, (touch, truth) in enumerate(zip(touches, TOUCHES, strict=True)):
        if write is videos:
            jpegs = packets_of(home / f"take{number}.avi")
            shown, poses, part = touch.clip.frames(), touch.clip.poses, slice(None)
            wanted = np.stack([np.asarray(Image.open(io.BytesIO(jpeg)).convert("RGB")) for jpeg in jpegs])
            np.testing.assert_allclose(touch.clip.timestamps_s, truth.time_s, rtol=0, atol=1e-6)
        else:
            shown, poses, part = touch.image, touch.gel_pose, truth.peak
            wanted = truth.pixels[truth.peak]
        np.testing.assert_array_equal(shown, wanted)
        np.testing.assert_allclose(np.asarray(poses.translation), truth.position_m[part], rtol=0, atol=1e-9)
        turned = np.abs((poses.rotation.as_quat() * truth.quaternion[part]).sum(axis=-1))
        np.testing.assert_allclose(turned, 1.0, atol=1e-9)
        np.testing.assert_array_equal(touch.extra["force_n"], force_of(truth)[part])
    assert call("tactile", "verify", out) == 0
    assert realtouch.contacts_by_image(touches).contact.any()
    assert call("tactile", "gallery", out, "--out", tmp_path / "gallery") == 0
    assert call("tactile", "card", out) == 0
