"""Touches and rounds taken out of views: what they carry along, what they read, what they refuse."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import realtouch
from realtouch.touch import Touch
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.read.order import GlobalOrder
from tests.realtouch import factories
from tests.realtouch.factories import Layout


def test_a_touch_kept_from_a_filter_carries_its_picture(single_folder: Path, seq_folder: Path) -> None:
    for folder in (single_folder, seq_folder):
        touches = realtouch.load(folder, "train").touches()
        kept: list[Touch] = []
        touches.filter(lambda touch, kept=kept: kept.append(touch) or True)
        expected = touches[8].image
        alone = kept[8].round.with_touches([3])
        for same in (pickle.loads(pickle.dumps(kept[8])), kept[8]._alone(), Touch(alone, 3, 0)):
            np.testing.assert_array_equal(same.image, expected)
        light = next(record for row, record in touches.dataset.rounds_without_media() if row == 1)
        np.testing.assert_array_equal(Touch(pickle.loads(pickle.dumps(light)), 3).image, expected)


def test_the_pose_of_a_touch_reads_its_own_numbers_only(
    seq_folder: Path, single_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    read = pq.ParquetFile.iter_batches

    def spy(
        self: pq.ParquetFile, size: int, groups: list[int], columns: list[str] | None = None, **options: Any
    ) -> Any:
        asked.extend(columns or ["everything"])
        return read(self, size, groups, columns, **options)

    expected = [
        touch.clip.poses[touch.clip.contact_index()]
        for touch in realtouch.load(seq_folder, "train").touches()
    ]
    monkeypatch.setattr(pq.ParquetFile, "iter_batches", spy)
    poses: list[Any] = []
    realtouch.load(seq_folder, "train").touches().filter(lambda touch: poses.append(touch.gel_pose) or True)
    assert asked
    assert not {"sensor_video", "everything"} & set(asked)
    for pose, same in zip(poses, expected, strict=True):
        np.testing.assert_array_equal(pose.as_matrix(), same.as_matrix())
    record = realtouch.load(single_folder, "train")[0]
    for touch in (0, 4, -1):
        pose = Touch(record, touch).gel_pose.as_matrix()
        np.testing.assert_array_equal(pose, record.gel_pose_cell_frame[touch].as_matrix())
    with pytest.raises(IndexError, match="touch 5 is out of range for 5 touches"):
        _ = Touch(record, 5).gel_pose


def test_metadata_are_a_dict_of_the_caller(single_folder: Path) -> None:
    record = realtouch.load(single_folder, "train")[0]
    info = record.info
    for same in (pickle.loads(pickle.dumps(info)), copy.deepcopy(info)):
        assert list(same) == list(info) == ["gel_id", "notes", "object_pose"]
        np.testing.assert_array_equal(same["object_pose"].as_matrix(), info["object_pose"].as_matrix())
    before, info["gel_id"] = info["gel_id"], 7
    assert record.info["gel_id"] == before


def test_only_data_sets_of_one_kind_are_joined(single_folder: Path, seq_folder: Path) -> None:
    dataset = realtouch.load(single_folder, "train")
    for other in (realtouch.load(seq_folder, "train"), 5):
        with pytest.raises(TypeError, match=r"unsupported operand type\(s\) for \+"):
            _ = dataset + other


def test_classes_and_objects_are_given_one_by_one_or_together(single_folder: Path) -> None:
    touches = realtouch.load(single_folder, "train").touches()
    for classes in ((0, "1"), ([0, 1],), (np.array([0, 1]),), (range(2),), (np.int8(0), ["1"])):
        assert touches.filter_labels(*classes).labels.tolist() == [0] * 5 + [1] * 5
    for objects in ((4000, 4001), ([4000, 4001],), (np.array([4000, 4001]),), ({4000}, 4001, -3, 2**70)):
        assert sorted(set(touches.objects(*objects).object_ids.tolist())) == [4000, 4001]
    for classes in (1.5, True, None, [0, 1.0], b"1", np.array([True, False])):
        with pytest.raises(InputError, match=r"no class .* expected an integer below 10 or one of"):
            touches.filter_labels(classes)
    for objects in ("4000", 4000.0, False, ["4000"]):
        with pytest.raises(InputError, match="expected object ids as integers"):
            touches.objects(objects)


def test_a_missing_column_is_told_beside_all_that_are_there(single_rows: list[dict], tmp_path: Path) -> None:
    layout = Layout(leave_out=("gel_pose_cell_frame.position",))
    factories.write_set(tmp_path, {"train": single_rows}, "single", layout)
    with pytest.raises(InputError, match=r"no column 'gel_pose_cell_frame\.position'; next"):
        realtouch.load(tmp_path).touches().with_contact()


def test_clips_are_no_images(seq_folder: Path) -> None:
    with pytest.raises(InputError, match="no column 'sensor_image'"):
        realtouch.load(seq_folder, "train").touches().images([0])


def test_of_no_rounds_there_are_no_rows(single_folder: Path) -> None:
    assert len(realtouch.load(single_folder, "train")[:0].touches().to_hf()) == 0


def test_any_choice_of_touches_is_trained_on_file_by_file(single_folder: Path) -> None:
    data = realtouch.load(single_folder, "train")
    for touches in (
        data.touches(),
        data[[2, 0]].touches(),
        data.touches()[::-2],
        data.touches().sample(9, 1),
    ):
        places = GlobalOrder(touches._stored_parts(), None, 1).epoch(0).positions(np.arange(len(touches)))
        assert sorted(places) == list(range(len(touches)))
        rows = [(touch.object_id, touch.touch_index) for touch in (touches[int(place)] for place in places)]
        assert rows == sorted(rows), "as they are stored"


def test_heights_of_a_set_without_intended_positions(
    single_rows: list[dict], single_folder: Path, tmp_path: Path
) -> None:
    factories.write_set(tmp_path, {"train": single_rows}, "single", Layout(leave_out=("pos_in_cell",)))
    touches = realtouch.load(tmp_path).touches()
    np.testing.assert_array_equal(
        touches.heights_m(), realtouch.load(single_folder, "train").touches().heights_m()
    )
    assert "<img" in touches[0]._repr_html_()


def test_large_ids_are_not_rounded_beside_a_missing_one(single_rows: list[dict], tmp_path: Path) -> None:
    factories.write_set(tmp_path, {"train": single_rows}, "single")
    place = tmp_path / "data" / "train-00000-of-00001.parquet"
    table = pq.read_table(place)
    ids = pa.array([2**53 + 1, None, 2**62 + 1])
    pq.write_table(table.set_column(table.column_names.index("object_id"), "object_id", ids), place)
    dataset = realtouch.load(tmp_path)
    assert (dataset[0].object_id, dataset[2].object_id) == (2**53 + 1, 2**62 + 1)
    with pytest.raises(IntegrityError, match="row 1, field 'object_id'"):
        _ = dataset[1].object_id
    with pytest.raises(IntegrityError, match="row 1, field 'object_id': no value is stored"):
        dataset.touches().objects(2**62 + 1)
    touches = dataset[[0, 2]].touches()
    assert set(touches.object_ids.tolist()) == {2**53 + 1, 2**62 + 1}
    assert {touch.object_id for touch in touches.objects(2**62 + 1)} == {2**62 + 1}
