"""Opening data sets: all forms of storage give the same values."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import realtouch
from realtouch.touches.stored_round import StoredRound
from tactile_toolkit.errors import InputError
from tactile_toolkit.read import RowGroup
from tests.processes import printed_by
from tests.realtouch import factories
from tests.realtouch.factories import Layout, RoundTruth

LAYOUTS = {
    "flat": Layout(),
    "nested": Layout(nested=True),
    "seconds": Layout(seconds=True),
    "ragged": Layout(padded=False),
    "unfixed": Layout(fixed=False),
    "shards": Layout(shards=3, group_rows=1),
    "null padding": Layout(pad_null=True),
    "all at once": Layout(nested=True, seconds=True, padded=False, fixed=False, shards=2),
    "nested null padding": Layout(nested=True, pad_null=True, fixed=False, seconds=True),
}


def assert_common(record: realtouch.TouchRound, truth: RoundTruth) -> None:
    assert (record.id, record.label, record.object_id) == (truth.id, truth.label, truth.object_id)
    assert record.touch_count == len(truth.touches)
    np.testing.assert_array_equal(record.pos_in_cell_m, truth.pos_in_cell_m)
    np.testing.assert_array_equal(record.pos_in_cell, truth.pos_in_cell_m)
    assert record.info["gel_id"] == truth.gel_id
    np.testing.assert_allclose(record.info["object_pose"].translation, [0, 0.001 * truth.label, 0])


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS.keys())
def test_every_field_of_clips(layout: Layout, truth: list[RoundTruth], tmp_path: Path) -> None:
    factories.write_set(tmp_path, {"train": factories.seq_rows(truth, layout)}, "seq", layout)
    dataset = realtouch.load(tmp_path)
    assert isinstance(dataset, realtouch.TouchSeqDataset)
    assert len(dataset) == len(truth)
    for record, expected in zip(dataset, truth, strict=True):
        assert_common(record, expected)
        lengths = [touch.frames for touch in expected.touches]
        assert record.video_length_frames.tolist() == lengths
        for touch, touch_truth in enumerate(expected.touches):
            poses = record.gel_pose_cell_frame_seq[touch]
            np.testing.assert_array_equal(poses.position_m, touch_truth.position_m)
            np.testing.assert_array_equal(poses.quaternion, touch_truth.quaternion)
            stamps = record.time_stamp_rel_seq[touch] / np.timedelta64(1, "s")
            np.testing.assert_allclose(stamps, touch_truth.time_s, atol=1e-9)
            clip = record.sensor_video[touch]
            assert len(clip) == touch_truth.frames
            assert (clip.contact_window.start, clip.contact_window.stop - 1) == (
                touch_truth.contact_start,
                touch_truth.contact_end,
            )
        starts = record.touch_start_time_rel / np.timedelta64(1, "s")
        np.testing.assert_allclose(starts, [t.time_s[t.contact_start] for t in expected.touches], atol=1e-9)
        np.testing.assert_allclose(
            record.row.contact_z_m(), [t.position_m[:, 2].min() for t in expected.touches]
        )


@pytest.mark.parametrize("layout", [Layout(), Layout(nested=True, fixed=False, shards=2)])
def test_every_field_of_images(layout, truth, single_rows, tmp_path):
    factories.write_set(tmp_path, {"train": single_rows}, "single", layout)
    dataset = realtouch.load(tmp_path)
    assert isinstance(dataset, realtouch.TouchSingleDataset)
    for record, expected in zip(dataset, truth, strict=True):
        assert_common(record, expected)
        positions = [touch.position_m[touch.peak] for touch in expected.touches]
        np.testing.assert_array_equal(record.gel_pose_cell_frame.position_m, positions)
        for touch, touch_truth in enumerate(expected.touches):
            image = record.sensor_image[touch]
            assert image.dtype == np.uint8
            assert np.abs(image.astype(int) - touch_truth.pixels[touch_truth.peak]).mean() < 3
            matrix = record.gel_pose_cell_frame[touch].as_matrix()
            np.testing.assert_allclose(matrix[:3, 3], touch_truth.position_m[touch_truth.peak])
            np.testing.assert_allclose(matrix[:3, :3].T @ matrix[:3, :3], np.eye(3), atol=1e-12)


def test_one_file_several_files_and_a_folder_read_alike(single_folder: Path) -> None:
    files = sorted((single_folder / "data").glob("train-*.parquet"))
    ids = [record.id for record in realtouch.load(single_folder, "train")]
    assert [record.id for record in realtouch.load(files)] == ids
    assert [record.id for file in files for record in realtouch.load(str(file))] == ids
    stream = realtouch.load(single_folder, "train", streaming=True)
    assert [record.id for record in stream] == ids
    assert repr(stream) == f"TouchStream(single, 2 shards of '{single_folder.name}', split train)"
    touches = realtouch.load(single_folder, "train").touches()
    np.testing.assert_array_equal(stream.touches()[7].image, touches[7].image)
    assert len(realtouch.load(single_folder, "test")) == 1


def test_opening_reads_no_row(single_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        pytest.fail("a row was read")

    for reader in ("read_row_groups", "iter_batches", "read", "read_row_group"):
        monkeypatch.setattr(pq.ParquetFile, reader, refuse)
    dataset = realtouch.load(single_folder, "train")
    assert len(dataset) == 3
    assert len(dataset.touches()) == 15  # the lists have a fixed length in the schema


def test_records_are_frozen_and_pickle(seq_folder: Path, single_folder: Path) -> None:
    for folder in (seq_folder, single_folder):
        record = realtouch.load(folder, "train")[1]
        with pytest.raises(AttributeError, match="frozen"):
            record.id = "other"
        restored = pickle.loads(pickle.dumps(record))
        assert (restored.id, restored.label) == (record.id, record.label)
        np.testing.assert_array_equal(restored.pos_in_cell_m, record.pos_in_cell_m)
        touch = pickle.loads(pickle.dumps(realtouch.load(folder, "train").touches()[6]))
        np.testing.assert_array_equal(touch.image, realtouch.load(folder, "train").touches()[6].image)
    images = pickle.loads(pickle.dumps(realtouch.load(single_folder, "train")[1].sensor_image))
    np.testing.assert_array_equal(images[3], realtouch.load(single_folder, "train")[1].sensor_image[3])
    clip = pickle.loads(pickle.dumps(realtouch.load(seq_folder, "train")[1].sensor_video[2]))
    np.testing.assert_array_equal(clip[9], realtouch.load(seq_folder, "train")[1].sensor_video[2][9])
    with pytest.raises(AttributeError, match="frozen"):
        touch.round = record


def test_missing_columns_are_named_when_asked_for(seq_rows: list[dict], tmp_path: Path) -> None:
    layout = Layout(leave_out=("object_id", "touch_start_time_rel", "gel_pose_cell_frame_seq.position"))
    factories.write_set(tmp_path, {"train": seq_rows[:1]}, "seq", layout)
    dataset = realtouch.load(tmp_path)
    record = dataset[0]
    assert record.label == 0
    assert record.sensor_video[0][0].shape == (72, 96, 3)
    for read, column in (
        (lambda: record.object_id, "object_id"),
        (lambda: record.touch_start_time_rel, "touch_start_time_rel"),
        (lambda: record.sensor_video[0].contact_window, "touch_start_time_rel"),
        (lambda: record.gel_pose_cell_frame_seq, "gel_pose_cell_frame_seq.position"),
        (lambda: dataset.touches().heights_m(), "gel_pose_cell_frame_seq.position"),
        (lambda: dataset.touches().with_contact(0.006), "gel_pose_cell_frame_seq.position"),
    ):
        with pytest.raises(InputError, match=f"no column '{column}'"):
            read()


def test_a_set_of_neither_kind_is_refused(single_rows: list[dict], tmp_path: Path) -> None:
    layout = Layout(leave_out=("sensor_image",))
    factories.write_set(tmp_path, {"train": single_rows}, "single", layout)
    with pytest.raises(InputError, match="for touches, with a column 'sensor_image' or 'sensor_video'"):
        realtouch.load(tmp_path)


def test_missing_items_are_named(tmp_path: Path, single_folder: Path) -> None:
    with pytest.raises(InputError, match="does not exist; expected a folder"):
        realtouch.load(str(tmp_path / "nowhere"))
    with pytest.raises(InputError, match="no split 'holdout'"):
        realtouch.load(single_folder, "holdout")
    with pytest.raises(InputError, match="does not exist; expected"):
        realtouch.load([tmp_path / "a.parquet"])


def test_short_names_reach_the_published_repositories(monkeypatch, tmp_path):
    calls = []

    def refuse(repo_id: str, revision: str | None) -> object:
        calls.append((repo_id, revision))
        raise InputError(repo_id)

    monkeypatch.setattr("tactile_toolkit.hub.open_repository", refuse)
    with pytest.raises(InputError, match="touch-real-seq"):
        realtouch.load("real-seq", revision="main", streaming=True)
    assert calls == [("TimSchneider42/tactile-mnist-touch-real-seq-t256-320x240", "main")]


def test_import_is_quick_and_light() -> None:
    code = (
        "import sys, realtouch; print(*(n for n in sys.modules if n in ('numpy', 'pyarrow', 'torch', 'av')))"
    )
    assert printed_by(code).strip() == ""


def test_padding_to_a_fixed_length_adds_no_frames(truth: list[RoundTruth], tmp_path: Path) -> None:
    layout = Layout()
    factories.write_set(tmp_path, {"train": factories.seq_rows(truth[:1], layout)}, "seq", layout)
    (file,) = (tmp_path / "data").iterdir()
    table = pq.read_table(file)
    for place, field in enumerate(table.schema):
        if "_seq" in field.name:
            frames = len(table[place][0][0])
            values = field.type.value_type.value_type
            fixed = pa.list_(pa.list_(values, frames), field.type.list_size)
            table = table.set_column(place, field.name, table[place].cast(fixed))
    pq.write_table(table, file)
    lengths = [touch.frames for touch in truth[0].touches]
    assert min(lengths) < frames
    record = realtouch.load(tmp_path)[0]
    assert [len(stamps) for stamps in record.time_stamp_rel_seq] == lengths
    assert [len(poses.position_m) for poses in record.gel_pose_cell_frame_seq] == lengths


def test_missing_lengths_are_named(seq_folder: Path) -> None:
    group = realtouch.load(seq_folder, "train")[0].row.group
    row = StoredRound(RowGroup(group.table.drop_columns(["video_length_frames"])), 0)
    for ask in (
        StoredRound.pose_sequences,
        lambda row: row.pose_sequences(0),
        lambda row: row.contact_z_m(),
        lambda row: realtouch.TouchClip(row, 0),
    ):
        with pytest.raises(InputError, match="no column 'video_length_frames'"):
            ask(row)
