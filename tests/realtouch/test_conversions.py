"""Conversions: their results, unchanged pixels, resumed runs, and the same bytes each time."""

from __future__ import annotations

import csv
import hashlib
import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from datasets import Features, Image, List, Video
from PIL import Image as Pictures

import realtouch
from realtouch.convert.conversion import Conversion, RowChoice, plan_conversion
from realtouch.convert.selection import KeepTouches
from realtouch.touches.loading import Source
from tactile_toolkit.errors import InputError
from tactile_toolkit.run.runners import ProcessRunner
from tactile_toolkit.touch import decode_image, resized
from tests.command_line import call
from tests.realtouch import factories
from tests.realtouch.factories import Layout, RoundTruth
from tests.tactile_toolkit.toy import folder_bytes


def features_of(folder: Path) -> Features:
    schema = pq.read_schema(next((folder / "data").glob("*.parquet")))
    return Features.from_arrow_schema(schema)


def test_single_images_of_clips(seq_folder: Path, truth: list[RoundTruth], tmp_path: Path) -> None:
    for method in ("contact_end", "contact_start", "peak"):
        out = tmp_path / method
        manifest = realtouch.clips_to_images(str(seq_folder), str(out), method)
        assert manifest.complete
        assert {split: entry["rows"] for split, entry in manifest.split_table().items()} == {
            "train": 3,
            "test": 1,
        }
        source, made = realtouch.load(seq_folder, "train"), realtouch.load(out, "train")
        assert isinstance(made, realtouch.TouchSingleDataset)
        for before, record, expected in zip(source, made, truth, strict=True):
            assert (record.id, record.label, record.object_id) == (before.id, before.label, before.object_id)
            np.testing.assert_array_equal(record.pos_in_cell_m, before.pos_in_cell_m)
            assert dict(record.info)["gel_id"] == expected.gel_id
            for touch, truth_of_touch in enumerate(expected.touches):
                frame = getattr(truth_of_touch, method)
                clip = before.sensor_video[touch]
                assert bytes(record.sensor_image.encoded(touch)) == bytes(clip.encoded(frame))
                np.testing.assert_array_equal(
                    record.gel_pose_cell_frame.position_m[touch], truth_of_touch.position_m[frame]
                )
                np.testing.assert_array_equal(
                    record.gel_pose_cell_frame.quaternion[touch], truth_of_touch.quaternion[frame]
                )
    features = features_of(out)
    assert features["sensor_image"] == List(Image(), length=5)
    assert features["pos_in_cell"].length == 5
    assert features["label"].names == factories.LABELS
    assert realtouch.verify(str(out)).ok


def test_resized_images(single_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "small"
    realtouch.resize(str(single_folder), str(out), 32, 24)
    before, after = realtouch.load(single_folder, "train"), realtouch.load(out, "train")
    for one, two in zip(before, after, strict=True):
        assert two.sensor_image[:].shape == (5, 24, 32, 3)
        expected = resized(one.sensor_image[2], 32, 24)
        assert np.abs(two.sensor_image[2].astype(int) - expected).mean() < 2
        np.testing.assert_array_equal(one.gel_pose_cell_frame.position_m, two.gel_pose_cell_frame.position_m)
    assert pq.read_schema(next((out / "data").glob("*.parquet"))).names == before.table.schema.names


def test_images_of_the_wanted_size_pass_through(single_folder: Path, tmp_path: Path) -> None:
    realtouch.resize(str(single_folder), str(tmp_path / "same"), 96, 72)
    for one, two in zip(
        realtouch.load(single_folder, "train"), realtouch.load(tmp_path / "same", "train"), strict=True
    ):
        for touch in range(5):
            assert bytes(one.sensor_image.encoded(touch)) == bytes(two.sensor_image.encoded(touch))


def test_resized_clips(seq_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "small"
    realtouch.resize(str(seq_folder), str(out), 48, 36, limit=1)
    before, after = realtouch.load(seq_folder, "train")[0], realtouch.load(out, "train")[0]
    for one, two in zip(before.sensor_video, after.sensor_video, strict=True):
        assert (len(one), one.fps, two.size) == (len(two), two.fps, (36, 48))
        assert one.contact_window == two.contact_window
        expected = np.stack([resized(frame, 48, 36) for frame in one.frames()])
        assert np.abs(two.frames().astype(int) - expected).mean() < 2
    assert features_of(out)["sensor_video"].feature == Video()
    assert realtouch.verify(str(out)).ok


@pytest.mark.parametrize("kind", ["seq", "single"])
def test_selected_touches(kind: str, seq_folder: Path, single_folder: Path, tmp_path: Path) -> None:
    source = seq_folder if kind == "seq" else single_folder
    out = tmp_path / "some"
    realtouch.select(str(source), str(out), contact=True, labels=["0", 2], limit=2)
    before, after = realtouch.load(source, "train"), realtouch.load(out, "train")
    assert [record.label for record in after] == [0, 2]
    assert after.touch_counts.tolist() == [4, 4]
    kept = [0, 1, 3, 4]
    for one, two in zip(before[[0, 2]], after, strict=True):
        np.testing.assert_array_equal(one.pos_in_cell_m[kept], two.pos_in_cell_m)
        for place, touch in enumerate(kept):
            if kind == "single":
                assert bytes(one.sensor_image.encoded(touch)) == bytes(two.sensor_image.encoded(place))
                continue
            assert bytes(one.sensor_video[touch].data) == bytes(two.sensor_video[place].data)
            np.testing.assert_array_equal(
                one.gel_pose_cell_frame_seq[touch].position_m, two.gel_pose_cell_frame_seq[place].position_m
            )
            np.testing.assert_array_equal(one.time_stamp_rel_seq[touch], two.time_stamp_rel_seq[place])
    assert realtouch.verify(str(out)).ok
    assert features_of(out)["pos_in_cell"].length == -1


def test_selected_rounds_pass_through_whole(single_folder: Path, tmp_path: Path) -> None:
    realtouch.select(str(single_folder), str(tmp_path / "some"), ids=[4001, 4003])
    made = realtouch.load(tmp_path / "some", "train")
    assert [record.object_id for record in made] == [4001]
    assert [record.object_id for record in realtouch.load(tmp_path / "some", "test")] == [4003]
    assert features_of(tmp_path / "some")["pos_in_cell"].length == 5


@pytest.mark.parametrize(
    ("rows", "problem"),
    [
        ({"ids": [1]}, "no object with id 1 in"),
        ({"ids": [(1, 2, 3)]}, r"has \(1, 2, 3\); expected integers, texts, or pairs"),
        ({"ids": [2.5]}, r"has 2.5; expected integers, texts, or pairs"),
        ({"labels": ["cat"]}, "no class 'cat'"),
        ({"limit": 2.5}, "limit of the rows is 2.5; expected an integer of at least 1"),
        ({"per_class": 0}, "per_class of the rows is 0; expected an integer of at least 1"),
        ({"split": "none"}, "none"),
    ],
    ids=str,
)
def test_rows_are_checked_by_every_conversion(rows: Any, problem: str, single_folder: Path) -> None:
    """As options of the command line are, before anything is written."""
    out = single_folder.parent / "refused"
    for convert in (
        realtouch.select,
        *(partial(realtouch.export, layout=layout) for layout in ("png", "flat")),
    ):
        with pytest.raises(InputError, match=problem):
            convert(single_folder, out, **rows)
    assert not out.exists()


def test_exports_of_chosen_rows(single_folder: Path, tmp_path: Path, capsys: Any) -> None:
    chosen = ("--ids", "4001,4003", "--labels", "1,3", "--format")
    for layout in ("png", "flat"):
        out = tmp_path / layout
        command = ("tactile", "export", single_folder, *chosen, layout, "--out", out)
        assert call(*command, "--dry-run") == 0
        assert "would write 2 rounds" in capsys.readouterr().out
        assert not out.exists()
        assert call(*command) == 0
        table = pa.concat_tables(map(pq.read_table, sorted(out.glob("data/*.parquet"))))
        assert set(table["object_id"].to_pylist()) == {4001, 4003}
        assert len(table) == 10


@pytest.mark.parametrize("kind", ["png", "jpeg"])
def test_plain_pictures(kind: Any, single_folder: Path, seq_folder: Path, tmp_path: Path) -> None:
    for source in (single_folder, seq_folder):
        out = tmp_path / source.name
        realtouch.export(str(source), str(out), kind, frame="peak")
        with (out / "index.csv").open() as stream:
            lines = list(csv.DictReader(stream))
        assert len(lines) == 20
        table = pq.read_table(sorted((out / "data").glob("train-*"))[0]).to_pylist()
        assert [entry["file"] for entry in table] == [
            line["file"] for line in lines if line["split"] == "train"
        ]
        records = {
            record.id: record for split in ("train", "test") for record in realtouch.load(source, split)
        }
        for line in lines:
            content = (out / line["file"]).read_bytes()
            assert hashlib.sha256(content).hexdigest() == line["sha256"]
            record, touch = records[line["round_id"]], int(line["touch"])
            assert int(line["label"]) == record.label
            assert float(line["pos_in_cell_x_m"]) == record.pos_in_cell_m[touch, 0]
            if isinstance(record, realtouch.TouchSingleRound):
                stored, image = record.sensor_image.encoded(touch), record.sensor_image[touch]
                z_m = record.gel_pose_cell_frame.position_m[touch, 2]
            else:
                clip = record.sensor_video[touch]
                frame = int(line["frame"])
                assert frame == clip.contact_index("peak")
                stored, image, z_m = clip.encoded(frame), clip[frame], clip.poses.position_m[frame, 2]
            assert float(line["gel_z_m"]) == z_m
            np.testing.assert_array_equal(decode_image(content), image)
            np.testing.assert_array_equal(np.asarray(Pictures.open(out / line["file"])), image)
            assert (kind == "png") or content == bytes(stored)


def test_pictures_are_verified_against_their_index(single_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "pictures"
    realtouch.export(str(single_folder), str(out), "jpeg")
    result = realtouch.verify(str(out))
    assert (result.findings, result.rounds, result.touches) == ((), 4, 20)
    first, second = sorted((out / "images" / "train").rglob("*.jpg"))[:2]
    first.unlink()
    second.write_bytes(b"other")
    assert [finding.file for finding in realtouch.verify(str(out)).findings] == [
        str(file.relative_to(out)) for file in (first, second)
    ]


@pytest.mark.thorough
def test_workers_and_interruptions_change_no_byte(seq_folder, tmp_path, monkeypatch):
    monkeypatch.setattr("realtouch.convert.media_conversions._CONTACT_FRAME_ROWS", 1)
    realtouch.clips_to_images(seq_folder, tmp_path / "a")
    realtouch.clips_to_images(seq_folder, tmp_path / "b", workers=ProcessRunner(2))
    assert folder_bytes(tmp_path / "a") == folder_bytes(tmp_path / "b")

    class StoppedError(Exception):
        pass

    def stop(progress: Any) -> None:
        if progress.done == 2:
            raise StoppedError

    with pytest.raises(StoppedError):
        realtouch.clips_to_images(str(seq_folder), str(tmp_path / "c"), on_progress=stop)
    assert not json.loads((tmp_path / "c" / "manifest.json").read_text())["complete"]
    done: list[int] = []
    realtouch.clips_to_images(
        str(seq_folder), str(tmp_path / "c"), on_progress=lambda p: done.append(p.total)
    )
    assert done[0] == 2  # two of four rounds were kept
    assert folder_bytes(tmp_path / "a") == folder_bytes(tmp_path / "c")


def test_impossible_conversions_are_refused(seq_folder, single_folder, seq_rows, tmp_path):
    out = str(tmp_path / "out")
    with pytest.raises(InputError, match="no object is chosen; expected rows"):
        realtouch.select(single_folder, out, labels=[9])
    position = "gel_pose_cell_frame_seq.position"
    bare = Layout(leave_out=(position, "gel_pose_cell_frame_seq.quaternion"))
    factories.write_set(tmp_path / "bare", {"train": seq_rows}, "seq", bare)
    with pytest.raises(InputError, match=f"no column '{position}', which 'peak' needs; .*contact_start"):
        realtouch.clips_to_images(tmp_path / "bare", out, "peak")
    with pytest.raises(InputError, match="holds single images already"):
        realtouch.clips_to_images(str(single_folder), out)
    with pytest.raises(InputError, match="unknown frame method 'finest'"):
        realtouch.clips_to_images(str(seq_folder), out, "finest")
    with pytest.raises(InputError, match="size 0 x 64"):
        realtouch.resize(str(single_folder), out, 0, 64)
    with pytest.raises(InputError, match="there is no layout 'gif'"):
        realtouch.export(str(single_folder), out, "gif")
    with pytest.raises(InputError, match="limit of the rows is 0"):
        realtouch.export(str(single_folder), out, "png", limit=0)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="is empty; expected a data set"):
        realtouch.export(str(tmp_path / "empty"), out, "png")
    assert not Path(out).exists()


def test_damaged_rounds_are_left_out_and_listed(seq_rows: list[dict], tmp_path: Path) -> None:
    def cut(row: dict[str, Any], index: int) -> None:
        if index == 1:
            row["sensor_video"] = [{**blob, "bytes": blob["bytes"][:-9]} for blob in row["sensor_video"]]

    source = factories.write_set(tmp_path / "source", {"train": seq_rows}, "seq", Layout(edit=cut))
    manifest = realtouch.clips_to_images(str(source), str(tmp_path / "out"))
    assert manifest.skipped_reasons() == {"damaged": 1}
    skipped = manifest.shards[0].skipped[0]
    assert skipped.id == 1
    assert "row 1, touch 0, field 'sensor_video': an AVI cut short" in skipped.message
    assert [record.label for record in realtouch.load(tmp_path / "out")] == [0, 2]


def test_the_fingerprint_does_not_depend_on_the_path(single_folder: Path) -> None:
    fingerprint = Source.open(str(single_folder)).fingerprint()
    assert [entry["file"] for entry in fingerprint["train"]] == [
        "train-00000-of-00002.parquet",
        "train-00001-of-00002.parquet",
    ]
    assert str(single_folder.parent) not in json.dumps(fingerprint)


def test_a_task_takes_along_the_files_of_its_own_rows_only(single_folder: Path) -> None:
    source = Source.open(str(single_folder))
    files = source.shards["train"]
    assert len(files) == 2
    rows = list(map(RowChoice, range(sum(map(len, files)))))
    conversion = Conversion(source, "toy", {}, KeepTouches(False), {"train": rows}, rows_per_shard=1)
    plan = plan_conversion(conversion)
    # A dictionary of pictures would only waste space.
    assert plan.style.encodings == (("sensor_image.list.element.bytes", "PLAIN"),)
    tasks = plan.tasks
    assert len(tasks) == len(rows)
    assert [len(task.function.shards) for task in tasks] == [1] * len(rows)
    assert [choice.row for task in tasks for choice in task.items] == list(range(len(rows)))
    made = [name for task in tasks for name in task.make().table["id"].to_pylist()]
    assert made == realtouch.load(str(single_folder), "train").ids.tolist()


def test_selection_by_class_and_ranges_of_objects(tmp_path: Path) -> None:
    rounds = [factories.make_round(index, 3, (24, 32), (4, 6)) for index in range(20)]
    factories.write_set(tmp_path / "all", {"train": factories.single_rows(rounds)}, "single")
    before = realtouch.load(tmp_path / "all")
    assert call("tactile", "select", tmp_path / "all", "--per-class", 1, "--out", tmp_path / "one") == 0
    one = realtouch.load(tmp_path / "one")
    assert one.ids.tolist() == [before.ids[before.labels == label][0] for label in np.unique(before.labels)]
    objects = sorted(before.int_column("object_id").tolist())
    first, last = objects[2], objects[4]
    out = ("--out", tmp_path / "some")
    assert call("tactile", "select", tmp_path / "all", "--ids", f"{first}-{last}", *out) == 0
    some = realtouch.load(tmp_path / "some").int_column("object_id")
    assert sorted(some.tolist()) == objects[2:5]
