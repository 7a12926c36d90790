"""Arguments of :func:`realtouch.verify`, and its findings beside damaged pictures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import realtouch
from realtouch.checks.verification import list_findings
from realtouch.video.avi import write_avi
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.store import open_folder
from tests.command_line import call
from tests.realtouch import factories
from tests.realtouch.factories import Layout
from tests.realtouch.images_of_others import line, write_table
from tests.realtouch.test_damage import damaged_set

Found = tuple[int | None, int | None, str]


def found_in(folder: Path, **options: Any) -> list[Found]:
    return [(each.row, each.touch, each.field) for each in realtouch.verify(folder, **options).findings]


def with_column(folder: Path, name: str, values: pa.Array, source: Path) -> Path:
    """Write the one round of a test split with a column replaced or added."""
    table = pq.read_table(next((source / "data").glob("test-*")))
    if name in table.column_names:
        table = table.set_column(table.column_names.index(name), name, values)
    else:
        table = table.append_column(name, values)
    folder.mkdir(exist_ok=True)
    pq.write_table(table, folder / "train.parquet")
    return folder


def test_it_accepts_what_load_accepts(single_folder, tmp_path, monkeypatch):
    files = sorted((single_folder / "data").glob("train-*"))
    for name in (single_folder, f"{single_folder}/", files, [str(file) for file in files], files[0]):
        assert realtouch.verify(name).ok
    assert realtouch.verify(files).rounds == 3
    monkeypatch.setenv("HOME", str(tmp_path))
    realtouch.select(str(single_folder), str(tmp_path / "chosen"), labels=[0, 1])
    file = next((tmp_path / "chosen" / "data").glob("train-*"))
    pq.write_table(pq.read_table(file).slice(0, 1), file)
    assert "sha256 is" in realtouch.verify("~/chosen").findings[0].problem  # by the manifest, there too
    with pytest.raises(InputError, match="is not a name of a data set"):
        realtouch.verify(3)


def test_before_an_upload_damage_or_errors_of_the_card_are_listed(single_folder, tmp_path):
    realtouch.select(str(single_folder), str(tmp_path), contact=True)
    assert not list_findings(open_folder(str(tmp_path)))
    card, (shard,) = tmp_path / "README.md", (tmp_path / "data").glob("train-*")
    card.write_text(card.read_text().replace("dataset_info", "info"))
    assert [each.file for each in list_findings(open_folder(str(tmp_path)))] == ["README.md"]
    shard.write_bytes(shard.read_bytes()[:-1])
    assert {Path(each.file).name for each in list_findings(open_folder(str(tmp_path)))} == {shard.name}


def test_files_without_any_checksum_are_reported_as_unprotected(single_folder: Path, tmp_path: Path) -> None:
    files = sorted(map(str, (single_folder / "data").glob("*.parquet")))
    assert sorted(realtouch.verify(single_folder, quick=True).unprotected) == files
    assert realtouch.verify(files[:2], quick=True).unprotected == tuple(files[:2])
    realtouch.select(str(single_folder), str(tmp_path / "chosen"), labels=[0, 1])
    assert realtouch.verify(tmp_path / "chosen", quick=True).unprotected == ()
    (tmp_path / "chosen" / "manifest.json").unlink()
    assert realtouch.verify(tmp_path / "chosen", quick=True).unprotected == ()  # by their own pages


def test_pictures_of_another_size(single_rows: list[dict], tmp_path: Path) -> None:
    def smaller(row: dict[str, Any]) -> None:
        row["sensor_image"][3]["bytes"] = factories.encode_jpeg(np.zeros((50, 40, 3), np.uint8))

    folder = damaged_set(tmp_path, single_rows, "single", smaller)
    for quick in (False, True):
        assert found_in(folder, quick=quick) == [(1, 3, "sensor_image")]
    assert "40 x 50 pixels; expected 96 x 72" in realtouch.verify(folder).findings[0].problem


def test_frames_and_clips_of_another_size(seq_rows, truth, tmp_path):
    small = factories.encode_jpeg(np.zeros((50, 40, 3), np.uint8))

    def smaller(row: dict[str, Any]) -> None:
        frames = [factories.encode_jpeg(pixels) for pixels in truth[1].touches[1].pixels]
        frames[7] = small
        row["sensor_video"][1]["bytes"] = write_avi(frames, 96, 72, 25.0)
        row["sensor_video"][4]["bytes"] = write_avi([small] * truth[1].touches[4].frames, 40, 50, 25.0)

    folder = damaged_set(tmp_path, seq_rows, "seq", smaller)
    for quick in (False, True):
        assert found_in(folder, quick=quick) == [(1, 1, "sensor_video"), (1, 4, "sensor_video")]
    first, second = realtouch.verify(folder, quick=True).findings
    assert "frame 7: 40 x 50 pixels; expected 96 x 72 pixels as of the first frame" in first.problem
    assert "expected 96 x 72 pixels as of the other touches" in second.problem


def test_frames_behind_the_stated_length_of_a_clip(seq_rows, truth, tmp_path):
    frames = truth[1].touches[1].frames

    def shorter(row: dict[str, Any]) -> None:
        row["video_length_frames"][1] = frames - 20

    folder = damaged_set(tmp_path, seq_rows, "seq", shorter)
    for quick in (False, True):
        assert found_in(folder, quick=quick) == [(1, 1, "sensor_video")]
    problem = realtouch.verify(folder, quick=True).findings[0].problem
    assert f"a clip of {frames} frames; expected {frames - 20}" in problem
    record = realtouch.load(folder)[1]
    assert len(record.sensor_video[0])
    with pytest.raises(IntegrityError, match=rf"row 1, touch 1, field 'sensor_video': a clip of {frames} fr"):
        record.sensor_video[1]


def test_times_that_run_backwards_in_a_set_without_contact_times(seq_rows, tmp_path):
    def backwards(row: dict[str, Any], index: int) -> None:
        if index == 1:
            row["time_stamp_rel_seq"] = [list(times)[::-1] for times in row["time_stamp_rel_seq"]]

    left_out = ("touch_start_time_rel", "touch_end_time_rel")
    layout = Layout(leave_out=left_out, fixed=False, edit=backwards)
    factories.write_set(tmp_path, {"train": seq_rows}, "seq", layout)
    assert {(row, field) for row, _, field in found_in(tmp_path)} == {(1, "time_stamp_rel_seq")}


def test_a_label_without_a_name(single_folder: Path, tmp_path: Path) -> None:
    folder = with_column(tmp_path, "label", pa.array([77]), single_folder)
    assert found_in(folder) == [(0, None, "label")]
    assert "77; expected less than 10" in realtouch.verify(folder).findings[0].problem
    unnamed = pq.read_table(folder / "train.parquet").replace_schema_metadata(None)
    pq.write_table(unnamed, folder / "train.parquet")  # nothing is said about its classes
    assert found_in(folder) == []


@pytest.mark.parametrize(
    ("name", "values", "field"),
    [
        ("info.object_pose.position", pa.array([[[1.0, 2.0, 3.0], [1.0, 2.0]]]), "info.object_pose"),
        ("info.object_pose.position", pa.array([["a", "b", "c"]]), "info.object_pose"),
        ("info.object_pose.position", pa.array([[[1.0, 2.0, 3.0]] * 2]), "info.object_pose"),
        ("info.object_pose.quaternion", pa.array([[0.0] * 4]), "info.object_pose"),
        ("info.gel_id.sub", pa.array([3]), "info.gel_id.sub"),
    ],
)
def test_metadata_that_cannot_be_returned(name, values, field, single_folder, tmp_path):
    folder = with_column(tmp_path, name, values, single_folder)
    record = realtouch.load(folder)[0]
    with pytest.raises(IntegrityError, match=f"row 0, field '{field}'"):
        _ = record.info
    assert found_in(folder) == [(0, None, field)]


def test_columns_that_are_not_there_are_no_damage(single_rows: list[dict], tmp_path: Path) -> None:
    for name in ("id", "label", "object_id"):
        folder = tmp_path / name
        factories.write_set(folder, {"train": single_rows}, "single", Layout(leave_out=(name,)))
        assert realtouch.verify(folder).ok
        assert realtouch.summarise(realtouch.load(folder)).rounds == 3
        record = realtouch.load(folder)[0]
        for shown in (record, realtouch.load(folder).touches()[0]):
            assert " touch" in repr(shown) or "touch_index=0" in repr(shown)
            assert f"{name}=" not in repr(shown)
            assert "<img" in shown._repr_html_()


def test_files_with_other_class_names(single_folder: Path, tmp_path: Path) -> None:
    for file in (single_folder / "data").glob("train-*"):
        table = pq.read_table(file)
        if "00001" in file.name:
            features = json.loads(table.schema.metadata[b"huggingface"])
            features["info"]["features"]["label"]["names"] = list("9876543210")
            table = table.replace_schema_metadata({b"huggingface": json.dumps(features)})
        pq.write_table(table, tmp_path / file.name)
    for streaming in (False, True):
        with pytest.raises(IntegrityError, match=r"00001.*the classes are named 9, 8, 7.*expected 0, 1, 2"):
            realtouch.load(tmp_path, streaming=streaming)
    assert found_in(tmp_path) == [(None, None, "label")]


def test_text_that_is_no_unicode(single_rows: list[dict], tmp_path: Path) -> None:
    factories.write_set(tmp_path, {"train": single_rows}, "single")
    file = tmp_path / "data" / "train-00000-of-00001.parquet"
    pq.write_table(pq.read_table(file), file, compression="none")
    name = single_rows[1]["id"].encode()
    file.write_bytes(file.read_bytes().replace(name, b"\xff" + name[1:]))
    assert found_in(tmp_path) == [(1, None, "id")]
    dataset = realtouch.load(tmp_path)
    assert [dataset[row].id for row in (0, 2)] == [single_rows[row]["id"] for row in (0, 2)]
    with pytest.raises(IntegrityError, match="row 1, field 'id': a value that cannot be read"):
        _ = dataset[1].id
    assert "id=unreadable" in repr(dataset[1])


def test_finished_shards_of_an_unfinished_set_are_checked(home, tmp_path, capsys):
    splits = [{**line(f"pictures/{number}.jpg"), "split": f"s{number % 2}"} for number in range(4)]
    write_table(home, splits)
    words = ("import", home, "--format", "folder", "--map", "split=split", "--out", tmp_path / "out")
    assert call("realtouch", *words, "--part", "1/2", "-w", 1) == 0
    assert call("tactile", "verify", tmp_path / "out") == 1
    assert "is not finished (1 of 2 shards); next: run the same command again" in capsys.readouterr().err
    (finding,) = realtouch.verify(tmp_path / "out").findings
    assert finding.file == "manifest.json"
    assert realtouch.verify(tmp_path / "out").rounds == 2
    (shard,) = (tmp_path / "out" / "data").glob("*.parquet")
    content = bytearray(shard.read_bytes())
    content[300] ^= 255
    shard.write_bytes(content)
    assert call("tactile", "verify", tmp_path / "out") == 3
    said = capsys.readouterr().err
    assert f"damaged: 'data/{shard.name}': sha256 is" in said
    assert "run the same command with --repair, which makes damaged shards again" in said


def test_a_cut_file_named_alone_is_to_be_fetched_again(single_folder: Path, tmp_path: Path) -> None:
    whole = next((single_folder / "data").glob("train-*")).read_bytes()
    (tmp_path / "cut.parquet").write_bytes(whole[:-100])
    with pytest.raises(IntegrityError, match=r"cut\.parquet' is damaged.*; next: make or fetch it again"):
        realtouch.load(tmp_path / "cut.parquet", "train")
