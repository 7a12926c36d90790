"""Contact of synthetic touches: where the sensor met an object of any height, or no plate."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import realtouch
import tactile_sim
from realtouch.touch_gallery import plan_gallery
from realtouch.touch_previews import CONTACT, draw_grid
from tactile_sim.sets.pairs import Domain, Pairs, decode_depth, encode_depth, make_pairs
from tactile_sim.sets.set_options import PairSetSpec
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.places import open_place
from tactile_toolkit.read import ShardedTable
from tactile_toolkit.store import open_folder, read_manifest
from tactile_toolkit.touch import encode_image
from tests.command_line import call
from tests.env_assets.factories import write_meshes
from tests.realtouch.images_of_others import write_table
from tests.sealed import edit
from tests.tactile_sim.solids import block

pytestmark = pytest.mark.sim
PRESS_M = 0.002125


def _made(scenes: Path, folder: Path, place: str) -> Path:
    plan = tactile_sim.TouchPlan(1, 12, place, seed=3)
    spec = tactile_sim.TouchSetSpec((32, 24), "depth", plan=plan, image_format="png")
    tactile_sim.generate(scenes, spec, folder, ["train"])
    return folder


@pytest.fixture(scope="module")
def on_objects(scenes, tmp_path_factory):
    """All touches are on an object."""
    return _made(scenes, tmp_path_factory.mktemp("touches") / "on-objects", "object")


@pytest.fixture(scope="module")
def in_cell(scenes, tmp_path_factory):
    """Some of the touches are on an object."""
    return _made(scenes, tmp_path_factory.mktemp("touches") / "in-cell", "cell")


@pytest.fixture(scope="module")
def pairs(scenes, in_cell, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pairs") / "set"
    make_pairs(scenes, str(in_cell), "train", PairSetSpec((32, 24), 10, 0.2), folder)
    return str(folder)


@pytest.fixture(params=["on_objects", "in_cell"])
def touches(request):
    return request.getfixturevalue(request.param)


def _met(folder: Path) -> np.ndarray:
    """Return whether the sensor stopped higher than on the bare plate, by the stored poses."""
    rounds = realtouch.load(folder, "train")
    return np.concatenate([record.gel_pose_cell_frame.position_m[:, 2] for record in rounds]) > PRESS_M + 1e-9


def test_contact_means_that_the_sensor_met_an_object(touches):
    view = realtouch.load(touches, "train").touches()
    met = _met(touches)
    for recalibrate_z in (True, False):
        with_contact = view.with_contact(recalibrate_z=recalibrate_z)
        assert list(with_contact) == list(view[met])
    np.testing.assert_allclose(view.heights_m(), np.where(met, 0.005, 0.0), atol=1e-6)
    assert len(view.with_contact(min_height_m=0.0051)) == 0
    assert len(view.sample(no_contact_fraction=0.0)) == met.sum()


def test_selected_touches_are_those_in_contact(touches, tmp_path):
    met = _met(touches)
    assert call("tactile", "select", touches, "--out", tmp_path / "some", "--contact") == 0
    some = realtouch.load(tmp_path / "some", "train")
    assert len(some.touches()) == met.sum()
    assert realtouch.summarise(some).contact_share == 1.0
    np.testing.assert_allclose(some.touches().heights_m(), 0.005, atol=1e-6)
    np.testing.assert_allclose(some.column("plate_z_m"), PRESS_M)
    assert realtouch.verify(tmp_path / "some").ok


def test_pictures_and_galleries_frame_them(touches):
    met = _met(touches).reshape(3, 12)
    for record, of_round in zip(realtouch.load(touches, "train"), met, strict=True):
        framed = (draw_grid(record, 12) == CONTACT).all(axis=2).any()
        assert framed == of_round.any()
    items = [item for task in plan_gallery(str(touches)).tasks for item in task.make()]
    assert [item.values["in_contact"] for item in items] == met.sum(axis=1).tolist()
    for item, of_round in zip(items, met, strict=True):
        listed = item.content["touches"]["list"]
        assert [entry["contact"] for entry in listed] == of_round.tolist()
        assert [entry["height_mm"] for entry in listed] == pytest.approx(5.0 * of_round, abs=0.01)


def test_pairs_are_drawn_by_the_same_rule(pairs):
    manifest = read_manifest(open_folder(pairs))
    assert manifest is not None
    assert [record.statistics["on_object"] for record in manifest.shards] == [8, 8]
    assert " 6 mm" not in Path(pairs, "README.md").read_text()


def test_depth_survives_its_picture(monkeypatch):
    image = np.linspace(0, 1, 32 * 24, dtype=np.float32).reshape(24, 32)
    assert np.abs(decode_depth(encode_depth(image)) - image).max() < 1e-5
    level = decode_depth(encode_depth(np.zeros((4, 4), np.float32)))
    assert (level == 1).all()  # a level surface counts as no contact
    monkeypatch.setattr("tactile_toolkit.touch.images.MAX_IMAGE_PIXELS", 10_000)
    for other, words in (
        (b"no picture", "expected a grey PNG"),
        (encode_image(image.astype(np.uint8), "png"), "mode L"),
        (encode_depth(np.zeros((101, 100), np.float32)), "100 x 101 pixels"),
    ):
        with pytest.raises(ValueError, match=words):
            decode_depth(other)


def test_damaged_pairs_are_named(pairs, tmp_path):
    data = tmp_path / "data"
    data.mkdir()
    (file,) = Path(pairs, "data").glob("depth-*")
    table = pq.read_table(file)
    images = table["sensor_image"].to_pylist()
    images[0]["bytes"] = encode_depth(np.ones((32, 24), np.float32))
    images[1]["bytes"] = images[1]["bytes"][:40]
    place = table.schema.get_field_index("sensor_image")
    column = pa.array(images, table.schema.field(place).type)
    pq.write_table(table.set_column(place, table.schema.field(place), column), data / file.name)
    depth = Domain(ShardedTable(open_place(str(tmp_path)).shards("depth")), True, (32, 24))
    for row, text in (
        (0, f"{file.name}', row 0: an image of 24 x 32 pixels; expected .32, 24. as in the manifest"),
        (1, f"{file.name}', row 1: an image that cannot be decoded; expected a grey .*next: run `tactile "),
    ):
        with pytest.raises(IntegrityError, match=text):
            depth.image(row)
    assert (depth.image(2) == Pairs.open(pairs).depth.image(2)).all()
    shutil.copy(Path(pairs, "manifest.json"), tmp_path / "manifest.json")
    edit(tmp_path / "manifest.json", lambda values: values["spec"]["options"].pop("size_px"))
    with pytest.raises(IntegrityError, match="does not state size and window of the images"):
        Pairs.open(str(tmp_path))


def test_pairs_of_other_data_sets_are_refused(scenes, in_cell, tmp_path):
    with pytest.raises(InputError, match="is not a training set; expected a folder that"):
        Pairs.open(str(in_cell))
    _without_rows(scenes, tmp_path / "none")
    with pytest.raises(InputError, match=r"split 'train' of '.*none' holds no mesh; next: choose another"):
        make_pairs(str(tmp_path / "none"), str(in_cell), "train", PairSetSpec((32, 24), 10), tmp_path / "out")
    for wrong, text in (({"size_px": (30, 32)}, "multiples of 4"), ({"without_contact": 2}, "0 to 1")):
        with pytest.raises(InputError, match=text):
            PairSetSpec(**{"count": 9, **wrong})
    assert [path.name for path in tmp_path.iterdir()] == ["none"]


def _without_rows(source, folder):
    """Write a shard with the columns of a set, without rows."""
    (file,) = Path(source, "data").glob("train-*")
    (folder / "data").mkdir(parents=True)
    pq.write_table(pq.read_table(file).slice(0, 0), folder / "data" / file.name)


@pytest.mark.parametrize("columns", [("file",), ("file", "label"), ("file", "session")])
def test_recordings_without_labels_objects_and_poses_make_pairs(columns, scenes, tmp_path, capsys):
    """Images decide about contact, compared with others of a round, or of all rounds of one image."""
    rng, home = np.random.default_rng(5), tmp_path / "home"
    home.mkdir()
    lines = []
    for number in range(12):
        pixels = np.full((24, 32, 3), 90, np.uint8)
        if number % 3 == 0:  # a third of them shows contact, so that the median is the gel at rest
            pixels[6:18, 8:24] = rng.integers(150, 256, (12, 16, 3))
        (home / f"{number:02d}.png").write_bytes(encode_image(pixels, "png"))
        lines.append({"file": f"{number:02d}.png", "label": 1, "session": f"s{number // 6}"})
    write_table(home, [{name: each[name] for name in columns} for each in lines])
    round_column = "session" if "session" in columns else None
    realtouch.import_touches(
        home, tmp_path / "own", realtouch.ImportSpec("folder", realtouch.ImportColumns(round=round_column))
    )
    words = ("pairs", scenes, "--real", tmp_path / "own", "--split", "train", "--size", "32x32", "-w", 1)
    words += ("--min-height-mm", 4, "--without-contact", 0)
    assert call("tactile-sim", *words, "--count", 4, "--out", tmp_path / "o") == 0
    real = Pairs.open(str(tmp_path / "o")).real
    assert real.contact.all()
    assert set(real.labels.tolist()) == {1 if "label" in columns else -1}
    assert set(real.object_ids.tolist()) == {-1}
    assert min(real.image(row).max() for row in range(4)) > 150
    assert call("tactile-sim", *words, "--count", 5, "--out", tmp_path / "p") == 2
    found = "holds 4 touches with contact and 8 without, as their images show; expected at least 5"
    assert found in capsys.readouterr().err
    assert not (tmp_path / "p").exists()


def test_objects_that_are_too_low_for_a_touch_are_named(in_cell, tmp_path):
    low = write_meshes(tmp_path / "low", [block((0.02, 0.03, 0.003))], ("a",))
    spec = PairSetSpec((32, 24), 1, 0.0, min_height_m=0.004)
    words = "object 0 is nowhere 4.0 mm high: no touch of it counts as contact; next: lower --min-height-mm"
    with pytest.raises(InputError, match=words):
        make_pairs(str(low), str(in_cell), "train", spec, tmp_path / "out")
    assert not (tmp_path / "out").exists()
