"""Damage of a part of a data set is named, and the rest can be used."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

import realtouch
from tactile_toolkit.errors import IntegrityError
from tests.realtouch import factories
from tests.realtouch.factories import Layout
from tests.realtouch.test_damage import damaged_set, no_jpeg, one_touch_less


def two_flat_quaternions(row: dict[str, Any]) -> None:
    for touch in (1, 3):
        row["gel_pose_cell_frame.quaternion"][touch] = np.zeros(4)


def two_flat_frames(row: dict[str, Any]) -> None:
    poses = [list(touch) for touch in row["gel_pose_cell_frame_seq.quaternion"]]
    poses[1][5] = poses[3][7] = np.zeros(4)
    row["gel_pose_cell_frame_seq.quaternion"] = poses


def no_height(row: dict[str, Any]) -> None:
    row["gel_pose_cell_frame.position"][0] = np.array([0.0, 0.0, np.nan])


def lacking_poses(row: dict[str, Any]) -> None:
    row["gel_pose_cell_frame.position"] = row["gel_pose_cell_frame.position"][:-1]


def nowhere(row: dict[str, Any]) -> None:
    for touch in (0, 2):
        row["pos_in_cell"][touch] = np.nan


def no_positions(row: dict[str, Any]) -> None:
    row["pos_in_cell"] = None


def spoil_pages(file: Path, group: int, column: str) -> None:
    """Zero the beginning of a column in a row group."""
    columns = pq.ParquetFile(file).metadata.row_group(group)
    found = [columns.column(place) for place in range(columns.num_columns)]
    start = next(each.data_page_offset for each in found if each.path_in_schema.startswith(column))
    data = bytearray(file.read_bytes())
    data[start : start + 40] = bytes(40)
    file.write_bytes(bytes(data))


def only_file(folder: Path) -> Path:
    return folder / "data" / "train-00000-of-00001.parquet"


@pytest.mark.parametrize("edit", [two_flat_quaternions, nowhere])
def test_every_damaged_touch_of_a_round_is_listed(edit: Any, single_rows: list[dict], tmp_path: Path) -> None:
    lost = {1, 3} if edit is two_flat_quaternions else {0, 2}
    folder = damaged_set(tmp_path, single_rows, "single", edit)
    assert {(each.row, each.touch) for each in realtouch.verify(folder).findings} == {
        (1, touch) for touch in lost
    }
    touches = realtouch.load(folder).touches()
    truth = realtouch.load(
        factories.write_set(tmp_path / "whole", {"train": single_rows}, "single")
    ).touches()
    for index in range(15):
        if index - 5 in lost:
            with pytest.raises(IntegrityError, match=f"row 1, touch {index - 5},"):
                _ = touches[index].gel_pose, touches[index].pos_in_cell_m
        else:
            pose = touches[index].gel_pose
            np.testing.assert_array_equal(pose.as_matrix(), truth[index].gel_pose.as_matrix())
            np.testing.assert_array_equal(touches[index].pos_in_cell_m, truth[index].pos_in_cell_m)


def test_clips_beside_a_damaged_one_keep_their_poses(seq_rows: list[dict], tmp_path: Path) -> None:
    folder = damaged_set(tmp_path, seq_rows, "seq", two_flat_frames)
    touches = realtouch.load(folder).touches()
    for touch in touches[[5, 7, 9]]:
        clip = touch.clip
        pose = clip.poses[clip.contact_index("contact_end")]
        np.testing.assert_array_equal(touch.gel_pose.as_matrix(), pose.as_matrix())


def test_clips_beside_one_without_a_height_keep_theirs(seq_rows: list[dict], tmp_path: Path) -> None:
    def no_height_of_a_frame(row: dict[str, Any]) -> None:
        poses = [list(touch) for touch in row["gel_pose_cell_frame_seq.position"]]
        poses[1][5] = np.array([0.0, 0.0, np.nan])
        row["gel_pose_cell_frame_seq.position"] = poses

    folder = damaged_set(tmp_path, seq_rows, "seq", no_height_of_a_frame)
    whole = factories.write_set(tmp_path / "whole", {"train": seq_rows}, "seq")
    kept = [number for number in range(15) if number != 6]
    touches = realtouch.load(folder).touches()[kept]
    np.testing.assert_array_equal(touches.heights_m(), realtouch.load(whole).touches().heights_m()[kept])
    with pytest.raises(IntegrityError, match=r"row 1, touch 1, .* a gel height of nan; expected metres"):
        realtouch.load(folder).touches().heights_m()


@pytest.mark.parametrize(("edit", "left"), [(no_height, 11), (lacking_poses, 8)])
def test_heights_of_a_view_need_no_other(edit, left, single_rows, tmp_path):
    whole = realtouch.load(damaged_set(tmp_path, single_rows, "single", edit))
    assert len(whole[[0, 2]].touches().with_contact()) == 8  # rows outside of a view do not matter
    with pytest.raises(IntegrityError, match="row 1"):
        whole.touches().with_contact()
    with pytest.raises(IntegrityError, match="row 1"):
        whole.touches().heights_m()
    assert np.isfinite(whole[0:1].touches().heights_m()).all()
    if edit is no_height:
        assert len(whole.touches()[[*range(5), *range(6, 15)]].with_contact()) == left


def test_a_round_shows_its_good_touches(single_rows: list[dict], tmp_path: Path) -> None:
    shown = realtouch.load(damaged_set(tmp_path, single_rows, "single", no_jpeg))[1]
    assert shown._repr_html_().count("<img") == 4
    assert "1 of 5 pictures cannot be shown" in shown._repr_html_()


def test_a_file_cut_in_the_middle_is_named(single_folder: Path, tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    for file in (single_folder / "data").glob("train-*"):
        (tmp_path / "data" / file.name).write_bytes(file.read_bytes())
    cut = tmp_path / "data" / "train-00001-of-00002.parquet"
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    findings = realtouch.verify(tmp_path).findings
    assert [(each.file, each.row) for each in findings] == [(str(cut), None)]
    assert "an intact Parquet file was expected" in findings[0].problem
    for streaming in (False, True):
        with pytest.raises(IntegrityError, match="an intact Parquet file was expected"):
            realtouch.load(tmp_path, streaming=streaming)


@pytest.mark.parametrize("column", ["sensor_image", "label", "gel_pose_cell_frame.position"])
def test_unreadable_rows_are_named(column: str, single_rows: list[dict], tmp_path: Path) -> None:
    factories.write_set(tmp_path, {"train": single_rows}, "single", Layout(group_rows=1))
    spoil_pages(only_file(tmp_path), 1, column)
    result = realtouch.verify(tmp_path)
    assert (result.rounds, [each.row for each in result.findings]) == (2, [1])
    assert result.findings[0].problem.startswith("cannot be read (")  # the row is named before it
    assert str(result.findings[0]).count(str(only_file(tmp_path))) == 1
    dataset = realtouch.load(tmp_path)
    for row in (0, 2):
        assert dataset[row].id == single_rows[row]["id"]
        assert dataset[row].sensor_image[0].shape == (72, 96, 3)
    with pytest.raises(IntegrityError):
        _ = dataset[1].label, dataset[1].sensor_image[0], dataset[1].gel_pose_cell_frame


def test_verify_continues_after_unreadable_rows(single_rows: list[dict], tmp_path: Path) -> None:
    layout = Layout(group_rows=2, edit=lambda row, index: no_jpeg(row) if index == 2 else None)
    rows = [{**row, "sensor_image": [dict(blob) for blob in row["sensor_image"]]} for row in single_rows]
    factories.write_set(tmp_path, {"train": rows}, "single", layout)
    spoil_pages(only_file(tmp_path), 0, "sensor_image")
    first, second = realtouch.verify(tmp_path).findings
    assert "rows 0 to 1 cannot be read" in first.problem
    assert (second.row, second.touch) == (2, 1)
    assert "next:" not in f"{first}{second}"


def test_the_number_of_touches_of_a_round_follows_one_rule(single_rows: list[dict], tmp_path: Path) -> None:
    short = damaged_set(tmp_path / "of three", single_rows, "single", one_touch_less)
    assert [each.field for each in realtouch.verify(short).findings] == ["pos_in_cell"]
    either = damaged_set(tmp_path / "of two", single_rows[:2], "single", one_touch_less)
    assert realtouch.verify(either).ok  # no number is that of more than half


def test_rounds_of_chosen_touches_may_differ(single_rows: list[dict], tmp_path: Path) -> None:
    def beside(row: dict[str, Any]) -> None:
        for touch in (0, 1):  # as touch 2, which meets the plate
            row["gel_pose_cell_frame.position"][touch] = row["gel_pose_cell_frame.position"][2]

    folder = damaged_set(tmp_path / "all", single_rows, "single", beside)
    realtouch.select(str(folder), str(tmp_path / "chosen"), contact=True)
    assert realtouch.verify(tmp_path / "chosen").ok
    for streaming in (False, True):
        dataset = realtouch.load(tmp_path / "chosen", streaming=streaming)
        assert [record.touch_count for record in dataset] == [4, 2, 4]


def test_null_positions_are_damage_of_the_round(single_rows: list[dict], tmp_path: Path) -> None:
    for fixed in (False, True):
        layout = Layout(fixed=fixed, edit=lambda row, index: no_positions(row) if index == 1 else None)
        folder = factories.write_set(tmp_path / f"{fixed}", {"train": single_rows}, "single", layout)
        findings = realtouch.verify(folder).findings
        assert [(each.row, each.touch, each.field) for each in findings] == [(1, None, "pos_in_cell")]
