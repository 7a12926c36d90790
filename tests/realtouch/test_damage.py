"""Bad input: each kind names file, row, touch and field; verify lists them all; skip leaves them out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import realtouch
from realtouch.video.avi import Avi
from tactile_toolkit.errors import IntegrityError
from tests.realtouch import factories
from tests.realtouch.factories import Layout

Edit = Callable[[dict[str, Any]], None]


def cut_image(row: dict[str, Any]) -> None:
    row["sensor_image"][3]["bytes"] = row["sensor_image"][3]["bytes"][:-400]


def no_jpeg(row: dict[str, Any]) -> None:
    row["sensor_image"][1]["bytes"] = b"this is no picture"


def no_bytes(row: dict[str, Any]) -> None:
    row["sensor_image"][4] = {"bytes": None, "path": "/etc/passwd"}


def bomb(row: dict[str, Any]) -> None:
    data = bytearray(row["sensor_image"][2]["bytes"])
    place = data.find(b"\xff\xc0")
    data[place + 5 : place + 9] = b"\xf0\x00\xf0\x00"
    row["sensor_image"][2]["bytes"] = bytes(data)


def flat_quaternion(row: dict[str, Any]) -> None:
    row["gel_pose_cell_frame.quaternion"][2] = np.zeros(4)


def endless_position(row: dict[str, Any]) -> None:
    row["gel_pose_cell_frame.position"][0] = np.array([0.0, np.inf, 0.0])


def one_image_less(row: dict[str, Any]) -> None:
    row["sensor_image"] = row["sensor_image"][:-1]


def one_touch_less(row: dict[str, Any]) -> None:
    for name in ("pos_in_cell", "gel_pose_cell_frame.position", "gel_pose_cell_frame.quaternion"):
        row[name] = row[name][:-1]
    one_image_less(row)


def wild_object(row: dict[str, Any]) -> None:
    row["object_id"] = -7


def no_label(row: dict[str, Any]) -> None:
    row["label"] = None


def no_position(row: dict[str, Any]) -> None:
    row["pos_in_cell"] = [*row["pos_in_cell"][:3], [None, 0.0], row["pos_in_cell"][4]]


def cut_avi(row: dict[str, Any]) -> None:
    row["sensor_video"][2]["bytes"] = row["sensor_video"][2]["bytes"][:-700]


def no_avi(row: dict[str, Any]) -> None:
    row["sensor_video"][0]["bytes"] = b"RIFF no film"


def play_list(row: dict[str, Any]) -> None:
    """Video players would open a file of the user, and return its content."""
    row["sensor_video"][2]["bytes"] = b"#EXTM3U\n#EXTINF:9,\nsecret.avi\n#EXT-X-ENDLIST\n"


def no_index(row: dict[str, Any]) -> None:
    row["sensor_video"][0]["bytes"] = row["sensor_video"][0]["bytes"].replace(b"idx1", b"JUNK")


def wild_index(row: dict[str, Any]) -> None:
    data = bytearray(row["sensor_video"][0]["bytes"])
    offset = data.rindex(b"idx1") + 8 + 16 * 6 + 8
    data[offset : offset + 4] = b"\xff\xff\xff\x7f"
    row["sensor_video"][0]["bytes"] = bytes(data)


def other_codec(row: dict[str, Any]) -> None:
    row["sensor_video"][0]["bytes"] = factories.encode_avi(np.zeros((9, 72, 96, 3), np.uint8), "mpeg4")


def other_container(row: dict[str, Any]) -> None:
    frames = np.zeros((9, 72, 96, 3), np.uint8)
    row["sensor_video"][0]["bytes"] = factories.encode_avi(frames, "mpeg4", "matroska")


def bad_frame(row: dict[str, Any]) -> None:
    data = bytearray(row["sensor_video"][1]["bytes"])
    index = Avi(memoryview(bytes(data)))
    start = int(index.starts[6])
    data[start : start + int(index.sizes[6])] = bytes(int(index.sizes[6]))
    row["sensor_video"][1]["bytes"] = bytes(data)


def many_frames(row: dict[str, Any]) -> None:
    row["video_length_frames"] = [2_000_000_000, *row["video_length_frames"][1:]]


def end_before_start(row: dict[str, Any]) -> None:
    row["touch_end_time_rel"] = row["touch_start_time_rel"] - np.timedelta64(80, "ms")


def short_poses(row: dict[str, Any]) -> None:
    poses = list(row["gel_pose_cell_frame_seq.position"])
    poses[4] = poses[4][:20]
    row["gel_pose_cell_frame_seq.position"] = poses


def flat_frame(row: dict[str, Any]) -> None:
    poses = [list(touch) for touch in row["gel_pose_cell_frame_seq.quaternion"]]
    poses[1][5] = np.zeros(4)
    row["gel_pose_cell_frame_seq.quaternion"] = poses


def one_clip_less(row: dict[str, Any]) -> None:
    row["sensor_video"] = row["sensor_video"][:-1]


def damaged_set(folder: Path, rows: list[dict], kind: str, edit: Edit, row: int = 1) -> Path:
    """Write three rounds of which one is damaged."""

    def change(values: dict[str, Any], index: int) -> None:
        if index == row:
            for name in ("sensor_image", "sensor_video"):
                if name in values:
                    values[name] = [dict(blob) for blob in values[name]]
            for name, value in values.items():
                if isinstance(value, np.ndarray):
                    values[name] = value.copy()
                elif isinstance(value, list) and name not in ("sensor_image", "sensor_video"):
                    values[name] = list(value)
            edit(values)

    return factories.write_set(folder, {"train": rows}, kind, Layout(edit=change, fixed=False))


def everything(record: Any, kind: str) -> None:
    """Read every field of a round."""
    _ = record.id, record.label, record.object_id, record.info, record.pos_in_cell_m
    if kind == "single":
        _ = record.gel_pose_cell_frame, record.sensor_image[:]
        return
    _ = record.gel_pose_cell_frame_seq, record.time_stamp_rel_seq, record.video_length_frames
    for touch in range(record.touch_count):
        clip = record.sensor_video[touch]
        _ = clip.frames(), clip.contact_window, clip.poses


CASES: list[tuple[str, Edit, int | None, str, str]] = [
    ("single", cut_image, 3, "sensor_image", "cannot be decoded"),
    ("single", no_jpeg, 1, "sensor_image", "expected a JPEG"),
    ("single", no_bytes, 4, "sensor_image", "no bytes are stored"),
    ("single", bomb, 2, "sensor_image", "61440 x 61440 pixels; the limit is"),
    ("single", flat_quaternion, 2, "gel_pose_cell_frame", "quaternion of length 0; expected length one"),
    ("single", endless_position, 0, "gel_pose_cell_frame", "not finite"),
    ("single", one_image_less, None, "sensor_image", "4 touches; expected 5"),
    ("single", one_touch_less, None, "pos_in_cell", "4 touches; expected 5"),
    ("single", no_position, 3, "pos_in_cell", "expected metres"),
    ("single", wild_object, None, "object_id", "-7; expected an integer of 0 or more"),
    ("single", no_label, None, "label", "no value is stored; expected an integer"),
    ("seq", cut_avi, 2, "sensor_video", "an AVI cut short"),
    ("seq", no_avi, 0, "sensor_video", "expected an AVI"),
    ("seq", play_list, 2, "sensor_video", "expected an AVI"),
    ("seq", no_index, 0, "sensor_video", "an AVI without 'idx1'; expected an index of MJPEG frames"),
    ("seq", wild_index, 0, "sensor_video", "an AVI whose index has frame 6 of"),
    ("seq", other_codec, 0, "sensor_video", "an AVI without an MJPEG stream; expected one"),
    ("seq", other_container, 0, "sensor_video", "bytes that begin with 1a 45 df a3"),
    ("seq", bad_frame, 1, "sensor_video", "frame 6"),
    (
        "seq",
        many_frames,
        0,
        "video_length_frames",
        "2,000,000,000 frames; expected an integer of 0 to 10,000",
    ),
    ("seq", end_before_start, 0, "touch_end_time_rel", "expected an end not before the start"),
    ("seq", short_poses, 4, "gel_pose_cell_frame_seq.position", "20 frames; expected at least"),
    ("seq", flat_frame, 1, "gel_pose_cell_frame_seq", "frame 5: a quaternion of length 0"),
    ("seq", one_clip_less, None, "sensor_video", "4 touches; expected 5"),
]


@pytest.mark.parametrize(("kind", "edit", "touch", "field", "words"), CASES)
def test_damage_is_named_and_listed(kind, edit, touch, field, words, single_rows, seq_rows, tmp_path):
    rows = single_rows if kind == "single" else seq_rows
    folder = damaged_set(tmp_path, rows, kind, edit)
    dataset = realtouch.load(folder)
    everything(dataset[0], kind)
    everything(dataset[2], kind)
    if edit is not one_touch_less:  # a round that is valid in itself
        with pytest.raises(IntegrityError) as caught:
            everything(dataset[1], kind)
        message = str(caught.value)
        assert "train-00000-of-00001.parquet', row 1" in message
        assert f"field '{field}'" in message
        assert words in message
        assert "next: run `tactile verify`" in message
        if touch is not None:
            assert f"touch {touch}," in message

    result = realtouch.verify(str(folder))
    assert (result.ok, result.rounds) == (False, 3)
    assert {finding.row for finding in result.findings} == {1}
    found = [finding for finding in result.findings if finding.field == field and words in finding.problem]
    assert [finding.touch for finding in found][:1] == [touch]
    assert len(result.findings) <= (5 if edit is end_before_start else 2)


@pytest.mark.parametrize(
    "field",
    [
        *("gel_pose_cell_frame_seq.position", "gel_pose_cell_frame_seq.quaternion", "time_stamp_rel_seq"),
        *("video_length_frames", "touch_start_time_rel"),
    ],
)
def test_the_last_touch_never_gets_values_of_the_next_round(field, seq_rows, tmp_path):
    def one_less(row: dict[str, Any]) -> None:
        row[field] = row[field][:-1]

    record = realtouch.load(damaged_set(tmp_path, seq_rows, "seq", one_less))[1]
    with pytest.raises(IntegrityError, match=f"field '{field}'.*4 touches; expected 5"):
        _ = [(clip.poses, clip.timestamps_s, clip.contact_window) for clip in record.sensor_video]


def test_verify_lists_all_damage_of_all_files(single_rows: list[dict], tmp_path: Path) -> None:
    def edit(row: dict[str, Any]) -> None:
        for change in (cut_image, no_jpeg, no_bytes, flat_quaternion, wild_object):
            change(row)

    folder = damaged_set(tmp_path, single_rows, "single", edit)
    broken = folder / "data" / "test-00000-of-00001.parquet"
    broken.write_bytes(b"PAR1 and nothing more")
    result = realtouch.verify(str(folder))
    assert result.rounds == 3
    assert any(finding.file == str(broken) and finding.row is None for finding in result.findings)
    assert {(finding.field, finding.touch) for finding in result.findings if finding.row == 1} == {
        ("sensor_image", 3),
        ("sensor_image", 1),
        ("sensor_image", 4),
        ("gel_pose_cell_frame", 2),
        ("object_id", None),
    }


def test_a_whole_set_has_no_findings(single_folder: Path, seq_folder: Path) -> None:
    for folder in (single_folder, seq_folder):
        told: list[tuple[int, int]] = []
        result = realtouch.verify(str(folder), on_progress=lambda *now, told=told: told.append(now))
        assert (result.findings, result.rounds, result.touches) == ((), 4, 20)
        assert told[-1] == (4, 4)


def test_repeated_ids_are_found(single_rows: list[dict], tmp_path: Path) -> None:
    factories.write_set(tmp_path, {"train": [single_rows[0], single_rows[0]]}, "single")
    findings = realtouch.verify(str(tmp_path)).findings
    assert [(finding.row, finding.field) for finding in findings] == [(1, "id")]
    assert "not unique" in findings[0].problem


@pytest.mark.parametrize(
    ("column", "values", "expected"),
    [
        ("label", pa.array(["a", "b", "c"]), "an integer"),
        ("object_id", pa.array(["a", "b", "c"]), "an integer"),
        ("pos_in_cell", pa.array([[1.0], [2.0], [3.0]]), "two floats per touch"),
        ("sensor_image", pa.array([["x"], ["y"], ["z"]]), "a struct of bytes and path"),
        ("gel_pose_cell_frame.position", pa.array([[["x"]]] * 3), "three floats per touch"),
    ],
)
def test_a_wrong_column_type_is_named(column, values, expected, single_rows, tmp_path):
    factories.write_set(tmp_path, {"train": single_rows}, "single")
    place = tmp_path / "data" / "train-00000-of-00001.parquet"
    table = pq.read_table(place)
    table = table.set_column(table.column_names.index(column), column, values)
    pq.write_table(table, place)
    with pytest.raises(
        IntegrityError, match=f"field '{column}': the column has the type .*; expected {expected}"
    ):
        realtouch.load(tmp_path)
    assert not realtouch.verify(str(tmp_path)).ok


def no_start(row: dict[str, Any]) -> None:
    row["touch_start_time_rel"] = [*row["touch_start_time_rel"][:3], None, row["touch_start_time_rel"][4]]


@pytest.mark.parametrize("seconds", [False, True])
def test_missing_times(seconds: bool, truth: list, tmp_path: Path) -> None:
    layout = Layout(seconds=seconds, edit=lambda row, index: no_start(row) if index == 1 else None)
    factories.write_set(tmp_path, {"train": factories.seq_rows(truth, layout)}, "seq", layout)
    record = realtouch.load(tmp_path)[1]
    for ask, problem in (
        (lambda: record.touch_start_time_rel, "no time is stored"),
        (lambda: record.sensor_video[3].contact_window, "contact from nan s"),
        (record.contact_frames, "contact from nan s"),
    ):
        with pytest.raises(IntegrityError, match=f"touch 3, field 'touch_start_time_rel': {problem}"):
            ask()
    assert record.sensor_video[2].contact_window.start == truth[1].touches[2].contact_start
    assert len(record.touch_end_time_rel) == 5
    findings = realtouch.verify(str(tmp_path)).findings
    assert {(finding.row, finding.touch, finding.field) for finding in findings} == {
        (1, 3, "touch_start_time_rel")
    }


def with_object_ids(folder: Path, rows: list[dict], ids: pa.Array) -> Path:
    factories.write_set(folder, {"train": rows}, "single")
    place = folder / "data" / "train-00000-of-00001.parquet"
    table = pq.ParquetFile(place).read()
    pq.write_table(table.set_column(table.column_names.index("object_id"), "object_id", ids), place)
    return folder


def test_object_ids_that_do_not_fit(single_rows: list[dict], tmp_path: Path) -> None:
    ids = pa.array([4000, 2**64 - 1, 2**63 - 1], pa.uint64())
    dataset = realtouch.load(with_object_ids(tmp_path, single_rows, ids))
    named = f"row 1, field 'object_id': the value is {2**64 - 1}; expected an integer"
    touches = dataset.touches()
    for ask in (lambda: dataset[1].object_id, lambda: touches.object_ids, lambda: touches.objects(4000)):
        with pytest.raises(IntegrityError, match=named):
            ask()
    assert dataset[2].object_id == 2**63 - 1
    assert dataset[[0, 2]].touches().object_ids.tolist() == [4000] * 5 + [2**63 - 1] * 5
    assert [(finding.row, finding.field) for finding in realtouch.verify(str(tmp_path)).findings] == [
        (1, "object_id")
    ]


def test_missing_labels_and_objects(single_rows: list[dict], tmp_path: Path) -> None:
    def forget(row: dict[str, Any]) -> None:
        row["label"] = row["object_id"] = None

    dataset = realtouch.load(damaged_set(tmp_path, single_rows, "single", forget))
    touches = dataset.touches()
    for field, ask in (
        ("label", lambda: dataset.labels),
        ("label", lambda: touches.labels),
        ("label", lambda: touches.filter_labels(0)),
        ("object_id", lambda: touches.object_ids),
    ):
        with pytest.raises(IntegrityError, match=f"row 1, field '{field}': no value is stored"):
            ask()
