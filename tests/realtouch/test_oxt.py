"""Open-X-Tactile, the Zarr format of FTP-1: written as specified, read back, and recordings of others."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

import realtouch
import tactile_sim
from realtouch.formats.zarr_recordings import restore_column_names
from realtouch.importing.import_sources import IMPORTS
from realtouch.importing.source_files import Ledger
from realtouch.importing.source_touches import Recording
from tactile_toolkit import store
from tactile_toolkit.errors import InputError
from tests.command_line import call
from tests.realtouch.found import per_frame, require_pictures_or_messages
from tests.tactile_sim.solids import block

zarr = pytest.importorskip("zarr", reason="needs zarr, of the extra dev")

T, H, W = 7, 12, 16
ENDS = np.array([4, 7])
RANDOM = np.random.default_rng(5)
PADS = RANDOM.integers(0, 256, (T, 2, H, W, 3), np.uint8)
TIPS = RANDOM.integers(0, 256, (T, 1, H, W, 3), np.uint8)


def tactile(side: str, group: str, data: Any, kind: str = "image", sensor: str = "GelSightMini") -> Any:
    """Return the four members of a group."""
    count = data.shape[1]
    return {
        f"{side}_tactile_data_{group}": data,
        f"{side}_tactile_area_{group}": np.tile(np.arange(count), (T, 1)),
        f"{side}_tactile_sensor_{group}": np.full(T, sensor),
        f"{side}_tactile_type_{group}": np.full(T, kind),
    }


def arrays(**changes: Any) -> dict[str, Any]:
    """Return the arrays of a set of another laboratory; ``None`` leaves one out."""
    found = {
        "timestamps": np.array([0, 0.1, 0.2, 0.35, 0, 0.1, 0.2]),
        "camera_ego_rgb": np.zeros((T, 20, 20, 3), np.uint8),
        "right_wrist_pose": RANDOM.normal(size=(T, 6)),
        "right_hand_joints": RANDOM.normal(size=(T, 1)).astype(np.float32),
        "right_hand_joints_idx": np.full((T, 1), 28, np.int32),
        "sub_task_instruction": np.repeat(["lift the bottle", "wipe"], [4, 3]),
        **tactile("right", "gripper", PADS),
        **tactile("left", "force", RANDOM.normal(size=(T, 4, 2)), "state", "InspireHand"),
    }
    return {name: values for name, values in (found | changes).items() if values is not None}


def write(path: Path, data: dict[str, Any], ends: Any = ENDS) -> Path:
    """Write a data set by the package zarr: a folder, or a stored zip for a name with that ending."""
    store_ = zarr.storage.ZipStore(path, mode="w") if path.suffix == ".zip" else str(path)
    group = zarr.open_group(store_, mode="w", zarr_format=2)
    for name, values in {**{f"data/{name}": data[name] for name in data}, "meta/episode_ends": ends}.items():
        values = np.asarray(values)
        group.create_array(name, data=values, chunks=(min(3, len(values)), *values.shape[1:]))
    if path.suffix == ".zip":
        group.store.close()
    return path


def recordings(source: Path, image: str = "file", layout: str = "oxt") -> list[Recording]:
    columns = realtouch.ImportColumns(image=image)
    return list(IMPORTS[layout].find(store.open_folder(str(source)), columns, None, Ledger()))


def decoded(touches: Any) -> np.ndarray:
    return np.stack([touch.image for touch in touches])


def test_exports_follow_the_specification(source, tmp_path, monkeypatch):
    """Opened as by the loader of FTP-1, with zarr: a row for each frame, four members of each group."""
    monkeypatch.setattr("realtouch.formats.zarr_export.CHUNK_BYTES", 4 * 72 * 96 * 3)
    realtouch.export(source, tmp_path / "a", "oxt", split="train")
    path = tmp_path / "a" / "oxt" / "touches.zarr.zip"
    with zipfile.ZipFile(path) as archive:
        assert {each.compress_type for each in archive.infolist()} == {zipfile.ZIP_STORED}
    group = zarr.open_group(zarr.storage.ZipStore(path, mode="r"), mode="r")
    data, ends = {name: array[:] for name, array in group["data"].arrays()}, group["meta/episode_ends"][:]
    assert {len(values) for values in data.values()} == {ends[-1]}
    rounds = list(realtouch.load(source, "train"))
    touches = list(realtouch.load(source, "train").touches())
    if isinstance(rounds[0], realtouch.TouchSeqRound):
        pixels = np.concatenate([touch.clip.frames() for touch in touches])
        poses = [pose for touch in touches for pose in touch.clip.poses]
        np.testing.assert_array_equal(
            data["timestamps"], np.concatenate([touch.clip.timestamps_s for touch in touches])
        )
        labels = np.repeat([touch.label for touch in touches], [len(touch.clip) for touch in touches])
        assert np.diff(ends, prepend=0).tolist() == [len(touch.clip) for touch in touches]
    else:
        pixels, poses = decoded(touches), [touch.gel_pose for touch in touches]
        labels = np.array([touch.label for touch in touches])
        assert np.diff(ends, prepend=0).tolist() == [each.touch_count for each in rounds]
    np.testing.assert_array_equal(data["right_tactile_data_gelsight"], pixels[:, None])
    assert data["right_tactile_area_gelsight"].tolist() == [[0]] * len(pixels)
    assert set(data["right_tactile_sensor_gelsight"]) == {"GelSightMini"}
    assert set(data["right_tactile_type_gelsight"]) == {"image"}
    expected = np.array([[*pose.translation, *pose.rotation.as_rotvec()] for pose in poses])
    np.testing.assert_allclose(data["right_wrist_pose"], expected, rtol=0, atol=1e-11)
    assert data["sub_task_instruction"].tolist() == [f"touch an object of class {each}" for each in labels]
    assert not data["camera_main_rgb"].any()
    assert "black pictures" in group["meta"].attrs["what_stands_for"]["camera_main_rgb"]
    assert realtouch.verify(tmp_path / "a").ok
    realtouch.export(source, tmp_path / "b", "oxt", split="train")
    assert (tmp_path / "b" / "oxt" / "touches.zarr.zip").read_bytes() == path.read_bytes()


@pytest.mark.parametrize("name", ["task.zarr", "task.zarr.zip"])
def test_a_set_of_others_becomes_recordings(name: str, tmp_path: Path) -> None:
    """Every array with a row for each frame is a column with its name; texts of whole episodes are values."""
    data = arrays(left_tactile_data_tip=TIPS)
    source = write(tmp_path / name, data)
    first, second = recordings(source, "right_tactile_data_gripper[1]")
    assert (first.frames, second.frames, second.first) == (4, 3, 4)
    assert first.values == {
        "sub_task_instruction": "lift the bottle",
        "right_tactile_sensor_gripper": "GelSightMini",
        "right_tactile_type_gripper": "image",
        "left_tactile_sensor_force": "InspireHand",
        "left_tactile_type_force": "state",
    }
    assert second.values["sub_task_instruction"] == "wipe"
    for each, part in ((first, slice(0, 4)), (second, slice(4, 7))):
        for column in each.per_frame:
            found = per_frame(each, column)
            wanted = np.asarray(data[column][part]).reshape(found.shape)
            np.testing.assert_array_equal(found, wanted, err_msg=column)
        np.testing.assert_array_equal(each.time_s, data["timestamps"][part])
    assert {"right_wrist_pose", "left_tactile_data_force", "right_tactile_area_gripper"} <= {*first.per_frame}
    assert first.left_out == ("camera_ego_rgb (7, 20, 20, 3)", "left_tactile_data_tip (7, 1, 12, 16, 3)")
    columns = realtouch.ImportColumns(image="right_tactile_data_gripper[1]")
    realtouch.import_touches(source, tmp_path / "out", realtouch.ImportSpec(columns=columns))
    touches = realtouch.load(tmp_path / "out", "train").touches()
    np.testing.assert_array_equal(decoded(touches), PADS[:, 1])
    assert set(touches.labels.tolist()) == {-1}


def test_the_sensor_is_named_where_there_are_several(tmp_path: Path) -> None:
    two = r"right_tactile_data_gripper\[0\], right_tactile_data_gripper\[1\]"
    source = write(tmp_path / "a.zarr", arrays())
    with pytest.raises(InputError, match=f"arrays of pictures {two}; expected one; next: .*--map image"):
        recordings(source)
    for name in ("right_tactile_data_gripper", "right_tactile_data_gripper[2]", "camera_ego_rgb"):
        with pytest.raises(InputError, match=f"arrays of pictures {two}; expected '"):
            recordings(source, name)
    only = {name: None for name in arrays() if "gripper" in name} | tactile("left", "tip", TIPS)
    (first, _) = recordings(write(tmp_path / "b.zarr", arrays(**only)))
    assert first.part.endswith("data/left_tactile_data_tip")
    with pytest.raises(InputError, match="no arrays of pictures, but"):
        recordings(write(tmp_path / "c.zarr", {"timestamps": np.arange(T)}))
    source = write(tmp_path / "d.zarr", {"camera_ego_rgb": np.full((T, 8, 8, 3), 9, np.uint8)})
    for name in ("", "camera_ego_rgb"):
        with pytest.raises(InputError, match="next: --format replay --map image=camera_ego_rgb imports"):
            recordings(source, name)
    columns = realtouch.ImportColumns(image="camera_ego_rgb")
    assert realtouch.preview_import(source, realtouch.ImportSpec("replay", columns)).touches == T


@pytest.mark.parametrize("column", [pa.array(["a", "b"]), pa.array([[1.0, 2.0, 3.0]] * 2)])
def test_columns_that_are_no_pose_are_kept(column: pa.Array) -> None:
    recording = Recording("name", "home", "path", "part", 0, 2, 1, per_frame={"pose": column})
    restored = restore_column_names(recording, {"pose": ("x_m", "y_m")}, ())
    assert restored.per_frame == {"pose": column}


def test_values_of_episodes_are_in_the_order_of_the_arrays(tmp_path: Path) -> None:
    names = [f"note_{letter}" for letter in "abcdefghijklmnop"]
    source = write(tmp_path / "a.zarr", arrays(**dict.fromkeys(names, np.full(T, "x"))))
    found = recordings(source, "right_tactile_data_gripper[0]")
    assert [[name for name in each.values if name in names] for each in found] == [names] * len(ENDS)


def test_times_are_taken_where_they_are_seconds_that_rise(tmp_path: Path) -> None:
    for number, (times, is_known) in enumerate(
        (
            (np.arange(T), False),  # of an integer, the unit is not known
            (np.array([0, 0.1, 0.2, 0.1, 0, 1, 2]), False),
            (np.array([5, 6, 7, 8, 1, 1, 2.0]), True),
            (np.array([0, np.nan, 2, 3, 0, 1, 2]), False),
        )
    ):
        source = write(tmp_path / f"{number}.zarr", arrays(timestamps=times))
        first, _ = recordings(source, "right_tactile_data_gripper[0]")
        assert (first.time_s is not None) == is_known
        np.testing.assert_array_equal(per_frame(first, "timestamps"), times[:4])


def test_invalid_text_is_refused(tmp_path: Path) -> None:
    source = write(tmp_path / "a.zarr", arrays(sub_task_instruction=np.full(T, "abc")))
    for chunk in (source / "data" / "sub_task_instruction").glob("[0-9]*"):
        chunk.write_bytes(np.full(9, 0xDFFF, "<u4").tobytes())
    stated = source / "data" / "sub_task_instruction" / ".zarray"
    stated.write_text(json.dumps(json.loads(stated.read_text()) | {"compressor": None}))
    with pytest.raises(InputError, match="letters that are not Unicode"):
        recordings(source, "right_tactile_data_gripper[0]")


@pytest.mark.thorough
@pytest.mark.parametrize("layout", ["oxt", "replay"])
def test_any_damage_of_a_group_gives_recordings_or_a_message(layout: str, tmp_path: Path) -> None:
    image, data = "right_tactile_data_gripper[1]", arrays()
    if layout == "replay":
        image, data = "img", {"img": PADS[:, 0], "state": np.zeros((T, 7)), "label": np.arange(T) // 4}
    for name in ("a.zarr.zip", "a.zarr"):
        require_pictures_or_messages(write(tmp_path / name, data), layout, image)


def test_the_sensor_is_that_of_the_set_through_copies(tmp_path: Path) -> None:
    solid = block((0.006, 0.006, 0.003))
    for name in ("digit", "gelsight-mini"):
        spec = tactile_sim.TouchSetSpec((32, 24), "depth", "full", tactile_sim.TouchPlan(1, 2), sensor=name)
        tactile_sim.generate({"block": solid}, spec, tmp_path / name)
    digit = tmp_path / "digit"
    assert call("tactile", "select", digit, "--limit", "1", "--out", tmp_path / "selected") == 0
    realtouch.resize(digit, tmp_path / "resized", 16, 12)
    both = tmp_path / "both"
    assert call("tactile", "merge", digit, tmp_path / "gelsight-mini", "--out", both) == 0
    for source, sensor, group in (
        ("digit", "digit", "digit"),
        ("selected", "digit", "digit"),
        ("resized", "digit", "digit"),
        ("gelsight-mini", "GelSightMini", "gelsight"),
        ("both", "digit, gelsight-mini", "sensor"),
    ):
        out = tmp_path / f"{source}-oxt"
        realtouch.export(tmp_path / source, out, "oxt")
        store = zarr.storage.ZipStore(out / "oxt" / "touches.zarr.zip", mode="r")
        data = zarr.open_group(store, mode="r")["data"]
        assert set(data[f"right_tactile_sensor_{group}"][:]) == {sensor}
        assert data[f"right_tactile_data_{group}"].shape[1:] == (
            1,
            *((12, 16) if source == "resized" else (24, 32)),
            3,
        )
        for folder in (tmp_path / source, out):
            card = (folder / "README.md").read_text()
            assert f"- {group}\n" in card
            assert ("- gelsight\n" in card) == (group == "gelsight")
