"""The published loaders and ours give the same values for the same folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import realtouch

pytestmark = [
    pytest.mark.oracle,
    # The published packages and their imports warn about deprecations.
    pytest.mark.filterwarnings("ignore"),
]


@pytest.fixture(scope="module")
def published() -> Any:
    pytest.importorskip("torchcodec", reason="torchcodec decodes the published clips; it is not installed")
    return pytest.importorskip("tactile_mnist", reason="tactile-mnist (extra `oracle`) is not installed")


def hub_dataset(folder: Path, split: str = "train") -> Any:
    datasets = pytest.importorskip("datasets")
    datasets.disable_progress_bars()
    return datasets.load_dataset(str(folder), split=split)


def assert_same_pose(ours: Any, theirs: Any) -> None:
    np.testing.assert_allclose(ours.as_matrix(), theirs.matrix, atol=1e-12)
    for name in ("translation", "matrix", "rotvec", "angle", "quaternion"):
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), atol=1e-12)
    np.testing.assert_allclose(ours.inv.matrix, theirs.inv.matrix, atol=1e-12)


def assert_same_common(ours: Any, theirs: Any) -> None:
    assert ours.id == theirs.id
    assert ours.label == theirs.label
    assert ours.object_id == theirs.object_id
    np.testing.assert_array_equal(ours.pos_in_cell, theirs.pos_in_cell)
    assert ours.info.keys() == theirs.info.keys()
    assert ours.info["gel_id"] == theirs.info["gel_id"]
    assert_same_pose(ours.info["object_pose"], theirs.info["object_pose"])


def assert_same_single(ours: Any, theirs: Any) -> None:
    assert_same_common(ours, theirs)
    poses = theirs.gel_pose_cell_frame
    np.testing.assert_array_equal(ours.gel_pose_cell_frame.position_m, poses.translation)
    np.testing.assert_allclose(ours.gel_pose_cell_frame.transform.as_matrix(), poses.matrix, atol=1e-12)
    np.testing.assert_allclose(ours.gel_pose_cell_frame.matrix, poses.matrix, atol=1e-12)
    np.testing.assert_allclose(ours.gel_pose_cell_frame.inv.matrix, poses.inv.matrix, atol=1e-12)
    assert_same_pose(ours.gel_pose_cell_frame[0], poses[0])
    assert len(ours.sensor_image) == len(theirs.sensor_image)
    for touch in range(len(ours.sensor_image)):
        np.testing.assert_array_equal(ours.sensor_image[touch], theirs.sensor_image[touch])
        assert_same_pose(ours.gel_pose_cell_frame[touch], poses[touch])


def assert_same_seq(ours: Any, theirs: Any) -> None:
    assert_same_common(ours, theirs)
    assert ours.video_length_frames.tolist() == theirs.video_length_frames
    for name in ("touch_start_time_rel", "touch_end_time_rel"):
        assert getattr(ours, name).tolist() == getattr(theirs, name)
    for touch, clip in enumerate(ours.sensor_video):
        assert ours.time_stamp_rel_seq[touch].tolist() == theirs.time_stamp_rel_seq[touch]
        our_poses, their_poses = ours.gel_pose_cell_frame_seq[touch], theirs.gel_pose_cell_frame_seq[touch]
        assert len(our_poses) == len(their_poses) == len(clip)
        for frame in range(0, len(clip), 9):
            assert_same_pose(our_poses[frame], their_poses[frame])
        assert_same_frames(clip, theirs.sensor_video[touch])


def assert_same_frames(clip: realtouch.TouchClip, decoder: Any) -> None:
    theirs = np.stack([np.asarray(frame).transpose(1, 2, 0) for frame in decoder])
    assert theirs.shape == (len(clip), *clip.size, 3)
    # libjpeg interpolates the halved colours in another way than FFmpeg.
    assert np.abs(clip.frames().astype(int) - theirs).max() <= 24
    assert np.abs(clip.frames().astype(int) - theirs).mean() < 1.0


@pytest.mark.parametrize("converted", [False, True])
def test_single(
    converted: bool, published: Any, single_folder: Path, seq_folder: Path, tmp_path: Path
) -> None:
    folder = single_folder
    if converted:
        folder = tmp_path / "single"
        realtouch.clips_to_images(seq_folder, folder, "peak")
    theirs = published.TouchSingleDataset(hub_dataset(folder))
    ours = realtouch.load(folder, "train")
    assert ours.label_names == theirs.label_names
    assert len(ours) == len(theirs) == 3
    for row in range(len(ours)):
        assert_same_single(ours[row], theirs[row])


@pytest.mark.parametrize("selected", [False, True])
def test_seq(selected, published, seq_folder, tmp_path):
    folder = seq_folder
    if selected:
        folder = tmp_path / "some"
        realtouch.select(seq_folder, folder, contact=True, limit=1)
    theirs = published.TouchSeqDataset(hub_dataset(folder))
    ours = realtouch.load(folder, "train")
    assert len(ours) == len(theirs) == (1 if selected else 3)
    for row in range(len(ours)):
        assert_same_seq(ours[row], theirs[row])


def test_torchcodec_reads_a_clip(published: Any, seq_folder: Path) -> None:
    clip = realtouch.load(seq_folder, "train")[0].sensor_video[0]
    decoder = clip.to_torchcodec()
    assert len(decoder) == len(clip)
    assert decoder.metadata.average_fps == pytest.approx(clip.fps)
