"""Exports of touches: each layout is read back by the reader of its library."""

from __future__ import annotations

import gc
import json
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import datasets
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

import realtouch
from realtouch.formats import touch_rows
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.run import Part
from tactile_toolkit.touch import decode_image
from tests.command_line import call
from tests.realtouch import factories
from tests.realtouch.factories import Layout, RoundTruth
from tests.tactile_toolkit.toy import folder_bytes

LAYOUTS = ("flat", "webdataset", "lerobot")
FIELDS = (
    *("pos_in_cell_x_m", "pos_in_cell_y_m", "gel_x_m", "gel_y_m", "gel_z_m"),
    *("gel_qx", "gel_qy", "gel_qz", "gel_qw"),
)


def expected(source: Path, split: str = "train") -> list[dict[str, Any]]:
    """Return what each touch is to become, through the record data set."""
    rows = []
    for record in realtouch.load(source, split):
        for touch in range(record.touch_count):
            if isinstance(record, realtouch.TouchSingleRound):
                frame, pose = 0, record.gel_pose_cell_frame
                image = bytes(record.sensor_image.encoded(touch))
                position, quaternion = pose.position_m[touch], pose.quaternion[touch]
            else:
                clip = record.sensor_video[touch]
                frame = clip.contact_index("contact_end")
                image = bytes(clip.encoded(frame))
                position, quaternion = clip.poses.position_m[frame], clip.poses.quaternion[frame]
            rows.append(
                {
                    "id": f"{record.id}_{touch:03d}",
                    "image": image,
                    "label": record.label,
                    "label_name": str(record.label),
                    "object_id": record.object_id,
                    "round_id": record.id,
                    "touch": touch,
                    "frame": frame,
                    **dict(zip(FIELDS, [*record.pos_in_cell_m[touch], *position, *quaternion], strict=True)),
                }
            )
    return rows


def test_every_reader_of_tables_reads_flat_touches(source: Path, tmp_path: Path) -> None:
    import polars

    out = tmp_path / "flat"
    realtouch.export(source, out, "flat")
    wanted = expected(source)
    plain = datasets.load_dataset(str(out), split="train").cast_column("image", datasets.Image(decode=False))
    assert plain.features["label"].names == factories.LABELS
    assert [{**row, "image": row["image"]["bytes"]} for row in plain] == wanted
    files = out / "data" / "train-*.parquet"
    shown = polars.read_parquet(files)
    assert [{**row, "image": row["image"]["bytes"]} for row in shown.to_dicts()] == wanted
    frame = pd.concat([pd.read_parquet(path) for path in sorted((out / "data").glob("train-*"))])
    assert [row["bytes"] for row in frame.image] == [row["image"] for row in wanted]
    assert frame[[*FIELDS, "label"]].to_dict("records") == [
        {name: row[name] for name in (*FIELDS, "label")} for row in wanted
    ]
    decoded = datasets.load_dataset(str(out), split="test")[3]
    assert np.array_equal(np.asarray(decoded["image"]), decode_image(expected(source, "test")[3]["image"]))
    result = realtouch.verify(out)
    assert result.ok
    assert (result.rounds, result.touches) == (4, 20)


def test_row_groups_hold_as_many_touches_as_their_bytes_allow(single_folder, tmp_path, monkeypatch):
    largest = max(len(row["image"]) for row in expected(single_folder))
    monkeypatch.setattr(touch_rows, "_GROUP_BYTES", 5 * largest)
    realtouch.export(single_folder, tmp_path, "flat", split="train")
    (file,) = (pq.ParquetFile(path).metadata for path in (tmp_path / "data").iterdir())
    rows = [file.row_group(number).num_rows for number in range(file.num_row_groups)]
    assert sum(rows) == 15
    assert 3 <= max(rows) <= 8


@pytest.mark.one_at_a_desk
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # tars that it leaves open
@pytest.mark.usefixtures("small_shards")
def test_webdataset_reads_the_tars(source: Path, tmp_path: Path) -> None:
    import webdataset

    out = tmp_path / "tars"
    realtouch.export(source, out, "webdataset", split="train")
    pattern = str(out / "webdataset" / "train-{000000..000002}.tar")
    samples = list(webdataset.WebDataset(pattern, shardshuffle=False))
    wanted = expected(source)
    assert [sample["jpg"] for sample in samples] == [row.pop("image") for row in wanted]
    assert [json.loads(sample["json"]) for sample in samples] == wanted
    assert [sample["__key__"] for sample in samples] == [row["id"] for row in wanted]
    decoded = next(iter(webdataset.WebDataset(pattern, shardshuffle=False).decode("rgb8")))
    assert decoded["jpg"].shape == (72, 96, 3)
    gc.collect()
    with tarfile.open(out / "webdataset" / "train-000001.tar") as tar:
        assert {(member.mtime, member.uid, member.uname) for member in tar} == {(0, 0, "")}
    assert realtouch.verify(out).ok


@pytest.mark.one_at_a_desk
@pytest.mark.usefixtures("small_shards")
@pytest.mark.parametrize("layout", LAYOUTS)
def test_parts_kills_and_damage_end_in_the_same_bytes(layout, single_folder, tmp_path):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    # Starting workers takes longer than their work, so only one layout is tested with several.
    realtouch.export(single_folder, whole, layout, split="train", workers=2 if layout == "lerobot" else 1)
    for number in (1, 0):
        realtouch.export(single_folder, parts, layout, split="train", part=Part(number, 2))
    realtouch.export(single_folder, parts, layout, split="train", finish=True)
    assert folder_bytes(parts) == folder_bytes(whole)
    foreign = [
        path
        for path in parts.rglob("*")
        if path.suffix == ".tar" or path.parts[-3:-1] == ("data", "chunk-000")
    ]
    victim = (foreign or sorted((parts / "data").iterdir()))[1]
    content = bytearray(victim.read_bytes())
    content[len(content) // 2] ^= 1
    victim.write_bytes(content)
    assert [finding.file for finding in realtouch.verify(parts).findings] == [str(victim.relative_to(parts))]
    realtouch.export(single_folder, parts, layout, split="train", check=True)
    assert folder_bytes(parts) == folder_bytes(whole)
    realtouch.export(single_folder, parts, "flat", split="train", overwrite=True)
    assert not (parts / layout).exists()


@pytest.mark.usefixtures("small_shards")
def test_lerobot_numbers_frames_over_all_files(source: Path, truth: list[RoundTruth], tmp_path: Path) -> None:
    realtouch.export(source, tmp_path / "robots", "lerobot", split="train")
    assert "| split | rounds | shards" in (tmp_path / "robots" / "README.md").read_text()
    home = tmp_path / "robots" / "lerobot"
    frames = pq.read_table(home / "data")
    episodes = pq.read_table(home / "meta" / "episodes").to_pylist()
    info = json.loads((home / "meta" / "info.json").read_text())
    told: list[tuple[int, int]] = []
    checked = realtouch.verify(tmp_path / "robots", on_progress=lambda *now: told.append(now))
    assert told == [(1, 3), (2, 3), (3, 3)] if "seq" not in source.name else told[-1] == (15, 15)
    assert len({total for _, total in told}) == 1
    assert (checked.ok, checked.rounds, checked.touches) == (True, 3, 15)
    count = sum(touch.frames for each in truth for touch in each.touches)
    is_seq = "seq" in source.name
    assert info["total_frames"] == len(frames) == (count if is_seq else 15)
    assert info["fps"] == (factories.FPS if is_seq else 1)
    assert info["splits"] == {"train": f"0:{15 if is_seq else 3}"}
    assert frames["index"].to_pylist() == list(range(len(frames)))
    stats = json.loads((home / "meta" / "stats.json").read_text())
    assert set(stats) == set(info["features"]) == set(frames.column_names)
    state = np.array(frames["observation.state"].to_pylist(), np.float64)
    for name, value in (
        ("mean", state.mean(0)),
        ("std", state.std(0)),
        ("min", state.min(0)),
        ("max", state.max(0)),
    ):
        np.testing.assert_allclose(stats["observation.state"][name], value, rtol=1e-9, atol=1e-12)
    end = 0
    for number, episode in enumerate(episodes):
        assert (episode["episode_index"], episode["dataset_from_index"]) == (number, end)
        end = episode["dataset_to_index"]
        part = frames.slice(episode["dataset_from_index"], episode["length"])
        assert set(part["episode_index"].to_pylist()) == {number}
        assert part["frame_index"].to_pylist() == list(range(episode["length"]))
        file = home / info["data_path"].format(
            chunk_index=episode["data/chunk_index"], file_index=episode["data/file_index"]
        )
        assert number in pq.read_table(file, columns=["episode_index"])["episode_index"].to_pylist()
    if not is_seq:  # an episode of few images, all of which count
        blobs = frames.slice(0, 5)["observation.images.tactile"].to_pylist()
        pixels = np.stack([decode_image(blob["bytes"]) for blob in blobs]) / 255
        found = episodes[0]
        for name, value in (("mean", pixels.mean((0, 1, 2))), ("std", pixels.std((0, 1, 2)))):
            np.testing.assert_allclose(np.ravel(found[f"stats/observation.images.tactile/{name}"]), value)


@pytest.mark.usefixtures("small_shards")
def test_quantiles_of_numbers_are_those_of_all_frames(source: Path, tmp_path: Path) -> None:
    realtouch.export(source, tmp_path / "robots", "lerobot", split="train")
    home = tmp_path / "robots" / "lerobot"
    frames = pq.read_table(home / "data")
    stats = json.loads((home / "meta" / "stats.json").read_text())
    assert len(list((home / "data").rglob("*.parquet"))) == 3
    for name in set(frames.column_names) - {"observation.images.tactile"}:
        values = np.array(frames[name].to_pylist(), np.float64).reshape(len(frames), -1)
        for key, share in (("q01", 0.01), ("q10", 0.1), ("q50", 0.5), ("q90", 0.9), ("q99", 0.99)):
            found, wanted = stats[name][key], np.quantile(values, share, axis=0)
            np.testing.assert_allclose(found, wanted, rtol=1e-12, err_msg=f"{name} {key}")
    assert stats["label"]["q01"] < stats["label"]["q99"]
    colours = stats["observation.images.tactile"]
    assert np.shape(colours["q50"]) == (3, 1, 1)
    assert np.all(np.less_equal(colours["q01"], colours["q99"]))


@pytest.mark.filterwarnings("ignore")  # of its imports
@pytest.mark.usefixtures("small_shards")
@pytest.mark.parametrize(("source", "step_s"), [("single", 1.0), ("seq", 0.04)], indirect=["source"])
def test_lerobot_reads_its_data_set(source: Path, step_s: float, tmp_path: Path) -> None:
    reader = pytest.importorskip("lerobot.datasets.lerobot_dataset", reason="needs the package lerobot")
    realtouch.export(source, tmp_path, "lerobot", split="train")
    root = tmp_path / "lerobot"
    records = realtouch.load(source, "train")
    is_clips = isinstance(records, realtouch.TouchSeqDataset)
    episodes = np.concatenate([each.video_length_frames for each in records]) if is_clips else [5] * 3
    whole = reader.LeRobotDataset("me/touches", root=root)
    steps = {"observation.state": [-step_s, 0.0]}
    one = reader.LeRobotDataset("me/touches", root=root, episodes=[1], delta_timestamps=steps)
    assert [len(whole), whole.num_episodes, len(one)] == [sum(episodes), len(episodes), episodes[1]]
    frames = pq.read_table(root / "data")
    for item in (whole[index] for index in range(0, len(whole), 7)):
        row = frames.slice(int(item["index"]), 1).to_pylist()[0]
        assert item["task"] == f"touch an object of class {row['label']}"
        assert item["observation.state"].tolist() == row["observation.state"]
        pixels = decode_image(row["observation.images.tactile"]["bytes"])
        total = int((item["observation.images.tactile"] * 255).round().sum())
        assert abs(total - int(pixels.sum())) <= pixels.size  # by another decoder
    states = np.array(frames["observation.state"].to_pylist(), np.float32)
    first = int(episodes[0])
    np.testing.assert_array_equal(one[1]["observation.state"], states[first : first + 2])
    means = whole.meta.stats["observation.state"]["mean"]
    np.testing.assert_allclose(means, states.astype(float).mean(axis=0), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(
    ("layout", "options", "words"),
    [
        ("flat", {"split": "held"}, "held"),
        ("flat", {"frame": "last"}, "last"),
        ("arrow", {}, "arrow"),
        ("lerobot", {}, "add --split"),
    ],
)
def test_impossible_exports_are_named(layout, options, words, single_folder, tmp_path):
    with pytest.raises(InputError, match=words):
        realtouch.export(single_folder, tmp_path / "no", layout, **options)
    with pytest.raises(InputError, match="source"):
        realtouch.export(single_folder, single_folder / "in", "flat")


def with_image(row: dict[str, Any], touch: int, change: Callable[[bytes], bytes]) -> None:
    images = [dict(each) for each in row["sensor_image"]]
    images[touch]["bytes"] = change(images[touch]["bytes"])
    row["sensor_image"] = images


SMALL = factories.encode_jpeg(np.zeros((10, 20, 3), np.uint8))
EDITS: dict[str, Callable[[dict[str, Any], int], object]] = {
    "cut": lambda row, index: index == 1 and with_image(row, 3, lambda data: data[:-400]),
    "half": lambda row, index: (
        index == 1 and with_image(row, 3, lambda data: data[: -len(data) // 3] + b"\xff\xd9")
    ),
    "other size": lambda row, index: index == 1 and with_image(row, 2, lambda _: SMALL),
    "ids": lambda row, index: row.update(id=("../up", row["id"], "a/b")[index]),
    "labels": lambda row, index: row.update(label=10 * index),
}


@pytest.fixture
def edited(single_rows: list[dict], tmp_path: Path) -> Callable[[str], Path]:
    """Write a set with one of the edits."""
    return lambda name: factories.write_set(
        tmp_path / name, {"train": single_rows}, "single", Layout(edit=EDITS[name])
    )


@pytest.mark.parametrize("layout", ["flat", "webdataset"])
def test_rounds_that_cannot_be_read_are_left_out(layout: Any, edited: Any, tmp_path: Path) -> None:
    made = {name: realtouch.export(edited(name), tmp_path / f"{name}-out", layout) for name in EDITS}
    rows = {name: manifest.split_table()["train"]["rows"] for name, manifest in made.items()}
    # Half an image is complete at both ends; images may have sizes of their own.
    assert rows == {"cut": 10, "half": 15, "other size": 15, "ids": 15, "labels": 5}
    (skipped,) = made["cut"].shards[0].skipped
    assert "touch 3" in skipped.message
    (found,) = realtouch.verify(tmp_path / "half-out").findings
    assert "cannot be decoded" in found.problem
    assert realtouch.verify(tmp_path / "half-out", quick=True).ok
    assert [item.id for item in made["labels"].shards[0].skipped] == [1, 2]


@pytest.mark.parametrize(
    ("name", "error", "words"),
    [
        ("cut", IntegrityError, r"touch 3.*without gaps"),
        ("other size", InputError, r"20 x 10 pixels; expected 96 x 72.*resize"),
    ],
)
def test_lerobot_needs_every_image_in_one_size(name, error, words, edited, tmp_path):
    with pytest.raises(error, match=words):
        realtouch.export(edited(name), tmp_path / "robots", "lerobot")
    assert not (tmp_path / "robots").exists()


def test_lerobot_needs_lengths_that_are_true(seq_rows: list[dict], tmp_path: Path) -> None:
    """Frames are numbered consecutively over all files, before they are read."""

    def shorten(row: dict[str, Any], index: int) -> None:
        row["video_length_frames"] = [length - (index == 1) for length in row["video_length_frames"]]

    for layout, error, words in (
        (Layout(leave_out=("video_length_frames",)), InputError, "has no column 'video_length_frames'"),
        (Layout(edit=shorten), IntegrityError, "row 1"),
    ):
        factories.write_set(tmp_path / "source", {"train": seq_rows}, "seq", layout)
        with pytest.raises(error, match=words):
            realtouch.export(tmp_path / "source", tmp_path / "robots", "lerobot")
        assert not (tmp_path / "robots").exists()


def test_lerobot_gets_the_shape_of_every_column(source: Path, tmp_path: Path) -> None:
    realtouch.export(source, tmp_path, "lerobot", split="train")
    features = json.loads((tmp_path / "lerobot" / "meta" / "info.json").read_text())["features"]
    picture = {"dtype": "image", "shape": [72, 96, 3], "names": ["height", "width", "channels"]}
    assert features.pop("observation.images.tactile") == picture
    state = {"dtype": "float32", "shape": [7], "names": ["x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"]}
    assert features.pop("observation.state") == state
    assert features.pop("action") == {"dtype": "float32", "shape": [2], "names": ["x_m", "y_m"]}
    assert features.pop("timestamp") == {"dtype": "float32", "shape": [1], "names": None}
    if "seq" in source.name:
        assert features.pop("time_s") == {"dtype": "float64", "shape": [1], "names": None}
        assert features.pop("in_contact") == {"dtype": "bool", "shape": [1], "names": None}
    for name, feature in features.items():
        assert feature == {"dtype": "int64", "shape": [1], "names": None}, name


def test_the_command_says_which_folder_other_programs_open(single_folder, tmp_path, capsys):
    words = ("--split", "train", "--format", "lerobot", "--out", tmp_path / "robots", "-w", 1)
    assert call("tactile", "export", single_folder, *words) == 0
    assert f"other programs open {tmp_path}/robots/lerobot" in capsys.readouterr().out
