"""Streams of other rates, aligned to the pictures of recordings: known values, gaps, clocks and tables."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation, Slerp

import realtouch
from realtouch import ImportColumns
from realtouch.importing.cuts import Cutter
from realtouch.importing.import_options import STREAM_HEADER, Alignment
from realtouch.importing.source_touches import Recording, Stream
from realtouch.importing.streams import Aligner, open_stream, tables_by_stem, with_streams
from realtouch.video.avi import write_avi
from tactile_toolkit import store
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.touch import encode_image
from tests.mutations import mutated, with_other_numbers
from tests.realtouch.found import columns as columns_of, cut_by, per_frame
from tests.realtouch.made_recordings import SIZE, MadeRecording

NO_COLUMNS = ImportColumns()


def recording(time_s: np.ndarray | None, frames: int = 0, **more: Any) -> Recording:
    frames = frames or len(time_s if time_s is not None else ())
    more["per_frame"] = columns_of(more.pop("per_frame", {}))
    return Recording("take1", "/home", "take1.mp4", "", 0, frames, 1000, time_s=time_s, **more)


def said(found: Recording) -> dict[str, np.ndarray]:
    return {name: per_frame(found, name) for name in found.per_frame}


def jittered(count: int, rate: float, seed: int = 0) -> np.ndarray:
    random = np.random.default_rng(seed)
    return (np.arange(count) + random.uniform(-0.3, 0.3, count)) / rate


def stream(folder: Path, columns: dict[str, Any], name: str = "take1.force.csv", **options: Any) -> Stream:
    table = pa.table(columns)
    if name.endswith(".parquet"):
        pq.write_table(table, folder / name)
    elif name.endswith(".jsonl"):
        (folder / name).write_text("".join(f"{json.dumps(row)}\n" for row in table.to_pylist()))
    else:
        rows = [
            ",".join("" if each is None else str(each) for each in row.values()) for row in table.to_pylist()
        ]
        (folder / name).write_text("\n".join([",".join(columns), *rows]) + "\n")
    return open_stream(store.open_folder(str(folder)), name, ImportColumns(**options), "take1")


@pytest.mark.parametrize("ending", ["csv", "parquet", "jsonl"])
@pytest.mark.parametrize("method", ["nearest", "linear"])
def test_forces_and_poses_get_the_times_of_the_pictures(ending: str, method: str, tmp_path: Path) -> None:
    """A camera at 60 Hz with jitter, a force at 1 kHz and poses at 30 Hz, all known functions of time."""
    camera_s = 0.5 + jittered(240, 60)
    force_s, pose_s = np.arange(6000) / 1000, jittered(180, 30, 1)
    force = {"time_s": force_s, "fz": np.sin(3 * force_s), "count": np.arange(6000), "ok": force_s > 2}
    angles = np.column_stack([0.4 * pose_s, np.sin(pose_s), 0.2 * pose_s])
    turns = Rotation.from_rotvec(angles)
    pose = {"time_ms": pose_s * 1000, "x": 2 * pose_s, "y": -pose_s, "z": 1 + pose_s}
    pose |= dict(zip(("qx", "qy", "qz", "qw"), turns.as_quat().T, strict=True))
    columns = ImportColumns(pose=("x", "y", "z", "qx", "qy", "qz", "qw"))
    streams = [
        stream(tmp_path, force, f"take1.force.{ending}"),
        stream(tmp_path, pose, f"take1_pose.{ending}"),
    ]
    given = recording(camera_s, per_frame={"exposure": np.arange(240)})
    found, reports = with_streams(given, streams, Alignment(method=method), columns)

    assert list(found.per_frame) == ["exposure", "fz", "count", "ok", *columns.pose]
    nearest = np.abs(camera_s[:, None] - force_s).argmin(axis=1)
    np.testing.assert_array_equal(said(found)["count"], nearest)
    np.testing.assert_array_equal(said(found)["ok"], nearest > 2000)
    of_pose = np.abs(camera_s[:, None] - pose_s).argmin(axis=1)
    quaternion = np.column_stack([said(found)[name] for name in columns.pose[3:]])
    if method == "nearest":
        np.testing.assert_allclose(said(found)["fz"], force["fz"][nearest], rtol=0, atol=1e-12)
        np.testing.assert_allclose(said(found)["x"], pose["x"][of_pose], rtol=0, atol=1e-12)
        np.testing.assert_allclose(quaternion, turns.as_quat()[of_pose], rtol=0, atol=1e-12)
    else:
        np.testing.assert_allclose(said(found)["fz"], np.sin(3 * camera_s), rtol=0, atol=2e-6)
        np.testing.assert_allclose(said(found)["z"], 1 + camera_s, rtol=0, atol=1e-9)
        rest = Rotation.from_quat(quaternion) * Slerp(pose_s, turns)(camera_s).inv()
        assert rest.magnitude().max() < 1e-9
    first, second = (dict(zip(STREAM_HEADER, each, strict=True)) for each in reports)
    assert reports[0][:6] == ("take1", "force", "6,000", "0", "0", "1000")
    assert first["columns"] == "fz, count, ok"
    assert float(first["starts later by [s]"]) == pytest.approx(-camera_s[0], rel=1e-3)
    assert float(first["ends later by [s]"]) == pytest.approx(5.999 - camera_s[-1], rel=1e-3)
    assert second["stream"] == "pose"
    assert float(second["rate [Hz]"]) == pytest.approx(30, rel=0.1)
    assert float(second["largest gap [s]"]) == pytest.approx(np.diff(pose_s).max(), rel=1e-3)


def test_pictures_in_gaps_have_missing_values(tmp_path: Path) -> None:
    time_s = np.arange(21) / 10
    known = [0.5, 0.6, 0.7, 1.2, 1.3]
    columns = {"time_s": known, "f": [1.0, 2, 3, None, 5], "n": [1, 2, 3, 4, None], "word": [*"abcde"]}
    given = stream(tmp_path, columns)
    missing = ~np.isin(np.round(time_s, 6), [0.4, *known, 1.4])
    for method in ("nearest", "linear"):
        found, (report,) = with_streams(recording(time_s), [given], Alignment(method=method), NO_COLUMNS)
        values = said(found)
        np.testing.assert_array_equal(np.isnan(values["f"]), missing | np.isin(time_s, [1.2]))
        assert values["n"][~np.isnan(values["n"])].tolist() == [1, 1, 2, 3, 4]
        assert [each for each in values["word"] if each is not None] == ["a", *"abcde", "e"]
        assert report[4] == str(missing.sum())
    found, _ = with_streams(recording(time_s), [given], Alignment(max_gap_ms=500.0), NO_COLUMNS)
    assert said(found)["word"].tolist() == [*"aaaaaabcccdddeeeeee", None, None]


@pytest.mark.parametrize("names", [("pose",), ("at", "turn")])
def test_vectors_dates_and_text(names: tuple[str, ...], tmp_path: Path) -> None:
    stamps = [f"2026-01-31T12:00:0{number}.5Z" for number in range(4)]
    start = 1769860800.0
    poses = np.array([[0.0, number, 0, 0, 0, 0, 1] for number in range(4)])
    parts = np.split(poses, [7] if len(names) == 1 else [3], axis=1)
    columns = {name: part.tolist() for name, part in zip(names, parts, strict=False)}
    given = stream(tmp_path, {"timestamp": stamps, **columns}, "take1.jsonl")
    found, _ = with_streams(
        recording(start + np.array([0.5, 2.0, 3.5])),
        [given],
        Alignment(method="linear", max_gap_ms=2000.0),
        ImportColumns(pose=names),
    )
    aligned = np.hstack([said(found)[name] for name in names])
    np.testing.assert_allclose(aligned[:, 1], [0, 1.5, 3], rtol=0, atol=1e-6)
    np.testing.assert_array_equal(aligned[:, 3:], [[0, 0, 0, 1]] * 3)


def test_poses_of_other_forms_are_those_of_the_nearest_sample(tmp_path: Path) -> None:
    """Euler angles jump, and the mean of two matrices is not a rotation."""
    for width in (6, 16):
        columns = {"time_s": [0.0, 0.1], "pose": [[0.0] * width, [1.0] * width], "f": [0.0, 1.0]}
        given = stream(tmp_path, columns, "take1.jsonl")
        pictures, how = recording(np.array([0.03, 0.08])), Alignment(method="linear")
        found, _ = with_streams(pictures, [given], how, ImportColumns(pose=("pose",)))
        np.testing.assert_allclose(said(found)["f"], [0.3, 0.8])
        np.testing.assert_array_equal(said(found)["pose"], [[0.0] * width, [1.0] * width])


@pytest.mark.parametrize(
    ("name", "samples", "expected"),
    [
        ("yaw_deg", [350.0, 10.0, 20.0], [350, 355, 0, 5, 10, 15]),
        ("yaw_deg", [170.0, -170.0, -160.0], [170, 175, -180, -175, -170, -165]),
        ("turned_deg", [710.0, 730.0, 750.0], [710, 715, 720, 725, 730, 740]),  # which counts turns
        ("yaw_rad", [6.2, 0.1], [6.2, None, None, None, 0.1]),
        ("level", [350.0, 10.0], [350, 265, 180, 95, 10]),
        ("hand.orientation", [[0, 0, 0, 1.0], [0, 0, 0, -1.0]], [[0, 0, 0, 1.0]] * 4),  # one rotation
        ("wrist_deg", [[350.0, 0.0], [10.0, 20.0]], [[350, 0], [355, 5], [0, 10], [5, 15], [10, 20]]),
    ],
)
def test_angles_are_between_samples_on_the_circle(name, samples, expected, tmp_path):
    given = stream(tmp_path, {"time_s": [0.0, 0.4, 0.8][: len(samples)], name: samples}, "take1.jsonl")
    times = np.array([0, 0.1, 0.2, 0.3, 0.4, 0.6][: len(expected)])
    how = Alignment(method="linear", max_gap_ms=500.0)
    found, _ = with_streams(recording(times), [given], how, NO_COLUMNS)
    for value, wanted in zip(said(found)[name], expected, strict=True):
        if wanted is None:  # in steps of a quarter of the way: 0.183 rad
            assert value >= 6.2 or value < 0.1
        else:
            np.testing.assert_allclose(value, wanted, atol=1e-9)


def test_a_row_for_each_picture_needs_no_times(tmp_path: Path) -> None:
    given = stream(tmp_path, {"force": [1.0, 2, 3]}, "take1.csv")
    found, (report,) = with_streams(recording(np.arange(3.0)), [given], Alignment(), NO_COLUMNS)
    np.testing.assert_array_equal(said(found)["force"], [1, 2, 3])
    assert report[1:6] == ("take1", "3", "0", "0", "")
    timed = stream(tmp_path, {"time_ms": [0, 40, 40], "force": [1.0, 2, 3]}, "take1.csv")
    found, _ = with_streams(recording(None, 3), [timed], Alignment(time_offset_s=1.0), NO_COLUMNS)
    np.testing.assert_array_equal(found.time_s, [1, 1.04, 1.04])
    assert list(found.per_frame) == ["force"]
    unnamed = stream(tmp_path, {"stamp": [0, 40, 80], "force": [1.0, 2, 3]}, "take1.csv", time_unit="ms")
    found, _ = with_streams(recording(np.arange(3) / 25), [unnamed], Alignment(), NO_COLUMNS)
    assert said(found)["force"].tolist() == [1, 2, 3]
    asked = stream(tmp_path, {"time_ms": [5, 6, 7]}, "take1.csv", time="")
    found, _ = with_streams(recording(np.arange(3.0)), [asked], Alignment(), NO_COLUMNS)
    np.testing.assert_array_equal(said(found)["time_ms"], [5, 6, 7])


def test_duplicates_keep_the_first_and_are_counted(tmp_path: Path) -> None:
    given = stream(tmp_path, {"t_s": [0.0, 0.1, 0.1, 0.1, 0.2], "f": [0, 1, 2, 3, 4]})
    found, (report,) = with_streams(recording(np.array([0, 0.1, 0.2])), [given], Alignment(), NO_COLUMNS)
    assert said(found)["f"].tolist() == [0, 1, 4]
    assert report[2:4] == ("5", "2")


def test_names_that_are_taken_get_that_of_their_stream(tmp_path: Path) -> None:
    given = [
        stream(tmp_path, {"time_s": [0.0], "seq": [number], "f": [1.0]}, f"take1.{name}.csv")
        for number, name in enumerate(("force", "pose", "pose.pose"))
    ]
    found, reports = with_streams(recording(np.zeros(1), values={"f": 0}), given, Alignment(), NO_COLUMNS)
    assert list(found.per_frame) == ["seq", "force.f", "pose.seq", "pose.f", "pose.pose.seq", "pose.pose.f"]
    assert reports[0][-1] == "seq, force.f"


def test_an_offset_of_the_clocks_is_added(tmp_path: Path) -> None:
    given = stream(tmp_path, {"time_s": 1.7e9 + np.arange(100) / 100, "n": np.arange(100)})
    camera_s = np.arange(10) / 10
    with pytest.raises(
        InputError, match=r"from 1700000000\.000 to 1700000000\.990 s.*from 0\.000 to 0\.900 s"
    ):
        with_streams(recording(camera_s), [given], Alignment(), NO_COLUMNS)
    found, _ = with_streams(recording(camera_s), [given], Alignment(time_offset_s=-1.7e9), NO_COLUMNS)
    assert said(found)["n"].tolist() == list(range(0, 100, 10))


@pytest.mark.parametrize(
    ("columns", "options", "words"),
    [
        (
            {"time_s": [0.0, 0.2, 0.1], "f": [1, 2, 3]},
            {},
            r"from 0\.200000 s in row 2 to 0\.100000 s in row 3",
        ),
        ({"time_s": [0.0, None], "f": [1, 2]}, {}, r"\[None\] from number 2 on; expected finite"),
        ({"time": [0, 1], "f": [1, 2]}, {}, "integers, whose unit is not known"),
        ({"time": [0.0], "timestamp": [0.0]}, {}, "several columns of times: time, timestamp"),
        ({"time_s": ["0.5", "b"], "f": [1, 2]}, {}, "'b'.*expected finite"),
        ({"time_s": ["inf"], "f": [1]}, {}, "inf.* from number 1 on; expected finite"),
        ({"time_s": pa.array([], pa.float64())}, {}, "has no rows"),
    ],
)
def test_invalid_times_are_refused(columns, options, words, tmp_path):
    with pytest.raises(InputError, match=words):
        stream(tmp_path, columns, **options)


@pytest.mark.parametrize(
    ("columns", "frames", "has_times", "words"),
    [
        (
            {"f": [1, 2]},
            3,
            True,
            "has 2 rows, the recording 'take1' 3 pictures; expected equal numbers, as the table",
        ),
        ({"time_s": [0.0, 0.1]}, 3, False, "as the recording has no times"),
        ({"time_s": [0.5, 1.5], "f": [1, 2]}, 3, True, "no picture of 'take1' gets a value"),
        ({"time_s": [0.0, 1.0], "f": [[1], [1, 2]]}, 3, True, "lists of 1, 2 values"),
        ({"time_s": [0.0, 1.0], "f": [{"a": 1}] * 2}, 3, True, "column 'f' holds values of no type"),
    ],
)
def test_streams_that_do_not_fit_are_refused(columns, frames, has_times, words, tmp_path):
    given = stream(tmp_path, columns, "take1.force.parquet")
    time_s = np.arange(float(frames)) if has_times else None
    with pytest.raises(InputError, match=words):
        with_streams(recording(time_s, frames), [given], Alignment(), NO_COLUMNS)


def test_tables_beside_a_recording() -> None:
    names = ["take1.mp4", "take1_2.mp4", "take1.csv", "take1.force.CSV", "take1_pose.parquet", "take1_2.csv"]
    names += ["take1_2.force.jsonl", "take10.csv", "index.csv", "take1.txt", ".take1.csv", "take1"]
    assert tables_by_stem(names) == {
        "take1": ["take1.csv", "take1.force.CSV", "take1_pose.parquet"],
        "take1_2": ["take1_2.csv", "take1_2.force.jsonl"],
    }
    assert tables_by_stem(["file-000.parquet", "file-001.parquet"]) == {}


def test_alignment_states_its_limits() -> None:
    for wrong in ({"method": "cubic"}, {"max_gap_ms": 0.0}, {"time_offset_s": float("nan")}):
        with pytest.raises(InputError, match="of the alignment is"):
            Alignment(**wrong)


@cache
def video(count: int, contacts: tuple[tuple[int, int], ...]) -> bytes:
    """Return an AVI of a recording at 25 pictures a second."""
    made = MadeRecording(count, contacts, noise=1.0)
    return write_avi([made.encoded(frame) for frame in range(count)], SIZE[1], SIZE[0], 25.0)


@pytest.fixture
def takes(tmp_path: Path) -> Path:
    """Two videos of 100 pictures, each with two touches, and streams beside them."""
    home = tmp_path / "takes"
    home.mkdir()
    for number in (1, 2):
        (home / f"take{number}.avi").write_bytes(video(100, ((15, 25), (60, 80))))
        force_s = np.arange(4000) / 1000
        stream(home, {"time_s": force_s, "fz": 10 * number + force_s}, f"take{number}.force.csv")
        stream(home, {"seq": np.arange(100) + 1000 * number}, f"take{number}.jsonl")
    return home


def test_a_camera_that_delivers_another_rate_than_its_file_states(tmp_path: Path) -> None:
    """36 pictures in two seconds, 18 a second; the header says 25."""
    home = tmp_path / "takes"
    home.mkdir()
    (home / "take1.avi").write_bytes(video(36, ((15, 25),)))
    gauge_s = np.arange(200) / 100
    stream(home, {"time_s": gauge_s, "gauge_s": gauge_s}, "take1.arm.csv")
    with pytest.raises(InputError, match=r"lasts 1\.99 s, the 36 pictures of 'take1' 1\.40 s at the 25 p"):
        realtouch.import_touches(home, tmp_path / "refused")
    assert not (tmp_path / "refused").exists()
    (home / "take1.arm.csv").rename(tmp_path / "arm.csv")
    named = realtouch.ImportSpec(streams=(str(tmp_path / "arm.csv"),))
    with pytest.raises(InputError, match=r"arm\.csv' lasts 1\.99 s, .*--duration-tolerance 0\.43"):
        realtouch.import_touches(home, tmp_path / "refused", named)
    part = replace(named, alignment=Alignment(time_offset_s=-0.3))  # the video is a part of the stream
    realtouch.import_touches(home, tmp_path / "part", part)
    (tmp_path / "arm.csv").rename(home / "take1.arm.csv")
    # The second remedy is for cameras that deliver the rate of the file.
    tolerant = realtouch.ImportSpec(alignment=Alignment(duration_tolerance=0.43))
    realtouch.import_touches(home, tmp_path / "tolerant", tolerant)
    (touch,) = realtouch.load(tmp_path / "tolerant").touches()
    assert touch.clip.timestamps_s[-1] == pytest.approx(1.4)
    # The first remedy: a table with a row for each picture; other streams follow its clock.
    stream(home, {"time_s": np.arange(36) / 18, "row": np.arange(36)}, "take1.csv")
    realtouch.import_touches(home, tmp_path / "out")
    (touch,) = realtouch.load(tmp_path / "out").touches()
    assert touch.extra["row"].tolist() == list(range(36))
    np.testing.assert_allclose(touch.clip.timestamps_s, np.arange(36) / 18, atol=1e-6)
    np.testing.assert_allclose(touch.extra["gauge_s"], np.arange(36) / 18, atol=0.0051)
    assert touch.clip.fps == pytest.approx(18, rel=1e-3)


@pytest.mark.parametrize("cut", ["whole", "contact", "frames", "table"])
def test_streams_become_extra_columns_of_touches(cut: str, takes: Path, tmp_path: Path) -> None:
    if cut == "table":
        cut = str(takes / "take1_cuts.csv")  # beside a video, but not a stream of it
        lines = [f"take{number},{start},{start + 0.8},mug" for number in (1, 2) for start in (0.4, 2.2)]
        Path(cut).write_text("\n".join(["recording,start_s,end_s,label", *lines]) + "\n")
    stream(tmp_path, {"time_s": np.arange(41) / 10, "warmth": np.arange(41) / 10}, "room.csv")
    how = Alignment(method="linear")
    manifest = realtouch.import_touches(
        takes,
        tmp_path / "out",
        realtouch.ImportSpec(streams=[str(tmp_path / "room.csv")], alignment=how, cut=cut),
    )
    rounds = realtouch.load(tmp_path / "out", "train")
    assert not any(record.skipped for record in manifest.shards)
    assert manifest.spec["options"]["cut"] == ("table" if cut.endswith(".csv") else cut)
    touches = rounds.touches()
    assert len(touches) == {"whole": 2, "contact": 4, "frames": 200}.get(cut, 4)
    for index, touch in enumerate(touches):
        number = 1 + index * 2 // len(touches)
        seq = np.atleast_1d(touch.extra["seq"]) - 1000 * number
        np.testing.assert_allclose(
            np.atleast_1d(touch.extra["fz"]), 10 * number + seq / 25, rtol=0, atol=1e-9
        )
        np.testing.assert_allclose(np.atleast_1d(touch.extra["warmth"]), seq / 25, rtol=0, atol=1e-9)
        assert (np.diff(seq) == 1).all()
        if cut == "whole":
            assert len(seq) == len(touch.clip) == 100
    assert sorted(each.name for each in (tmp_path / "out").glob("cuts/*")) == (
        ["take1.png", "take2.png"] if cut == "contact" else []
    )


def test_a_table_beside_a_video_that_does_not_fit_is_its_problem(takes: Path, tmp_path: Path) -> None:
    (takes / "take2_note.csv").write_text("note\nfine\n")
    manifest = realtouch.import_touches(takes, tmp_path / "out")
    (skipped,) = [each for record in manifest.shards for each in record.skipped]
    assert "take2_note.csv' has 1 rows, the recording 'take2' 100 pictures" in skipped.message
    assert "give it another name" in skipped.message
    late = stream(tmp_path, {"time_s": [100.0, 101.0]}, "late.csv").address
    with pytest.raises(InputError, match="expected a common time"):
        realtouch.import_touches(takes, tmp_path / "two", realtouch.ImportSpec(streams=[late]))


@pytest.mark.thorough
@pytest.mark.parametrize("ending", ["csv", "jsonl", "parquet"])
def test_damaged_tables_end_in_sentences(ending: str, tmp_path: Path) -> None:
    """600 damaged copies of a table, as a stream and as a table of touches."""
    steps = np.arange(40) / 10
    columns = {"time_s": steps, "n": range(40), "note": [f"{n} N" for n in range(40)]}
    columns |= {"start_s": steps, "end_s": steps + 0.2}
    stream(tmp_path, columns, f"whole.{ending}")
    whole = (tmp_path / f"whole.{ending}").read_bytes()
    home, path = store.open_folder(str(tmp_path)), tmp_path / f"table.{ending}"
    pictures = recording(np.arange(100) / 25)
    used = refused = 0
    for seed in range(600):
        change = with_other_numbers if seed % 2 and ending != "parquet" else mutated
        path.write_bytes(change(whole, seed))
        how = Alignment(method=("nearest", "linear")[seed % 2])
        try:
            with_streams(pictures, [open_stream(home, path.name, NO_COLUMNS)], how, NO_COLUMNS)
            cut_by(Cutter(str(path), lambda _: iter(())), [pictures])
            used += 1
        except InputError:
            refused += 1
    assert min(used, refused) >= 6


@pytest.mark.parametrize("cut", ["whole", "frames"])
def test_a_named_column_of_times_is_that_of_the_streams_that_have_it(cut, takes, tmp_path):
    """Videos have their own times, and so have streams without that column."""
    columns = {"clock": np.arange(4001.0), "other": np.arange(4001) + 0.5}
    for number in (1, 2):
        stream(takes, columns, f"take{number}_other.parquet", time="")
    how = ImportColumns(time="clock", time_unit="ms")
    realtouch.import_touches(takes, tmp_path / "out", realtouch.ImportSpec(columns=how, cut=cut))
    touches = realtouch.load(tmp_path / "out", "train").touches()
    other = np.concatenate([np.atleast_1d(touch.extra["other"]) for touch in touches])
    np.testing.assert_array_equal(other, np.tile(np.arange(100) * 40 + 0.5, 2))
    if cut == "frames":
        np.testing.assert_allclose(
            [touch.extra["time_s"] for touch in touches], np.tile(np.arange(100) / 25, 2)
        )


def test_a_column_of_times_that_does_not_exist_is_refused(takes: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no column 'nope'"):
        realtouch.import_touches(
            takes, tmp_path / "out", realtouch.ImportSpec(columns=ImportColumns(time="nope"))
        )


def test_recordings_have_the_times_that_a_column_states(tmp_path: Path) -> None:
    aligner = Aligner([], None, ImportColumns(time="clock_ms"))
    clock = columns_of({"clock_ms": np.array([0, 40, 80, 120]), "f": np.arange(4.0)})
    given = replace(recording(None, 4), home=str(tmp_path), per_frame=clock)
    found = aligner.aligned(given)
    np.testing.assert_array_equal(found.time_s, [0, 0.04, 0.08, 0.12])
    frames = cut_by(Cutter("frames", lambda _: iter(())), [found])
    assert [each.values["time_s"] for each in frames] == [0, 0.04, 0.08, 0.12]
    broken = replace(given, per_frame=columns_of({"clock_ms": np.array([0, np.nan, 80, 120])}))
    assert "expected finite numbers" in str(aligner.aligned(broken).problem)
    assert aligner.aligned(replace(given, problem=ItemError("video", "cut short"))).time_s is None


def test_tables_whose_times_fit_the_only_video_are_its_streams(tmp_path: Path) -> None:
    """Those that do not fit, or have no times, are left out by name, and so are all beside several videos."""
    home = tmp_path / "home"
    home.mkdir()
    pictures = [encode_image(np.full((24, 32, 3), 9 * number, np.uint8), "jpeg") for number in range(20)]
    (home / "take1.avi").write_bytes(write_avi(pictures, 32, 24, 10.0))
    for name, last_s in (("force", 1.9), ("pose", 1.9), ("long", 9.0)):
        time_s = np.linspace(0, last_s, 100)
        stream(home, {"time_s": time_s.tolist(), name: (2 * time_s).tolist()}, f"{name}.csv")
    stream(home, {"n": [1, 2]}, "notes.csv")
    assert len(realtouch.preview_import(home).streams) == 2
    realtouch.import_touches(home, tmp_path / "out")
    (touch,) = realtouch.load(tmp_path / "out", "train").touches()
    for name in ("force", "pose"):
        np.testing.assert_allclose(touch.extra[name], 0.2 * np.arange(20), atol=0.03)
    left_out = store.read_manifest(store.open_folder(str(tmp_path / "out"))).spec["left_out"]
    assert left_out[0].startswith("long: ")
    assert "lasts 9.00 s" in left_out[0]
    assert left_out[1:] == ["notes.csv (a table that was not named; see --table, --stream and --cut)"]
    named = realtouch.preview_import(home, realtouch.ImportSpec(streams=(str(home / "force.csv"),)))
    assert [report[:2] for report in named.streams] == [("take1", "pose"), ("take1", "force")]
    (home / "take2.avi").write_bytes((home / "take1.avi").read_bytes())
    assert not realtouch.preview_import(home).streams
