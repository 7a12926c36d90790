"""Touches in the layouts of other projects: each is read by the steps of its consumer, repeated here."""

from __future__ import annotations

import io
import json
import re
import tarfile
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import realtouch
from tactile_toolkit.errors import InputError, IntegrityError
from tests.realtouch import factories
from tests.realtouch.factories import Layout
from tests.realtouch.test_exchange import expected


def test_t3_reads_fota(source: Path, tmp_path: Path, small_shards: None) -> None:
    """Read like ``t3.data_loader``: all tars in order, pairs of jpg and json, poses in mm."""
    realtouch.export(source, tmp_path, "fota")
    home = tmp_path / "fota" / "train"
    wanted = expected(source)
    assert int((home / "count.txt").read_text().splitlines()[0]) == len(wanted)
    tars = sorted(path.name for path in home.iterdir() if path.name.startswith("data-"))
    assert tars == [f"data-{number:06d}.tar" for number in range(3)], "numbered without gaps"
    samples: dict[str, dict[str, bytes]] = {}
    for name in tars:
        with tarfile.open(home / name) as tar:
            for member in tar:
                key, ending = member.name.split(".")
                samples.setdefault(key, {})[ending] = tar.extractfile(member).read()  # type: ignore[union-attr]
    for sample, touch in zip(samples.values(), wanted, strict=True):
        fields = json.loads(sample["json"])
        assert sample["jpg"] == touch["image"]
        assert (fields["label"], fields["label_name"]) == (touch["label"], str(touch["label"]))
        x_mm, y_mm, z_mm = (fields[f"{axis}_mm"] for axis in "xyz")
        np.testing.assert_allclose(
            [x_mm, y_mm, z_mm], 1e3 * np.array([touch[f"gel_{axis}_m"] for axis in "xyz"]), rtol=1e-12
        )
        assert [fields[f"quat_{axis}"] for axis in "xyzw"] == [touch[f"gel_q{axis}"] for axis in "xyzw"]


def test_anytouch_reads_its_lists(source: Path, tmp_path: Path, small_shards: None) -> None:
    """Read like ``data.downstream_dataset.TAGDataset_video``: a line per image, earlier frames by number."""
    realtouch.export(source, tmp_path, "anytouch")
    home = tmp_path / "anytouch"
    wanted = expected(source)
    lines = (home / "train_bg.txt").read_text().splitlines()
    assert len(lines) == len(wanted)
    for line, touch in zip(lines, wanted, strict=True):
        item, label, background = line.split(",")[0], int(line.split(",")[1]), line.split(",")[2].strip()
        folder, name = item.split("/")
        number = int(name.split(".")[0])
        frames = home / "touch_and_go" / folder / "gelsight_frame"
        images = [frames / f"{max(0, number - 3 + step):010d}.jpg" for step in range(4)]
        assert images[-1].read_bytes() == touch["image"]
        assert (label, number) == (touch["label"], touch["touch"])
        sizes = {Image.open(path).convert("RGB").size for path in [*images, frames / background]}
        assert sizes == {(96, 72)}


def test_a_walk_over_several_materials_becomes_rounds_of_one_each(tmp_path: Path) -> None:
    """As in Touch and Go, whose folders are walks; lines of the label -1 leave an image out."""
    home = tmp_path / "corpus"
    frames = home / "touch_and_go" / "walk" / "gelsight_frame"
    frames.mkdir(parents=True)
    labels = [3, 3, -1, 5, 5, -1, 5, 3]
    for number in range(len(labels)):
        Image.new("RGB", (32, 24), (30 * number, 90, 90)).save(frames / f"{number:010d}.jpg")
    lines = [f"walk/{number:010d}.jpg,{label},background.jpg" for number, label in enumerate(labels)]
    (home / "train_bg.txt").write_text("\n".join(lines))
    manifest = realtouch.import_touches(home, tmp_path / "out")
    rounds = realtouch.load(tmp_path / "out")
    assert [(a_round.id, a_round.label, a_round.touch_count) for a_round in rounds] == [
        ("walk-0", 3, 2),
        ("walk-1", 5, 3),
        ("walk-2", 3, 1),
    ]
    assert [item.reason for item in manifest.shards[0].skipped] == ["excluded"] * 2


def zarr_array(group: zipfile.ZipFile, path: str) -> np.ndarray:
    """Read all chunks of an array of Zarr version 2."""
    stated = json.loads(group.read(f"{path}/.zarray"))
    assert (stated["zarr_format"], stated["order"], stated["filters"]) == (2, "C", None)
    assert stated["compressor"]["id"] == "zlib"
    chunks = []
    for number in range(-(-stated["shape"][0] // stated["chunks"][0])):
        content = group.read(f"{path}/{'.'.join([str(number), *'0' * (len(stated['shape']) - 1)])}")
        chunks.append(np.frombuffer(zlib.decompress(content), stated["dtype"]).reshape(stated["chunks"]))
    return np.concatenate(chunks)[: stated["shape"][0]]


@pytest.mark.one_at_a_desk
def test_diffusion_policy_reads_the_replay_buffer(source, tmp_path, small_shards, monkeypatch):
    """Read like ``ReplayBuffer.copy_from_path``: all arrays of data are as long as the last end states."""
    monkeypatch.setattr("realtouch.formats.zarr_export.CHUNK_BYTES", 4 * 72 * 96 * 3)
    realtouch.export(source, tmp_path, "replay", split="train")
    with zipfile.ZipFile(tmp_path / "replay" / "touches.zarr.zip") as group:
        for path in ("", "data/", "meta/"):
            assert json.loads(group.read(f"{path}.zgroup")) == {"zarr_format": 2}
        names = {name.split("/")[1] for name in group.namelist() if re.match("data/.*zarray", name)}
        data = {name: zarr_array(group, f"data/{name}") for name in names}
        ends = zarr_array(group, "meta/episode_ends")
    assert {len(values) for values in data.values()} == {ends[-1]}
    frames, poses, lengths = [], [], []
    for touch in realtouch.load(source, "train").touches():
        is_clip = isinstance(touch.round, realtouch.TouchSeqRound)
        frames += [*touch.clip.frames()] if is_clip else [touch.image]
        poses += [*touch.clip.poses] if is_clip else [touch.gel_pose]
        lengths.append(len(touch.clip) if is_clip else 1)
    if not is_clip:  # an episode for each round
        lengths = realtouch.load(source, "train").touch_counts.tolist()
    assert np.diff(ends, prepend=0).tolist() == lengths
    for number in range(0, len(frames), 7):
        assert np.array_equal(data["tactile"][number], frames[number])
        state = [*poses[number].translation, *poses[number].quaternion]
        np.testing.assert_array_equal(data["state"][number], np.float32(state))
    assert data["action"].shape == (len(frames), 2)
    assert realtouch.verify(tmp_path).ok
    with pytest.raises(InputError, match="a replay buffer holds one; next: add --split"):
        realtouch.export(source, tmp_path / "both", "replay")


def test_foreign_fota_has_poses_in_millimetres(tmp_path: Path) -> None:
    home = tmp_path / "cnc" / "val"
    home.mkdir(parents=True)
    fields = {"x_mm": 1.0, "y_mm": -2.5, "z_mm": 12.0, "material": "wood"}
    fields |= {f"quat_{axis}": value for axis, value in zip("xyzw", (0.0, 0.0, 0.0, 1.0), strict=True)}
    content = {
        "jpg": factories.encode_jpeg(np.zeros((24, 32, 3), np.uint8)),
        "json": json.dumps(fields).encode(),
    }
    with tarfile.open(home / "data-000000.tar", "w") as tar:
        for ending, each in content.items():
            header = tarfile.TarInfo(f"a-1.{ending}")
            header.size = len(each)
            tar.addfile(header, io.BytesIO(each))
    realtouch.import_touches(
        home, tmp_path / "out", realtouch.ImportSpec("fota", realtouch.ImportColumns(label="material"))
    )
    (only,) = realtouch.load(tmp_path / "out", "val")
    assert isinstance(only, realtouch.TouchSingleRound)
    np.testing.assert_array_equal(only.gel_pose_cell_frame.position_m, [[0.001, -0.0025, 0.012]])
    assert realtouch.load(tmp_path / "out", "val").label_names == ("wood",)


@pytest.mark.parametrize("layout", ["replay", "anytouch", "lerobot"])
def test_an_image_damaged_in_its_middle_is_named(layout, single_rows, tmp_path):
    def cut(row: dict[str, Any], index: int) -> None:
        if index == 0:
            content = row["sensor_image"][0]["bytes"]
            start = content.index(b"\xff\xda") + 40
            first = {"bytes": content[:start] + b"\xff\xd9", "path": None}
            row["sensor_image"] = [first, *row["sensor_image"][1:]]

    factories.write_set(tmp_path / "cut", {"train": single_rows}, "single", Layout(edit=cut))
    with pytest.raises(IntegrityError, match=r"(000|image 0).*cannot be decoded.*tactile select"):
        realtouch.export(tmp_path / "cut", tmp_path / "out", layout)
