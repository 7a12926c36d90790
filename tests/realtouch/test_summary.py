from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import realtouch
from realtouch.touch_card import contact_sheet
from tactile_toolkit.errors import InputError


def test_figures_of_clips_and_images(seq_folder: Path, single_folder: Path) -> None:
    clips = realtouch.summarise(realtouch.load(seq_folder, "train"))
    assert (clips.kind, clips.rounds, clips.touches, clips.objects) == ("seq", 3, 15, 3)
    assert clips.touches_per_round == (5, 5)
    assert clips.contact_share == pytest.approx(0.8)
    assert clips.image_size == (96, 72)
    assert clips.fps == 25.0
    assert clips.gel_ids == {"0": 2, "1": 1}
    assert {name: count for name, count in clips.labels.items() if count} == {"0": 1, "1": 1, "2": 1}
    lengths = np.concatenate([record.video_length_frames for record in realtouch.load(seq_folder, "train")])
    assert clips.clip_frames == (lengths.min(), int(np.median(lengths)), lengths.max())
    images = realtouch.summarise(realtouch.load(single_folder, "train"))
    assert (images.kind, images.clip_frames, images.fps, images.contact_share) == ("single", None, None, 0.8)
    assert images.to_dict()["touches"] == 15
    rule = (
        "the gel stopped 6 mm or more above the plate; the deepest touch of each round is taken as the plate"
    )
    assert (clips.contact_rule, images.contact_rule) == (rule, rule)
    with pytest.raises(InputError, match="empty data set"):
        realtouch.summarise(realtouch.load(single_folder, "train")[:0])


def test_sheets(seq_folder: Path) -> None:
    frames = realtouch.load(seq_folder, "train")[0].contact_frames()
    assert contact_sheet(frames).shape == (4 + 94, 4 + 5 * 124, 3)
    assert contact_sheet(frames[:2]).shape == (98, 4 + 2 * 124, 3)
    red, blue = np.zeros((2, 30, 40, 3), np.uint8)
    red[..., 0], blue[..., 2] = 255, 255
    sheet = contact_sheet([red, blue, red], columns=2, tile_width=40)
    assert sheet.shape == (2 * 34 + 4, 2 * 44 + 4, 3)
    assert sheet[10, 10].tolist() == [255, 0, 0]
    assert sheet[10, 60].tolist() == [0, 0, 255]
    assert sheet[50, 60].tolist() == [255, 255, 255]
