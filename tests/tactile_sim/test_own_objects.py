"""Touches of meshes of a user, with sensors of any geometry."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

import realtouch
import tactile_sim
from tactile_sim.press.sensors import sensor_of_model
from tactile_sim.sets.generation import TouchGenerator
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.mesh import Mesh
from tactile_toolkit.mesh.files import pack_mesh
from tactile_toolkit.store import Skipped
from tactile_toolkit.touch import PRESS_DEPTH_M
from tests.command_line import call
from tests.mutations import mutated
from tests.small_sets import write_scenes
from tests.tactile_sim.solids import ball, block

pytestmark = pytest.mark.sim

PLAN = tactile_sim.TouchPlan(2, 3, "object", seed=3)
THIN = tactile_sim.SensorModel("thin", 12, 9, 160, 120, 1.0, "a caliper")


def depth(**others: Any) -> tactile_sim.TouchSetSpec:
    return tactile_sim.TouchSetSpec((32, 24), "depth", plan=PLAN, image_format="png", **others)


def write(file: Path, solid: Any = None, unit: float = 1000.0) -> None:
    """Write a solid in metres as a file, in millimetres by default, and with a ``unit`` of 1 in metres."""
    file.parent.mkdir(parents=True, exist_ok=True)
    content = pack_mesh(Mesh.of((solid or block()).copy().apply_scale(unit / 1000)), file.suffix)
    file.write_bytes(content)


def shards(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in sorted(folder.glob("data/*.parquet"))}


def spec_of(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "manifest.json").read_text())
    return found["spec"]


def test_a_file_is_a_class_and_the_same_set_by_name_and_in_memory(tmp_path: Path) -> None:
    write(tmp_path / "in" / "part.stl")
    tactile_sim.generate(tmp_path / "in" / "part.stl", depth(), tmp_path / "file")
    tactile_sim.generate(str(tmp_path / "in"), depth(), tmp_path / "folder")
    # The file holds floats of single precision.
    same = tactile_sim.generate({"part": block()}, depth(), tmp_path / "memory")
    assert shards(tmp_path / "file") == shards(tmp_path / "folder")
    of_file, of_memory = (realtouch.load(tmp_path / name) for name in ("file", "memory"))
    assert of_file.label_names == of_memory.label_names == ("part",)
    for one, other in zip(of_file, of_memory, strict=True):
        assert (one.id, one.label, one.object_id) == (other.id, other.label, other.object_id)
        np.testing.assert_allclose(one.pos_in_cell, other.pos_in_cell, atol=1e-8)
        assert np.abs(one.sensor_image[:].astype(int) - other.sensor_image[:]).mean() < 0.5
    (fact,) = spec_of(tmp_path / "file")["source"]["train"]
    assert (fact["file"], fact["id"], fact["unit"], len(fact["sha256"])) == ("part.stl", 0, "mm", 64)
    (fact,) = same.spec["source"]["train"]
    assert (fact["file"], sorted(fact)) == ("part/0", ["file", "id", "rows", "sha256"])


def test_folders_are_classes_and_splits_and_no_path_is_stored(tmp_path: Path) -> None:
    for name in ("train/nut 10/b.stl", "train/nut 10/a.obj", "train/nut 2/c.ply", "test/a bolt/d.3mf"):
        write(tmp_path / "own" / name)
    (tmp_path / "own" / "train" / "nut 2" / ".half.stl").write_bytes(b"half")
    source = str(tmp_path / "own")
    tactile_sim.generate(source, depth(), tmp_path / "out")
    train, test = (realtouch.load(tmp_path / "out", split) for split in ("train", "test"))
    assert train.label_names == test.label_names == ("a bolt", "nut 2", "nut 10")
    assert [(row.object_id, row.label) for row in train[::2]] == [(0, 1), (1, 2), (2, 2)]
    assert [(row.object_id, row.label) for row in test[::2]] == [(3, 0)]
    listed = spec_of(tmp_path / "out")["source"]["train"]
    names = ["train/nut 2/c.ply", "train/nut 10/a.obj", "train/nut 10/b.stl"]
    assert [(each["id"], each["file"]) for each in listed] == list(enumerate(names))
    for file in (tmp_path / "out").glob("*.*"):
        assert str(tmp_path).encode() not in file.read_bytes()
    # The bytes are the same split by split, and for selected objects.
    tactile_sim.generate(source, depth(), tmp_path / "again", ["test"])
    tactile_sim.generate(source, depth(), tmp_path / "again", ["train"])
    assert shards(tmp_path / "again") == shards(tmp_path / "out")
    tactile_sim.generate(source, depth(labels=["nut 10"], ids=[1, (2, 9)]), tmp_path / "some", ["train"])
    chosen = realtouch.load(tmp_path / "some", "train")
    assert [row.id for row in chosen] == ["1-0", "1-1", "2-0", "2-1"]
    assert (chosen[0].sensor_image[1] == train[2].sensor_image[1]).all()


def test_each_object_that_cannot_be_touched_is_left_out_once(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr("tactile_sim.sets.generation._SHARD_BYTES", 1)
    folder = tmp_path / "own"
    opened, flat = block(), block((0.02, 0.01, 0.001))
    opened.faces = opened.faces[1:]
    flat.vertices[:, 2] = 0.0
    write(folder / "ball.stl", ball())
    for name, solid in (("open", opened), ("flat", flat), ("long", block((0.2, 0.01, 0.01)))):
        write(folder / f"{name}.stl", solid)
    write(folder / "metres.stl", unit=1.0)
    (folder / "empty.stl").touch()
    (folder / "noise.obj").write_bytes(bytes(range(256)) * 9)
    (folder / "cut.glb").write_bytes(b"glTF\2\0\0\0")
    manifest = tactile_sim.generate(folder, depth(), tmp_path / "out")
    items = [item for shard in manifest.shards for item in shard.skipped]
    files = [each["file"].partition(".")[0] for each in manifest.spec["source"]["train"]]
    assert {files[item.id]: item.reason for item in items} == {
        "open": "no-solid",
        "flat": "no-solid",
        "long": "too-large",
        **dict.fromkeys(("metres", "empty", "noise", "cut"), "unreadable"),
    }
    assert len(items) == 7
    for item in items:
        assert f"({files[item.id]}." in item.message
        assert str(tmp_path) not in item.message
    assert [row.object_id for row in realtouch.load(tmp_path / "out")] == [files.index("ball")] * 2
    with pytest.raises(InputError, match=r"no row is left.*probably in m; next: give --unit m"):
        tactile_sim.generate(folder / "metres.stl", depth(), tmp_path / "none")
    assert not (tmp_path / "none").exists()
    made = tactile_sim.generate(folder / "metres.stl", depth(), tmp_path / "metres", unit="m")
    assert made.spec["source"]["train"][0]["unit"] == "m"
    tactile_sim.generate({"part": block()}, depth(), tmp_path / "memory")
    for one, other in zip(*map(realtouch.load, (tmp_path / "metres", tmp_path / "memory")), strict=True):
        np.testing.assert_allclose(one.pos_in_cell, other.pos_in_cell, atol=1e-8)


def test_invalid_sources_are_refused_before_anything_is_written(tmp_path: Path) -> None:
    write(tmp_path / "own" / "a" / "part.stl")
    write(tmp_path / "loose.stl")
    (tmp_path / "linked").mkdir()
    (tmp_path / "linked" / "x.stl").symlink_to(tmp_path / "loose.stl")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.stl")
    write(tmp_path / "mixed" / "train" / "part.stl")
    write(tmp_path / "mixed" / "part.stl")
    made = tmp_path / "made"
    tactile_sim.generate(tmp_path / "loose.stl", depth(), made)
    for source, unit, words in (
        (tmp_path / "own", "inch", "unit is 'inch'; expected one of mm, cm, m, in"),
        (made, "mm", "unit is for mesh files"),
        ({"a": block()}, "mm", "unit is for mesh files"),
        (tmp_path / "linked", None, r"x\.stl: .*link leads out"),
        (tmp_path / "pipe.stl", None, r"does not exist|not a regular file"),
        (tmp_path / "mixed", None, r"holds part\.stl next to the splits train"),
        ({}, None, "no meshes were given"),
        ({"": block()}, None, "a class of the meshes is called ''"),
        ({"a": "part.stl"}, None, "a str holds no triangles"),
    ):
        with pytest.raises(InputError, match=words):
            tactile_sim.generate(source, depth(), tmp_path / "none", unit=unit)
    with pytest.raises(InputError, match="lies in the source"):
        tactile_sim.generate(tmp_path / "own", depth(), tmp_path / "own" / "touches")
    assert not (tmp_path / "none").exists()
    # A file that is replaced after it was listed.
    touches = TouchGenerator.of(tmp_path / "loose.stl", depth())
    write(tmp_path / "loose.stl", ball())
    with pytest.raises(IntegrityError, match="was replaced or changed"):
        list(touches.make("train", range(2)))


def test_a_folder_with_a_data_set_is_not_a_folder_of_meshes(tmp_path: Path) -> None:
    write_scenes(tmp_path)
    write(tmp_path / "prints" / "part.stl")
    assert TouchGenerator.of(tmp_path, depth()).source["train"].label_names == ("1", "2", "3")


@pytest.mark.parametrize("name", [*tactile_sim.SENSORS, "thin"])
@pytest.mark.parametrize(
    ("window", "size_px"), [("full", (64, 48)), ("center", (60, 40)), ("center", (40, 60))]
)
def test_images_show_a_block_in_its_size(name, window, size_px, tmp_path):
    """A block in the middle of the gel: width and height in the image, depth, and where the sensor stops."""
    model = {**tactile_sim.SENSORS, "thin": THIN}[name]
    width_mm, depth_mm, height_mm = 6.0, 4.0, 0.4 * model.gel_mm
    given = tactile_sim.TouchTable([0.0], [0.0], object_x_m=[0.0], object_y_m=[0.0], object_turn_rad=[0.0])
    spec = tactile_sim.TouchSetSpec(
        size_px,
        "depth",
        window,
        tactile_sim.TouchPlan(1, positions="given", touch_table=given),
        "png",
        sensor=model,
    )
    solid = block((width_mm / 1e3, depth_mm / 1e3, height_mm / 1e3))
    tactile_sim.generate({"block": solid}, spec, tmp_path / "out")
    rounds = realtouch.load(tmp_path / "out")
    grey = rounds[0].sensor_image[0][..., 0].astype(float)
    if window == "full":
        pitch_mm = (model.width_mm / size_px[0], model.height_mm / size_px[1])
    elif name == "gelsight-mini":  # of the environments: the whole height, whatever the width
        pitch_mm = (14.16 / size_px[1],) * 2
    else:
        pitch_mm = (min(model.width_mm / size_px[0], model.height_mm / size_px[1]),) * 2
    # Pressed in by half of the gel: the plate is `height` deeper than the deepest, of half the gel in all.
    plate = 255 * height_mm / (model.gel_mm / 2)
    assert np.median(grey) == pytest.approx(plate, abs=1)
    assert grey.min() == 0
    row, column = np.array(grey.shape) // 2
    dark = (plate - grey) / plate  # the share of each pixel that shows the block
    assert dark[row].sum() * pitch_mm[0] == pytest.approx(width_mm, abs=1.1 * pitch_mm[0])
    assert dark[:, column].sum() * pitch_mm[1] == pytest.approx(depth_mm, abs=1.1 * pitch_mm[1])
    sensor_z_m = rounds[0].gel_pose_cell_frame.position_m[0, 2]
    assert sensor_z_m == pytest.approx((height_mm + model.gel_mm / 2) / 1e3, abs=1e-9)
    # Readers know the height above the plate for any gel.
    assert rounds.touches().heights_m() == pytest.approx([height_mm / 1e3], abs=1e-9)
    assert len(rounds.touches().with_contact()) == 1
    assert ("plate_z_m" in pq.read_schema(next((tmp_path / "out" / "data").iterdir())).names) == (
        model.gel_mm / 2e3 != PRESS_DEPTH_M
    )
    stored = spec_of(tmp_path / "out")["options"].get("sensor")
    card = (tmp_path / "out" / "README.md").read_text()
    if name == "gelsight-mini":
        assert stored is None
        assert "a simulated GelSight Mini that" in card
    else:
        assert stored == model.to_dict()
        assert f"gel, {model.gel_mm:g} mm thick" in card
        assert model.source.partition(",")[0] in card


def test_the_part_of_another_sensor_lies_within_it_and_has_square_pixels() -> None:
    for model in tactile_sim.SENSORS.values():
        for size_px in ((64, 64), (320, 240), (17, 200)):
            width_m, height_m = sensor_of_model(model, "center", size_px).window_m
            assert width_m / size_px[0] == pytest.approx(height_m / size_px[1])
            left_over = (model.width_mm - 1e3 * width_m, model.height_mm - 1e3 * height_m)
            assert min(left_over) == pytest.approx(0, abs=1e-9)
    r15 = tactile_sim.SENSORS["gelsight-r15"]
    assert r15.width_mm / r15.width_px == pytest.approx(0.0877)
    assert r15.height_mm / r15.height_px == pytest.approx(0.0877)


def test_a_sensor_is_named_or_read_from_a_file(tmp_path: Path, capsys: Any) -> None:
    file = tmp_path / "own.json"
    file.write_text(json.dumps(THIN.to_dict()))
    assert tactile_sim.SensorModel.named(str(file)) == THIN
    assert tactile_sim.TouchSetSpec(optics="depth", sensor="digit").sensor == tactile_sim.SENSORS["digit"]
    assert tactile_sim.TouchSetSpec(optics="depth", sensor=THIN.to_dict()).sensor == THIN
    with pytest.raises(InputError, match=r"'taxim' are calibrated for the GelSight Mini.*add --optics depth"):
        tactile_sim.TouchSetSpec(optics="taxim", sensor="digit")
    with pytest.raises(InputError, match="sensor is 'finger'; expected one of gelsight-mini, digit, gels"):
        tactile_sim.SensorModel.named("finger")
    for sensor in (3, {}, {"name": "thin"}, {**THIN.to_dict(), "press_mm": 1}):
        with pytest.raises(InputError, match=r"the sensor is .*; expected a SensorModel.* a mapping of name"):
            tactile_sim.TouchSetSpec(optics="depth", sensor=sensor)
    # Named before the recordings are read.
    words = ("calibrate", tmp_path / "none", "--solids", tmp_path / "none", "--out", tmp_path / "twin")
    assert call("tactile-sim", *words, "--start", "finger") == 2
    assert "--start is 'finger'" in capsys.readouterr().err
    with pytest.raises(InputError, match="4,096 touches in a round; expected at most 1,024"):
        tactile_sim.TouchSetSpec(optics="depth", sensor="digit", plan=tactile_sim.TouchPlan(1, 4096))
    for change, words in (
        ({"gel_mm": 0}, "gel_mm of the sensor is 0"),
        ({"width_px": 10**9}, "width_px of the sensor"),
        ({"width_mm": "wide"}, "width_mm of the sensor"),
        ({"name": 3}, "name of the sensor"),
        ({"name": "x" * 501}, "name of the sensor"),
        ({"press_mm": 1}, "press_mm.* expected a JSON object with name, width_mm"),
    ):
        file.write_text(json.dumps({**THIN.to_dict(), **change}))
        with pytest.raises(InputError, match=words):
            tactile_sim.SensorModel.named(str(file))
    for content in ("", "[1]", "{" * 10_000, '{"name": null}', '{"name": "a"}', " " * (1 << 17)):
        file.write_text(content)
        with pytest.raises(InputError, match=r"own\.json"):
            tactile_sim.SensorModel.named(str(file))
    # Commands use depth images for another sensor unless other optics are requested.
    file.write_text(json.dumps(THIN.to_dict()))
    write(tmp_path / "part.stl")
    words = ("--sensor", file, "--size", "32x24", "--rounds", 1, "--touches", 2, "--out", tmp_path / "out")
    assert call("tactile-sim", "generate", tmp_path / "part.stl", *words, "-q") == 0
    assert spec_of(tmp_path / "out")["options"]["sensor"] == THIN.to_dict()
    assert call("tactile", "verify", tmp_path / "out", "-q") == 0
    assert call("tactile", "card", tmp_path / "out", "-q") == 0
    assert call("tactile-sim", "generate", tmp_path / "part.stl", *words, "--revision", "main") == 2
    assert "--revision has no effect on mesh files; next: leave it out" in capsys.readouterr().err
    assert call("tactile-sim", "generate", tmp_path / "part.stl", *words, "--optics", "taxim") == 2
    assert "add --optics depth" in capsys.readouterr().err


def test_depth_images_have_grey_noise_of_the_requested_deviation(tmp_path: Path) -> None:
    noise = tactile_sim.SensorNoise.named("0.02")
    plan = tactile_sim.TouchPlan(2, 3, "object", seed=1, turn_rad=0.0)
    clean = tactile_sim.TouchSetSpec((64, 64), "depth", plan=plan, image_format="png")
    noisy = tactile_sim.TouchSetSpec((64, 64), "depth", plan=plan, image_format="png", noise=noise)
    solids = {"ball": ball(0.01), "larger": ball(0.02)}
    images = []
    for spec in (clean, noisy, noisy):
        out = tmp_path / f"out-{len(images)}"
        tactile_sim.generate(solids, spec, out, workers=1)
        images.append(np.stack([row.sensor_image[:] for row in realtouch.load(out)]).astype(float))
    assert (images[1] == images[2]).all()
    assert (images[1][..., 0] == images[1][..., 2]).all()
    # Where the noise is not clipped by the range.
    within = (images[0] > 30) & (images[0] < 225)
    added = (images[1] - images[0])[within] / 255
    assert added.std() == pytest.approx(0.02, rel=0.05)
    assert abs(added.mean()) < 0.001
    one, other = (images[1] - images[0])[0, :2]
    assert (one != other).any()


@pytest.mark.thorough
@pytest.mark.parametrize("ending", [".stl", ".obj", ".ply", ".3mf", ".glb"])
def test_damaged_files_are_left_out_with_a_sentence(ending: str, tmp_path: Path) -> None:
    whole = pack_mesh(Mesh.of(block()), ending)
    for number in range(150):
        (tmp_path / f"{number}{ending}").write_bytes(mutated(whole, number))
    plan = tactile_sim.TouchPlan(1, 1, "object")
    touches = TouchGenerator.of(tmp_path, tactile_sim.TouchSetSpec((16, 12), "depth", plan=plan))
    made = list(touches.make("train", range(150)))
    assert len(made) == 150
    skipped = [each for each in made if isinstance(each, Skipped)]
    assert {each.reason for each in skipped} <= {"unreadable", "no-solid", "too-large"}
    assert 0 < len(skipped) < 150
