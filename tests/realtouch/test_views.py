"""Touches and rounds from views: pickled state, reads, and refused arguments."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

import realtouch
from realtouch.touches.rounds import Touch
from tactile_toolkit.errors import InputError
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


def test_the_pose_of_a_touch_reads_its_own_numbers_only(seq_folder, single_folder, monkeypatch):
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


def test_heights_of_a_set_without_intended_positions(single_rows, single_folder, tmp_path):
    factories.write_set(tmp_path, {"train": single_rows}, "single", Layout(leave_out=("pos_in_cell",)))
    touches = realtouch.load(tmp_path).touches()
    np.testing.assert_array_equal(
        touches.heights_m(), realtouch.load(single_folder, "train").touches().heights_m()
    )
    assert "<img" in touches[0]._repr_html_()


def test_a_round_without_touches_is_named_among_the_pictures_of_a_set(single_rows, tmp_path):
    def edit(row: dict[str, Any], index: int) -> None:
        if index == 1:
            for name in ("sensor_image", "pos_in_cell"):
                row[name] = []
            for part in ("position", "quaternion"):
                row[f"gel_pose_cell_frame.{part}"] = []

    factories.write_set(tmp_path, {"train": single_rows[:3]}, "single", Layout(edit=edit, fixed=False))
    shown = realtouch.load(tmp_path)._repr_html_()
    assert shown.count("<img") == 2
    assert "the round has no touches" in shown


@pytest.mark.parametrize(
    ("use", "answer"),
    [
        (lambda rounds, touch: touch["image"], "fields are attributes; next: write .image"),
        (lambda rounds, touch: rounds[0]["label"], "fields are attributes; next: write .label"),
        (lambda rounds, touch: touch["imag"], "touch_index; did you mean 'image'?"),
        (lambda rounds, touch: touch.keys(), "attributes: caption, clip, "),
        (lambda rounds, touch: dict(touch), "attributes: caption, clip, "),
        (lambda rounds, touch: rounds["label"], "next: write .column('label')"),
        (lambda rounds, touch: rounds.touches()["image"], "name one of the columns with .column(NAME): id, "),
        (
            lambda rounds, touch: rounds.column("labl"),
            "did you mean 'label'?; it has the columns id, label, ",
        ),
        (lambda rounds, touch: realtouch.load("./touche"), "did you mean 'touches'?"),
    ],
)
def test_habits_of_dictionaries_and_wrong_names_are_answered(
    use, answer, single_folder, monkeypatch, tmp_path
):
    rounds = realtouch.load(single_folder, "train")
    (tmp_path / "touches").mkdir()
    monkeypatch.chdir(tmp_path)
    with pytest.raises((TypeError, AttributeError, InputError)) as raised:
        use(rounds, rounds.touches()[0])
    assert answer in str(raised.value)
    assert not hasattr(rounds[0], "_no_such_field")
