"""Columns of other projects: mapped by name, in any unit and rotation; clips; and extra columns."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

import realtouch
from realtouch import contact
from realtouch.importing import fields, import_sources
from realtouch.importing.source_touches import PictureLocation, Recording, SourceTouches, touches_of
from realtouch.importing.stored_columns import ExtraColumns
from tactile_toolkit.columns import column_types
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.touch import decode_image, encode_image
from tests.command_line import call
from tests.realtouch import factories, found
from tests.realtouch.images_of_others import picture, write_table

NAMES = ("x", "y", "z", "a", "b", "c")
SEED = np.random.default_rng(7)
PLACES = SEED.uniform(-0.1, 0.1, (20, 3))
TURNS = Rotation.random(20, random_state=7)


def poses(said: dict[str, Any], columns: realtouch.ImportColumns) -> np.ndarray:
    return fields.poses(found.columns(said), columns)


def times_s(said: Any, columns: realtouch.ImportColumns) -> np.ndarray:
    return fields.times_s(found.columns({"t": said})["t"], columns.time or "", columns.time_unit)


def columns_of(values: Any, names: Iterable[str]) -> dict[str, list[Any]]:
    return {name: column.tolist() for name, column in zip(names, np.transpose(values), strict=True)}


def assert_poses(made: Any, places: Any, turns: Rotation) -> None:
    np.testing.assert_allclose(made[:, :3], places, rtol=0, atol=1e-12)
    assert (Rotation.from_quat(made[:, 3:]) * turns.inv()).magnitude().max() < 1e-9


@pytest.mark.parametrize("sequence", ["xyz", "ZYX", "zxz", "XYX", "yxz"])
@pytest.mark.parametrize(("unit", "scale"), [("deg", np.degrees(1.0)), ("rad", 1.0)])
@pytest.mark.parametrize("stated", [True, False])
def test_euler_angles_are_those_of_scipy(sequence: str, unit: str, scale: float, stated: bool) -> None:
    angles = SEED.uniform(-3, 3, (20, 3))
    names = (*NAMES[:3], *(f"{name}_{unit}" if stated else name for name in NAMES[3:]))
    columns = realtouch.ImportColumns(pose=names, euler=sequence, angle_unit=None if stated else unit)  # type: ignore[arg-type]
    made = poses(columns_of(np.hstack([PLACES, scale * angles]), names), columns)
    assert_poses(made, PLACES, Rotation.from_euler(sequence, angles))


@pytest.mark.parametrize("one", [True, False])
@pytest.mark.parametrize("what", ["xyzw", "wxyz", "rotvec", "3x4", "4x4"])
def test_rotations_of_every_kind(what: str, one: bool) -> None:
    """In several columns, or in one with lists, also as text."""
    matrices = np.tile(np.eye(4), (20, 1, 1))
    matrices[:, :3, :3], matrices[:, :3, 3] = TURNS.as_matrix(), 1000 * PLACES
    options: dict[str, Any] = {"length_unit": "mm"}
    quaternions = TURNS.as_quat()
    if what == "rotvec":
        options["rotvec"] = True
        values = np.hstack([1000 * PLACES, TURNS.as_rotvec()])
    elif what in ("3x4", "4x4"):
        values = matrices[:, : int(what[0])].reshape(20, -1)
    else:
        order = [3, 0, 1, 2] if what == "wxyz" else [0, 1, 2, 3]
        options["quaternion_order"] = what
        values = np.hstack([1000 * PLACES, quaternions[:, order]])
    names = tuple(f"c{number}_" for number in range(values.shape[1]))
    if not one:
        assert_poses(
            poses(columns_of(values, names), realtouch.ImportColumns(pose=names, **options)), PLACES, TURNS
        )
        return
    columns = realtouch.ImportColumns(pose=("pose",), **options)
    forms: list[Any] = [values, values.tolist(), [str(row) for row in values.tolist()]]
    if what in ("3x4", "4x4"):
        nested = matrices[:, : int(what[0])]
        forms += [nested, nested.tolist(), [str(row) for row in nested.tolist()]]
    for form in forms:
        assert_poses(poses({"pose": form}, columns), PLACES, TURNS)


def transform() -> np.ndarray:
    frame = np.eye(4)
    frame[:3, :3] = Rotation.from_euler("xyz", (0.3, -0.2, 2.0)).as_matrix()
    frame[:3, 3] = (0.4, -0.3, 0.02)
    return frame


@pytest.mark.parametrize("stored", [np.asarray, np.ndarray.tolist])
def test_position_and_orientation_may_be_a_vector_each(stored: Any) -> None:
    columns = realtouch.ImportColumns(pose=("eef_pos_mm", "eef_quat"))
    values = {"eef_pos_mm": stored(1000 * PLACES), "eef_quat": stored(TURNS.as_quat())}
    assert_poses(poses(values, columns), PLACES, TURNS)
    columns = realtouch.ImportColumns(pose=("eef_pos", "turn"), rotvec=True, length_unit="mm")
    values = {"eef_pos": stored(1000 * PLACES), "turn": stored(TURNS.as_rotvec())}
    assert_poses(poses(values, columns), PLACES, TURNS)


@pytest.mark.parametrize("form", ["txt", "csv", "json", "npy", "array"])
def test_a_frame_leads_to_the_cell(form: str, tmp_path: Path) -> None:
    frame, place = transform(), tmp_path / f"frame.{form}"
    if form == "txt":
        np.savetxt(place, frame, fmt="%.17g")
    elif form == "csv":
        np.savetxt(place, frame, fmt="%.17g", delimiter=",")
    elif form == "json":
        place.write_text(json.dumps(frame.tolist(), indent=1))
    elif form == "npy":
        np.save(place, frame)
    there = np.linalg.inv(frame)
    base_places = PLACES @ there[:3, :3].T + there[:3, 3]
    base_turns = Rotation.from_matrix(there[:3, :3]) * TURNS
    given: Any = frame if form == "array" else place
    columns = realtouch.ImportColumns(pose=("pose",), frame=given)
    made = poses({"pose": np.hstack([base_places, base_turns.as_quat()])}, columns)
    assert_poses(made, PLACES, TURNS)
    with pytest.raises(ItemError, match="--transform another frame"):
        poses({"pose": np.hstack([base_places + 1, base_turns.as_quat()])}, columns)
    with pytest.raises(InputError, match="the frame tilts"):
        fields.stated_positions(found.columns({"p": PLACES[:, :2]}), replace(columns, position=("p",)))
    upright = transform()
    upright[:3, :3] = Rotation.from_rotvec([0, 0, 1.0]).as_matrix()
    away = np.linalg.inv(upright)
    xy = (PLACES @ away[:3, :3].T + away[:3, 3])[:, :2]
    turned = realtouch.ImportColumns(position=("p",), frame=upright)  # type: ignore[arg-type]
    np.testing.assert_allclose(
        fields.stated_positions(found.columns({"p": xy}), turned), PLACES[:, :2], atol=1e-12
    )


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("1 0 0 0\n0 1 0 0\n0 0 1 0\n", "no matrix of numbers; expected 4 x 4"),
        ("2 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1", "no rigid transform"),
        ("1 0 0 0\n0 1 0 0\n0 0 -1 0\n0 0 0 1", "no rigid transform"),
        ("1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 1 1", "no rigid transform"),
        ("1 0 0 nan\n0 1 0 0\n0 0 1 0\n0 0 0 1", "no rigid transform"),
        ("a b", "no matrix"),
        ("\x93NUMPY", "no matrix"),
        (" " * (1 << 20) + "1", "more than 1,048,576 bytes"),
    ],
)
def test_invalid_frames(content: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "frame").write_text(content, encoding="latin-1")
    with pytest.raises(InputError, match=words):
        realtouch.ImportColumns(frame=tmp_path / "frame")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="cannot be read"):
        realtouch.ImportColumns(frame=tmp_path / "nothing")  # type: ignore[arg-type]


SIX = ("x", "y", "z", "a", "b", "c")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"pose": SIX}, "6 pose columns .*expected 7, 12 or 16.*--euler or --rotvec"),
        ({"pose": SIX, "euler": "xyz"}, "unit of the Euler angles is not known.*--angle-unit"),
        ({"pose": ("pose",), "euler": "xyz"}, "unit of the Euler angles is not known"),
        ({"euler": "xxz"}, "expected three axes"),
        ({"euler": "xYz"}, "expected three axes"),
        ({"euler": "xy"}, "expected three axes"),
        ({"euler": "xyz", "rotvec": True}, r"euler contradicts rotvec \(--rotvec\)"),
        ({"euler": "xyz", "quaternion_order": "xyzw"}, r"quaternion_order contradicts euler \(--euler\)"),
        ({"pose": (*SIX[:3], "a_deg", "b", "c"), "rotvec": True, "angle_unit": "rad"}, "'a_deg' states deg"),
        ({"pose": (*SIX[:3], "a_mm", "b", "c"), "rotvec": True}, "'a_mm' states mm .*expected an angle"),
        ({"pose": ("x_ms", *SIX[1:]), "rotvec": True}, "'x_ms' states ms .*expected a length"),
        ({"pose": ("x_mm", "y", "z", "qx", "qy", "qz", "qw"), "length_unit": "m"}, "'x_mm' states mm"),
        ({"position": ("x_deg", "y")}, "'x_deg' states deg in its name; expected a length"),
        (
            {"pose": ("x", "y", "z", "qw", "qx", "qy", "qz")},
            "are qw, qx, qy, qz; expected the order x, y, z, w",
        ),
        (
            {"pose": ("x", "y", "z", "qx", "qy", "qz", "qw"), "quaternion_order": "wxyz"},
            "expected the order w, x, y, z",
        ),
        ({"length_unit": "inch"}, "length_unit of the columns is 'inch'; expected None or one of mm, cm, m"),
        ({"quaternion_order": "zyxw"}, "expected None or one of xyzw, wxyz"),
        ({"time_unit": "min"}, "time_unit of the columns is 'min'"),
        ({"extra": (("a\nb", "c"),)}, "printable characters"),
        ({"extra": (("a" * 101, "c"),)}, "1 to 100 printable characters"),
        ({"extra": (("a", "b"), ("a", "c"))}, "named twice"),
    ],
)
def test_columns_without_unit_or_rotation(options: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        realtouch.ImportColumns(**options)


@pytest.mark.parametrize(
    ("value", "options", "words"),
    [
        ([0, 0, 0, 0, 0, 0], {}, "expected 7 finite numbers, or 12 or 16 of a matrix"),
        ([0, 0, 0, 0, 0, 90], {"rotvec": True}, "more than two turns in radians; .*--angle-unit"),
        (np.diag([1, 1, -1, 1]).tolist(), {}, "no rigid transform"),
        ((2 * np.eye(4)).tolist(), {}, "no rigid transform"),
        (np.zeros((2, 6)).tolist(), {}, "no rigid transform"),
        (None, {}, "expected 7 finite numbers"),
        ({"x": 1}, {}, "expected 7 finite numbers"),
        ([[]], {}, "expected 7 finite numbers"),
    ],
)
def test_values_that_are_no_pose(value: Any, options: dict[str, Any], words: str) -> None:
    with pytest.raises(ItemError, match=words):
        poses({"pose": [value]}, realtouch.ImportColumns(pose=("pose",), **options))


@given(st.lists(st.floats(0, 1e5), min_size=1, max_size=9), st.sampled_from(["s", "ms", "us", "ns"]))
def test_times_are_read_to_a_microsecond(seconds: list[float], unit: str) -> None:
    scale = {"s": 1, "ms": 1e3, "us": 1e6, "ns": 1e9}[unit]
    start = 1.7e9
    ticks = [
        round((start + each) * scale) if unit in ("us", "ns") else (start + each) * scale for each in seconds
    ]
    for columns in (
        realtouch.ImportColumns(time=f"stamp_{unit}"),
        realtouch.ImportColumns(time="stamp", time_unit=unit),
    ):
        for form in (ticks, [repr(each) for each in ticks], np.array(ticks)):
            np.testing.assert_allclose(times_s(form, columns) - start, seconds, rtol=0, atol=2e-6)


def test_times_may_be_points_in_time() -> None:
    stamps = np.array(["2024-05-01T12:00:00.25", "2024-05-01T12:00:01.5"], "datetime64[us]")
    np.testing.assert_allclose(np.diff(times_s(stamps, realtouch.ImportColumns())), [1.25], atol=1e-6)
    with pytest.raises(ItemError, match=r"the times \[None\] from number 1"):
        times_s(np.array(["NaT"], "datetime64[us]"), realtouch.ImportColumns())
    with pytest.raises(ItemError, match="expected finite numbers"):
        times_s(["noon"], realtouch.ImportColumns())


def test_extra_columns_of_a_table_are_kept(home, tmp_path, capsys):
    lines = [
        {"file": f"pictures/{number}.jpg", "label": "cat", "Fz": force, "note": note, "ok": "TRUE",
         "id": number, "t_ms": 1500 * number, "empty": "", "mass": "1,234"}
        for number, (force, note) in enumerate([("1.5", "a"), ("", "b, c"), ("-2", ""), ("0.25", "d")])
    ]  # fmt: skip
    write_table(home, lines)
    words = ("--map", "force_n=Fz", "--map", "time=t_ms", "--out", tmp_path / "out", "-w", 1)
    assert call("realtouch", "import", home, "--format", "folder", *words) == 0
    rows = pq.read_table(tmp_path / "out" / "data")
    assert [name for name in rows.column_names if name.startswith("extra.")] == [
        "extra.force_n", "extra.note", "extra.ok", "extra.mass", "extra.time_s"
    ]  # fmt: skip
    assert rows["extra.force_n"].to_pylist() == [[1.5], [None], [-2.0], [0.25]]
    assert rows["extra.note"].to_pylist() == [["a"], ["b, c"], [None], ["d"]]
    assert rows["extra.ok"].to_pylist() == [[True]] * 4
    assert rows["extra.mass"].to_pylist() == [["1,234"]] * 4  # which may be a thousand
    assert rows["extra.time_s"].to_pylist() == [[0.0], [1.5], [3.0], [4.5]]
    said = capsys.readouterr().err
    assert "fields that were not imported, with their numbers of touches: id (4)" in said
    assert realtouch.verify(tmp_path / "out").ok
    columns = realtouch.ImportColumns().with_mapped(["note=Fz"])
    with pytest.raises(InputError, match="'Fz' and 'note' would both be kept as 'note'"):
        realtouch.import_touches(home, tmp_path / "none", realtouch.ImportSpec("folder", columns))
    left = realtouch.ImportColumns().with_mapped(["number=id", "Fz=", "ok="])
    realtouch.import_touches(home, tmp_path / "left", realtouch.ImportSpec("folder", left))
    rows = pq.read_table(tmp_path / "left" / "data")
    assert rows["extra.number"].to_pylist() == [[0], [1], [2], [3]]
    assert "extra.Fz" not in rows.column_names
    manifest = json.loads((tmp_path / "left" / "manifest.json").read_text())
    assert manifest["statistics"]["train"]["not_imported"] == {"Fz": 3, "ok": 4}


def frames_of(count: int, pressed: range, size: tuple[int, int] = (24, 32)) -> list[bytes]:
    """Return pictures of a gel that shows a bright spot while it is pressed."""
    made = []
    for number in range(count):
        pixels = np.full((*size, 3), 90, np.uint8)
        if number in pressed:
            pixels[8:18, 10:24] = 200
        made.append(factories.encode_jpeg(pixels))
    return made


@pytest.fixture
def recordings(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """Import recordings in memory; return the imported rounds of the split ``train``."""

    def make(
        every: list[Recording], pictures: dict[str, list[Any]], columns: Any = None, **options: Any
    ) -> Any:
        def encoded(places: Iterable[PictureLocation]) -> Iterator[Any]:
            for place in places:
                yield from pictures[place.path][place.start : place.start + max(1, place.frames)]

        layout = import_sources.ImportFormat(lambda *_: iter(every), encoded, "whole", True)
        monkeypatch.setitem(import_sources.IMPORTS, "replay", layout)
        (tmp_path / "source").mkdir(exist_ok=True)
        manifest = realtouch.import_touches(
            tmp_path / "source", tmp_path / "out", realtouch.ImportSpec("replay", columns, **options)
        )
        assert realtouch.verify(tmp_path / "out").ok
        return realtouch.load(tmp_path / "out", "train"), manifest

    return make


def recording(name: str, frames: int, **said: Any) -> Recording:
    said["per_frame"] = found.columns(said.pop("per_frame", {}))
    return Recording(name, "memory", name, "", 0, frames, 700, **said)


@pytest.mark.parametrize("cut", ["frames", "whole"])
@pytest.mark.parametrize("order", [1, -1])
def test_a_recording_that_cannot_be_used_decides_nothing(
    recordings: Any, cut: str, order: int, tmp_path: Path
) -> None:
    found = [recording("bad", 1, problem=ItemError("file", "gone")), recording("a", 4)]
    rounds, manifest = recordings(found[::order], {"a": frames_of(4, range(0))}, cut=cut)
    assert manifest.skipped_reasons() == {"file": 1}
    (kept,) = rounds
    assert (kept.id, kept.touch_count) == ("a", 4 if cut == "frames" else 1)


def test_clips_have_the_values_of_the_recording(recordings: Any, tmp_path: Path) -> None:
    """Pictures are equal, times within a microsecond, poses and extra columns unchanged."""
    pictures = {"a": frames_of(9, range(3, 6)), "b": frames_of(5, range(0))}
    quaternions, places = TURNS.as_quat()[:9], 1000 * PLACES[:9]
    time_s = 1.7e9 + np.array([0, 1, 2, 3.5, 4, 5, 6, 7, 8]) / 30
    found = [
        recording(
            "a", 9, values={"class": "cat", "session": "one"}, time_s=time_s,
            per_frame={"arm_mm": np.hstack([places, quaternions]), "force": np.arange(9, dtype=np.float32),
                       "tool": np.arange(18).reshape(9, 2), "phase": np.array(["in"] * 9)},
        ),
        recording("b", 5, values={"class": "cat", "session": "one", "note": "late", "phase": "out"},
                  per_frame={"arm_mm": np.tile([1.0, 2, 3, 0, 0, 0, 1], (5, 1))}),
    ]  # fmt: skip
    columns = realtouch.ImportColumns().with_mapped(
        ["label=class", "round=session", "pose=arm_mm", "force_n=force"]
    )
    rounds, manifest = recordings(found, pictures, columns)
    (only,) = rounds
    assert (only.id, only.label, rounds.label_names) == ("one", 0, ("cat",))
    assert only.video_length_frames.tolist() == [9, 5]
    for clip, frames in zip(only.sensor_video, pictures.values(), strict=True):
        assert [bytes(clip.encoded(number)) for number in range(len(clip))] == frames
    poses_of = only.gel_pose_cell_frame_seq[0]
    np.testing.assert_allclose(poses_of.position_m, PLACES[:9], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(poses_of.quaternion, quaternions)
    times = only.time_stamp_rel_seq[0] / np.timedelta64(1, "s")
    np.testing.assert_allclose(times, time_s - time_s[0], rtol=0, atol=1e-6)
    assert only.sensor_video[0].fps == pytest.approx(30, rel=1e-3)
    assert only.sensor_video[1].fps == 25
    assert (only.touch_start_time_rel / np.timedelta64(1, "us")).round()[0] == round(3.5e6 / 30)
    assert only.sensor_video[0].contact_window == slice(3, 6)
    rows = pq.read_table(tmp_path / "out" / "data").to_pylist()
    assert rows[0]["extra_seq.force_n"] == [list(map(float, range(9))), [None] * 5]
    assert rows[0]["extra_seq.tool"] == [np.arange(18).reshape(9, 2).tolist(), [None] * 5]
    assert rows[0]["extra_seq.phase"] == [["in"] * 9, ["out"] * 5]
    assert rows[0]["extra.note"] == [None, "late"]
    assert manifest.statistics()["train"]["clips"] == {
        "contact found by the pictures": 1,
        "no contact found: the best picture": 1,
        "times of 25 pictures a second, as none are known": 1,
    }


def test_known_contact_and_times_of_a_column(recordings: Any) -> None:
    pictures = {"a": frames_of(6, range(1, 3))}
    said = recording("a", 6, per_frame={"stamp_ms": np.arange(6) * 40.0 + 7e9})
    columns = realtouch.ImportColumns(time="stamp_ms")
    (only,), manifest = recordings([replace(said, contact=(2, 4))], pictures, columns)
    assert only.sensor_video[0].contact_window == slice(2, 5)
    assert only.sensor_video[0].fps == 25
    assert "clips" not in manifest.statistics().get("train", {})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"time_s": np.array([0, 1, 3, 2.0])}, "picture 3"),
        ({"time_s": np.array([0, 1, 2, 3e9])}, "--time-unit states another unit"),
        ({"time_s": np.array([0, 1.0])}, "2 times of 4 pictures"),
        ({"pictures": [picture(1), picture(2)[:-30], picture(3), picture(4)]}, "picture 1: an image of"),
        (
            {"pictures": [picture(1), picture(2), picture(3, (30, 40)), picture(4)]},
            "picture 2: 40 x 30 pixels",
        ),
        ({"pictures": [picture(1), ItemError("image", "lost"), picture(3), picture(4)]}, "picture 1: lost"),
        ({"per_frame": {"pose": np.full((4, 7), np.nan)}}, "picture 0: .*expected 7 finite numbers"),
        ({"frames": 10_001}, "10,001 pictures; the limit is 10,000"),
    ],
)
def test_unusable_clips(change: dict[str, Any], words: str, recordings: Any) -> None:
    change = dict(change)
    columns = realtouch.ImportColumns(pose=("pose",)) if "per_frame" in change else None
    pictures = {"a": change.pop("pictures", frames_of(4, range(0))), "b": frames_of(4, range(0))}
    poses_of = {"per_frame": {"pose": np.tile([0, 0, 0.1, 0, 0, 0, 1.0], (4, 1))}} if columns else {}
    bad = recording("a", change.pop("frames", 4), **change)
    _, manifest = recordings([recording("b", 4, **poses_of), bad], pictures, columns)
    (skipped,) = manifest.shards[0].skipped
    assert re.search(words, skipped.message)


def test_clips_of_other_pictures_are_jpegs(recordings: Any) -> None:
    """If pictures are not JPEG, the manifest states that they were encoded."""
    png = [encode_image(np.full((24, 32, 3), level, np.uint8), "png") for level in (10, 90)]
    (only,), manifest = recordings([recording("a", 2)], {"a": png})
    assert [int(clip.mean().round()) for clip in only.sensor_video[0].frames()] == [10, 90]
    assert manifest.statistics()["train"]["clips"]["pictures encoded as JPEG"] == 1


@pytest.mark.parametrize("labels", [["cat"] * 4, ["cat", "cat", "dog", "cat"]])
def test_a_label_of_each_picture_is_that_of_the_clip(labels: list[str], recordings: Any) -> None:
    said = {"per_frame": {"class": np.array(labels), "object": np.full(4, 7)}}
    pictures = {"a": frames_of(4, range(0)), "b": frames_of(4, range(0))}
    columns = realtouch.ImportColumns(label="class", object_id="object")
    found = [recording("a", 4, **said), recording("b", 4, values={"class": "cat", "object": 7})]
    rounds, manifest = recordings(found, pictures, columns)
    assert (rounds[-1].label, rounds[-1].object_id) == (0, 7)
    is_one = len(set(labels)) == 1
    assert len(rounds) == 1 + is_one
    assert manifest.skipped_reasons() == ({} if is_one else {"frames": 1})


def test_a_column_that_no_recording_has_is_refused(recordings: Any) -> None:
    found = [recording("a", 4, values={"class": "cat"})]
    for columns in (
        realtouch.ImportColumns(label="clas"),
        realtouch.ImportColumns(extra=(("force", "clas"),)),
    ):
        with pytest.raises(InputError, match="no column 'clas'; did you mean 'class'"):
            recordings(found, {"a": frames_of(4, range(0))}, columns)


def test_a_format_may_state_rotation_vectors() -> None:
    columns = realtouch.ImportColumns(pose=("wrist",)).found_in(["wrist"], rotvec=True)
    assert_poses(poses({"wrist": np.hstack([PLACES, TURNS.as_rotvec()])}, columns), PLACES, TURNS)
    stated = realtouch.ImportColumns(pose=("wrist",), euler="xyz", angle_unit="rad").found_in([], rotvec=True)
    assert (stated.euler, stated.rotvec) == ("xyz", False)
    assert import_sources.IMPORTS["oxt"].rotvec


def test_contact_of_a_long_clip_is_found_by_some_of_its_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contact, "_DECODED_AT_ONCE", 7)
    pictures = frames_of(30, range(11, 15))
    assert contact.contact_by_pictures(pictures, (24, 32), decode_image) == ((11, 14), True)
    found = contact.contact_by_pictures(frames_of(30, range(0)), (24, 32), decode_image)
    assert found == ((0, 0), False)
    with pytest.raises(ValueError, match="cannot be decoded"):
        contact.contact_by_pictures([*pictures, pictures[0][:300]], (24, 32), decode_image)


_VALUES: tuple[Any, ...] = (
    st.booleans(),
    st.integers(-(1 << 63), (1 << 63) - 1),
    st.floats(allow_nan=False),
    st.text("ab1,é ", min_size=1).filter(str.strip).map(lambda text: f"t{text}"),
)


@given(st.data())
def test_extra_values_come_back_as_they_were(data: st.DataObject) -> None:
    """For touches and for pictures, as JSON and as text of tables; missing values stay missing."""
    kind = data.draw(st.sampled_from(_VALUES))
    if data.draw(st.booleans()):
        kind = st.lists(kind, min_size=1, max_size=3)
    values = data.draw(st.lists(st.none() | kind, min_size=1, max_size=6).filter(any_is_known))
    columns = realtouch.ImportColumns(extra=(("new", "x"),))
    column = column_types.column_of(values)
    assert kept(touches({"x": column}), columns) == ("extra.new", values)
    pictures = Recording("a", "", "", "", 0, len(values), 1, per_frame={"x": column})
    assert kept(touches_of(pictures, "whole"), columns) == ("extra_seq.new", [values])
    if not any(isinstance(value, list) for value in values):
        words = pa.array(["" if each is None else str(each) for each in values])
        assert kept(touches({"x": column_types.column_of(words, from_text=True)}), columns) == (
            "extra.new",
            values,
        )


def any_is_known(values: list[Any]) -> bool:
    return any(value is not None for value in values)


def touches(said: dict[str, pa.Array]) -> SourceTouches:
    return SourceTouches.of(["a"] * len(said["x"]), "", "", said)


def kept(every: SourceTouches, columns: realtouch.ImportColumns) -> tuple[str, Any]:
    ((name, array),) = ExtraColumns.of(every, columns).arrays(every).items()
    return name, array.to_pylist()


def test_times_of_images_may_be_missing_but_not_wrong(home: Path, tmp_path: Path) -> None:
    stamps = ("2.5", "", "noon", "4")
    write_table(
        home, [{"file": f"pictures/{number}.jpg", "stamp": each} for number, each in enumerate(stamps)]
    )
    columns = realtouch.ImportColumns(time="stamp", time_unit="ms")
    manifest = realtouch.import_touches(home, tmp_path / "out", realtouch.ImportSpec("folder", columns))
    assert [(each.id, each.reason) for each in manifest.shards[0].skipped] == [(2, "time")]
    rows = pq.read_table(tmp_path / "out" / "data")
    assert rows["extra.time_s"].to_pylist() == [[0.0025], [None], [0.004]]
