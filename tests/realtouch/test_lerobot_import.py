"""Import of LeRobotDatasets of others and of this toolkit."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import realtouch
from realtouch.formats.lerobot_import import find_lerobot
from realtouch.importing.import_sources import IMPORTS
from realtouch.importing.source_files import Ledger
from realtouch.importing.source_touches import Recording, SourceTouches, touches_of
from tactile_toolkit import store
from tactile_toolkit.errors import InputError, ToolkitError
from tactile_toolkit.touch import decode_image
from tests.realtouch.factories import FPS
from tests.realtouch.found import per_frame, require_pictures_or_messages
from tests.realtouch.lerobot_sets import CAMERA, TASKS, Truth, write_json, write_lerobot

KINDS = [(version, dtype) for version in ("v2.1", "v3.0") for dtype in ("image", "video")]


def recordings_in(home: Path, **columns: Any) -> list[Recording]:
    return list(
        find_lerobot(store.open_folder(str(home)), realtouch.ImportColumns(**columns), None, Ledger())
    )


def pictures(recording: Recording, cut: str = "whole") -> list[Any]:
    return list(IMPORTS["lerobot"].contents(touches_of(recording, cut)))


@pytest.mark.parametrize(("version", "dtype"), KINDS)
def test_episodes_of_others_are_recordings(version: str, dtype: str, tmp_path: Path) -> None:
    """Every column keeps its name and values; pictures are as stored, or as decoded."""
    truth = write_lerobot(tmp_path, version, dtype)
    recordings = recordings_in(tmp_path)
    assert [recording.frames for recording in recordings] == list(truth.lengths)
    assert [recording.problem for recording in recordings] == [None] * 3
    for number, recording in enumerate(recordings):
        columns = truth.columns[number]
        assert recording.name == f"episode_{number:06d}"
        split = "test" if number == 2 else "train"
        assert recording.values == {"task": TASKS[number % 2], "split": split, "operator": f"o{number}"}
        assert recording.time_s is not None
        np.testing.assert_array_equal(recording.time_s, columns["frame_index"] / FPS)
        known = {"timestamp", "frame_index", "episode_index", "index", "task_index"}
        assert recording.per_frame.keys() == columns.keys() - known
        for name in recording.per_frame:
            np.testing.assert_array_equal(per_frame(recording, name), columns[name], err_msg=name)
        if dtype == "image":
            assert pictures(recording) == truth.jpegs[number]
            assert pictures(recording, "frames") == truth.jpegs[number]
            continue
        assert pictures(recording) == pictures(recording, "frames")
        shown = np.stack(list(map(decode_image, pictures(recording)))).astype(int)
        assert shown.shape == truth.pixels[number].shape
        assert np.abs(shown - truth.pixels[number]).mean() < 4  # a bar elsewhere makes 15 and more
    items = SourceTouches.joined([touches_of(recording, "frames") for recording in recordings])
    backwards = list(IMPORTS["lerobot"].contents(items[::-1]))
    assert backwards == [picture for recording in recordings for picture in pictures(recording)][::-1]
    assert {bool(recording.conversions[1]) for recording in recordings} == {dtype == "video"}


@pytest.mark.parametrize(("version", "dtype"), KINDS)
def test_one_of_several_cameras_is_chosen_and_the_others_are_named(version, dtype, tmp_path):
    write_lerobot(tmp_path, version, dtype, Truth((3, 2), (CAMERA, "observation.images.wrist")))
    with pytest.raises(
        InputError, match=rf"cameras {CAMERA}, observation.images.wrist; expected one; next: "
    ):
        recordings_in(tmp_path)
    with pytest.raises(InputError, match=r"expected 'tactil'"):
        recordings_in(tmp_path, image="tactil")
    recordings = recordings_in(tmp_path, image="observation.images.wrist")
    assert [len(pictures(recording)) for recording in recordings] == [3, 2]
    assert [recording.left_out for recording in recordings] == [(CAMERA,)] * 2
    info = json.loads((tmp_path / "meta" / "info.json").read_text())
    info["features"]["observation.images.wrist"]["info"] = {"is_depth_map": True, "depth_unit": "m"}
    write_json(tmp_path / "meta" / "info.json", info)
    assert len(recordings_in(tmp_path)) == 2  # one camera is left, beside the depth
    for name in (CAMERA, "observation.images.wrist"):
        info["features"][name]["dtype"] = "float32"
    write_json(tmp_path / "meta" / "info.json", info)
    with pytest.raises(InputError, match=r"no cameras, but .*, timestamp"):
        recordings_in(tmp_path)


def test_several_tasks_in_an_episode_are_those_of_its_frames(tmp_path: Path) -> None:
    truth = Truth()
    truth.columns[0]["task_index"][3:] = 1
    write_lerobot(tmp_path, truth=truth)
    first, second, _ = recordings_in(tmp_path)
    assert first.per_frame["task"].to_pylist() == [*[TASKS[0]] * 3, *[TASKS[1]] * 2]
    assert (first.values.get("task"), second.values["task"]) == (None, TASKS[1])


def test_missing_values_stay_missing_and_times_are_as_stated(tmp_path: Path) -> None:
    truth = Truth((4,))
    truth.columns[0]["timestamp"] = np.array([0, 0.01, 0.5, 0.75], np.float32)
    write_lerobot(tmp_path, truth=truth)
    (path,) = (tmp_path / "data").rglob("*.parquet")
    rows = pq.read_table(path)
    for name, values in (
        ("count", pa.array([1, None, 3, 4])),
        ("text", pa.array(["a", None, "c", "d"])),
        ("vector", pa.array([[1.0, 2.0], None, [3.0, None], [5.0, 6.0]])),
        ("marker", pa.array([[[1, 2], [3, 4]]] * 4)),
    ):
        rows = rows.append_column(name, values)
    pq.write_table(rows, path)
    (only,) = recordings_in(tmp_path)
    assert only.time_s is not None
    np.testing.assert_array_equal(only.time_s, truth.columns[0]["timestamp"].astype(np.float64))
    np.testing.assert_array_equal(per_frame(only, "count"), [1, np.nan, 3, 4])
    assert per_frame(only, "text").tolist() == ["a", None, "c", "d"]
    np.testing.assert_array_equal(per_frame(only, "vector"), [[1, 2], [np.nan] * 2, [3, np.nan], [5, 6]])
    assert per_frame(only, "marker").tolist() == [[1, 2, 3, 4]] * 4


def drop_rows(home: Path) -> None:
    path = next(iter(sorted((home / "data").rglob("*.parquet"))))
    pq.write_table(pq.read_table(path).slice(1), path)


def cut_file(pattern: str) -> Callable[[Path], None]:
    def cut(home: Path) -> None:
        path = next(iter(sorted(home.rglob(pattern))))
        path.write_bytes(path.read_bytes()[:-50])

    return cut


def remove(pattern: str) -> Callable[[Path], None]:
    return lambda home: next(iter(sorted(home.rglob(pattern)))).unlink()


def state(**values: Any) -> Callable[[Path], None]:
    def change(home: Path) -> None:
        path = home / "meta" / "info.json"
        write_json(path, {**json.loads(path.read_text()), **values})

    return change


def change_column(name: str, values: Callable[[pa.Table], pa.Array]) -> Callable[[Path], None]:
    def change(home: Path) -> None:
        path = next(iter(sorted((home / "data").rglob("*.parquet"))))
        rows = pq.read_table(path)
        pq.write_table(rows.set_column(rows.schema.get_field_index(name), name, values(rows)), path)

    return change


@pytest.mark.parametrize(
    ("dtype", "spoil", "words"),
    [
        ("image", drop_rows, r"holds 4 frames of this episode; expected 5, as stated"),
        ("image", cut_file("episode_000000.parquet"), "is damaged"),
        ("image", remove("episode_000000.parquet"), "the file does not exist"),
        (
            "image",
            change_column("timestamp", lambda rows: pa.array([0.0, None, 1, 2, 3])),
            "seconds as floats",
        ),
        ("image", change_column("timestamp", lambda rows: pa.array(["0"] * 5)), "'timestamp' is string"),
        ("image", change_column("episode_index", lambda rows: pa.array([0.0] * 5)), "of rising integers"),
        ("image", change_column(CAMERA, lambda rows: pa.array([1] * 5)), "no column of pictures"),
        (
            "image",
            change_column("note", lambda rows: pa.array([[1], [1, 2], [], [], []])),
            "expected one length",
        ),
        ("video", cut_file("episode_000000.mp4"), ""),
        ("video", remove("episode_000000.mp4"), "the file does not exist"),
        ("video", state(fps=50), ""),
        (
            "video",
            change_column("timestamp", lambda rows: pa.array(np.arange(5) / 10)),
            "not at the times of the frames",
        ),
    ],
)
def test_an_unusable_episode_is_one_item_with_the_reason(dtype, spoil, words, tmp_path):
    write_lerobot(tmp_path, "v2.1", dtype)
    spoil(tmp_path)
    recordings = recordings_in(tmp_path)
    assert [recording.frames for recording in recordings] == [1 if words else 5, 7, 4]
    problems = [recording.problem for recording in recordings]
    assert problems[1:] == [None, None]
    items = touches_of(recordings[0], "frames")
    assert len(items) == recordings[0].frames
    if words:
        assert re.search(words, str(problems[0]))
    else:  # all its frames can still be read
        assert problems[0] is None
        assert all(isinstance(image, bytes) for image in IMPORTS["lerobot"].contents(items))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"data_path": "../{episode_index}.parquet"}, "not the plain relative path"),
        ({"data_path": "/etc/passwd"}, "not the plain relative path"),
        ({"data_path": "link/x.parquet"}, "a link leads out of the folder"),
        ({"data_path": "{episode_index.__class__}"}, "the file does not exist"),
        ({"data_path": "{episode_index:0999999999d}"}, "the file does not exist"),
        ({"video_path": "../../{episode_index}.mp4"}, "not the plain relative path"),
        ({"video_path": None}, "not the plain relative path"),
    ],
)
@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_paths_in_metadata_stay_inside(version, values, words, tmp_path):
    home = tmp_path / "home"
    write_lerobot(home, version, "video")
    (home / "link").symlink_to(tmp_path)
    state(**values)(home)
    assert {words in str(recording.problem) for recording in recordings_in(home)} == {True}


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("info.json", b"{", r"info\.json' holds no metadata of a LeRobotDataset"),
        ("info.json", b"[]", "Expected `object`"),
        ("info.json", b"[" * 100_000, r"info\.json' holds no metadata"),
        ("info.json", b"\xff", r"info\.json' holds no metadata"),
        ("episodes.jsonl", b'{"episode_index": -1, "length": 3}', "Expected `int` >= 0"),
        ("episodes.jsonl", b'{"episode_index": 1e999, "length": 3}', r"episodes\.jsonl' holds no metadata"),
        ("episodes.jsonl", b'{"episode_index": 3}', "Expected `int`"),
        (
            "episodes.jsonl",
            b'{"episode_index": 3, "length": 2}\n' * 2,
            "episode 3 after 3; expected numbers that",
        ),
        ("tasks.jsonl", b'{"task_index": 1}', "expected a number and a text"),
        ("tasks.jsonl", b"1", "Expected `object`"),
        (
            "info.json",
            {"codebase_version": "v1.6"},
            r"states version 'v1\.6'; expected v2\.0, v2\.1 or v3\.0",
        ),
        ("info.json", {"fps": 0}, r"Expected `float` > 0"),
        ("info.json", {"chunks_size": 0}, r"Expected `int`"),
        ("info.json", {"features": {"a": {}}}, r"missing required field `dtype`"),
        ("info.json", {"data_path": None}, r"Expected `str`"),
    ],
)
def test_invalid_metadata_are_named(name: str, content: Any, words: str, tmp_path: Path) -> None:
    write_lerobot(tmp_path, "v2.1")
    if isinstance(content, bytes):
        (tmp_path / "meta" / name).write_bytes(content)
    else:
        state(**content)(tmp_path)
    with pytest.raises(InputError, match=words):
        recordings_in(tmp_path)


def test_invalid_metadata_of_version_3_are_named(tmp_path: Path) -> None:
    write_lerobot(tmp_path)
    path = tmp_path / "meta" / "episodes" / "chunk-000" / "file-001.parquet"
    lines = pq.read_table(path)
    pq.write_table(lines.set_column(0, "episode_index", pa.array([1])), path)
    with pytest.raises(InputError, match=r"file-001\.parquet' holds episode 1 after 1"):
        recordings_in(tmp_path)
    pq.write_table(pa.table({"length": [3]}), path)
    with pytest.raises(InputError, match=r"file-001\.parquet' holds no metadata"):
        recordings_in(tmp_path)
    path.write_bytes(b"PAR1")
    with pytest.raises(ToolkitError, match=r"file-001\.parquet' is damaged"):
        recordings_in(tmp_path)


def test_pictures_that_are_not_there_are_named(tmp_path: Path) -> None:
    write_lerobot(tmp_path, "v2.1")
    change_column(
        CAMERA,
        lambda rows: pa.array(
            [None, {"bytes": None}, {"bytes": b""}, *rows[CAMERA].to_pylist()[3:]], rows[CAMERA].type
        ),
    )(tmp_path)
    first, *_ = recordings_in(tmp_path)
    images = pictures(first)
    assert [str(image) for image in images[:3]] == [
        f"row {row} of '{CAMERA}' holds no bytes; expected a picture" for row in range(3)
    ]
    assert all(isinstance(image, bytes) for image in images[3:])
    remove("episode_000001.parquet")(tmp_path)
    recordings = recordings_in(tmp_path)
    assert "the file does not exist" in str(recordings[1].problem)
    assert [len(pictures(recordings[number])) for number in (0, 2)] == [5, 4]


@pytest.mark.thorough
@pytest.mark.parametrize(("version", "dtype"), KINDS)
def test_any_damage_gives_a_result_or_a_message(version: str, dtype: str, tmp_path: Path) -> None:
    write_lerobot(tmp_path, version, dtype, Truth((3, 2)))
    require_pictures_or_messages(tmp_path, "lerobot", CAMERA)
