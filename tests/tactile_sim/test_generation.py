"""Data sets of touches: the same bytes with any number of workers, and readable like all touches."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import realtouch
import starstruck_gen
import tactile_sim
from tactile_sim.optics.rendering import make_optics
from tactile_sim.sets.generation import TouchGenerator
from tactile_sim.sets.round_plan import REACH_M
from tactile_sim.sets.set_options import default_optics
from tactile_toolkit.errors import InputError
from tactile_toolkit.generation import plan_build
from tactile_toolkit.touch import decode_image
from tests.command_line import call
from tests.tactile_sim.oracle import require_package
from tests.tactile_sim.solids import block
from tests.tactile_toolkit.toy import folder_bytes

pytestmark = pytest.mark.sim

PLAN = tactile_sim.TouchPlan(rounds=2, touches=5, seed=3)
SPEC = tactile_sim.TouchSetSpec((64, 48), "depth", plan=PLAN, image_format="png")


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """Seven scenes to train with, three to test."""
    folder = tmp_path_factory.mktemp("scenes")
    starstruck_gen.generate(starstruck_gen.SceneSetSpec(scenes=(("train", 7), ("test", 3))), str(folder))
    return str(folder)


@pytest.fixture(scope="module")
def touches(scenes, tmp_path_factory):
    folder = tmp_path_factory.mktemp("touches")
    tactile_sim.generate(scenes, SPEC, folder)
    return folder


@pytest.mark.thorough
def test_the_same_bytes_with_workers_split_by_split_and_small_shards(scenes, touches, tmp_path, monkeypatch):
    monkeypatch.setattr("tactile_sim.sets.generation._SHARD_BYTES", 60_000)
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    tactile_sim.generate(scenes, SPEC, whole)
    tactile_sim.generate(scenes, SPEC, parts, ["test"])
    tactile_sim.generate(scenes, SPEC, parts, ["train"], workers=2)
    assert folder_bytes(whole) == folder_bytes(parts)
    assert len(list((whole / "data").iterdir())) > 2
    for split in ("train", "test"):
        one, other = realtouch.load(touches, split), realtouch.load(whole, split)
        assert [r.id for r in one] == [r.id for r in other]
        assert (one[2].sensor_image[3] == other[2].sensor_image[3]).all()


def test_shards_and_row_groups_hold_as_many_rounds_as_their_bytes_allow(scenes):
    """A later version with other shards could not continue a set, and would make other files."""
    for size_px, touches, largest, rows_per_group in (((64, 64), 256, 161, 20), ((320, 240), 64, 52, 6)):
        spec = tactile_sim.TouchSetSpec(size_px, "depth", plan=tactile_sim.TouchPlan(2, touches))
        layout = TouchGenerator.of(scenes, spec).layout()
        assert (layout.largest, layout.style.rows_per_group) == (largest, rows_per_group)


@pytest.mark.parametrize("overwrite", [False, True])
def test_the_source_is_not_written_over(overwrite, scenes):
    before = folder_bytes(Path(scenes))
    with pytest.raises(InputError, match=r"holds the source.*choose a folder outside it"):
        tactile_sim.generate(scenes, SPEC, scenes, overwrite=overwrite)
    assert folder_bytes(Path(scenes)) == before


def test_a_set_agrees_with_its_poses(scenes, touches):
    """Rendering the stored poses again gives the stored pictures and heights."""
    rounds, solids = realtouch.load(touches, "train"), starstruck_gen.load(scenes, "train")
    assert len(rounds) == 14
    for record in rounds:
        solid = solids[[s.id for s in solids].index(record.object_id)]
        touched = record.info["touched_object_pose"]
        targets = np.stack([tactile_sim.pose(*place) for place in record.pos_in_cell])
        pressed = tactile_sim.render_touch(solid, touched.matrix, targets, tactile_sim.center_view(64, 48))
        assert np.abs(pressed.sensor_z_m - record.gel_pose_cell_frame.position_m[:, 2]).max() < 1e-9
        stored = record.sensor_image[0][..., 0]
        assert np.abs(stored - pressed.image[0] * 255).max() <= 0.51
        assert record.label == solid.label
        later = record.info["object_pose"]
        assert (later.position_m[:-1] == touched.position_m[1:]).all()
        assert (np.abs(record.pos_in_cell) <= REACH_M).all()


def test_published_is_the_whole_sensor_rendered_large_and_scaled(scenes, tmp_path):
    """Compared with another method: the window is cut from 320 x 240 pixels, and NumPy averages areas."""
    spec = tactile_sim.TouchSetSpec((64, 48), "depth", "full", PLAN, "png", limit=2)
    tactile_sim.generate(scenes, spec, tmp_path / "made", ["train"])
    solids = starstruck_gen.load(scenes, "train")
    whole = tactile_sim.Sensor((320, 240), (0.01888, 0.01416))
    contacts = 0
    for record in realtouch.load(tmp_path / "made", "train"):
        solid = solids[[s.id for s in solids].index(record.object_id)]
        targets = np.stack([tactile_sim.pose(*place) for place in record.pos_in_cell])
        pressed = tactile_sim.render_touch(solid, record.info["touched_object_pose"].matrix, targets, whole)
        grey = np.rint(pressed.image * np.float32(255)).reshape(-1, 48, 5, 64, 5).mean(axis=(2, 4))
        stored = record.sensor_image[:]
        assert stored.shape == (5, 48, 64, 3)
        assert np.abs(stored - grey[..., None]).max() <= 0.51
        contacts += int((pressed.sensor_z_m > 0.003).sum())
        # Sensor heights are those of the large picture.
        assert np.abs(pressed.sensor_z_m - record.gel_pose_cell_frame.position_m[:, 2]).max() < 1e-9
    assert contacts


@pytest.mark.oracle
def test_the_published_loader_reads_it(touches):
    require_package()
    import datasets

    from tests.published_envs import published_package

    stored = datasets.load_dataset(str(touches), split="test")
    theirs = published_package("tactile_mnist").TouchSingleDataset(stored)
    ours = realtouch.load(touches, "test")
    assert len(theirs) == len(ours) == 6
    assert theirs.label_names == ("1", "2", "3")
    for one, other in zip(theirs, ours, strict=True):
        assert one.id == other.id
        assert one.label == other.label
        assert (one.sensor_image[2] == other.sensor_image[2]).all()
        position = one.info["object_pose"].translation
        assert (position == other.info["object_pose"].position_m).all()


def test_rounds_follow_from_seed_split_object_and_number():
    solid = tactile_sim.Pressable.of(block())
    draw = tactile_sim.plan_round
    base = draw(PLAN, solid, "train", 5, 1)
    assert (draw(PLAN, solid, "train", 5, 1).object_poses == base.object_poses).all()
    for other in (("test", 5, 1), ("train", 6, 1), ("train", 5, 0)):
        assert (draw(PLAN, solid, *other).object_poses != base.object_poses).any()
    assert base.object_poses.shape == (6, 4, 4)
    longer = draw(tactile_sim.TouchPlan(rounds=9, touches=5, seed=3), solid, "train", 5, 1)
    assert (longer.positions_m == base.positions_m).all()


def test_places_of_touches():
    solid, draw = tactile_sim.Pressable.of(block((0.05, 0.004, 0.003))), tactile_sim.plan_round
    for touches in (1, 2, 3, 7, 9, 12):
        grid = draw(tactile_sim.TouchPlan(1, touches, positions="grid"), solid, "train", 0, 0).positions_m
        columns = np.ceil(np.sqrt(touches))
        rows = np.ceil(touches / columns)
        middles = [
            ((2 * column + 1) / columns - 1, (2 * row + 1) / rows - 1)
            for row in np.arange(rows)
            for column in np.arange(columns)
        ]
        np.testing.assert_allclose(grid, middles[:touches] * np.array(REACH_M), atol=1e-12)
    grid = draw(tactile_sim.TouchPlan(1, 9, positions="grid"), solid, "train", 0, 0).positions_m
    assert np.ptp(grid, axis=0) == pytest.approx(2 * np.array(REACH_M) * 2 / 3)
    plan = tactile_sim.TouchPlan(
        1, 200, positions="object", turn_rad=np.pi, object_placement="middle", perturb=False
    )
    made = draw(plan, solid, "train", 0, 0)
    targets = np.stack([tactile_sim.pose(*place) for place in made.positions_m])
    point = tactile_sim.Sensor((1, 1), (1e-6, 1e-6))
    pressed = tactile_sim.render_touch(solid, made.object_poses[:-1], targets, point)
    assert (pressed.sensor_z_m > 0.0029 + point.press_m).all()
    still = draw(tactile_sim.TouchPlan(1, 2, perturb=False, turn_rad=0.0), solid, "train", 0, 0)
    assert (still.object_poses[0] == still.object_poses[-1]).all()


@pytest.mark.parametrize(("length_m", "reach_m"), [(0.04, 0.03), (0.2, 0.0)])
def test_objects_lie_anywhere_a_centimetre_within_the_cell_or_in_its_middle(length_m, reach_m):
    middle_m, reach = np.array([0.005, 0.0]), np.array([reach_m, 0.04])
    moved = block((length_m, 0.02, 0.003)).apply_translation([*middle_m, 0.0])
    solid, plan = tactile_sim.Pressable.of(moved), tactile_sim.TouchPlan(300, 1, turn_rad=0.0)
    made = [tactile_sim.plan_round(plan, solid, "train", 0, number) for number in range(plan.rounds)]
    middles = np.array([each.object_position_m[0, :2] for each in made]) + middle_m
    assert (np.abs(middles) <= reach + 1e-12).all()
    for ends, expected in ((middles.min(axis=0), -reach), (middles.max(axis=0), reach)):
        assert ends == pytest.approx(expected, abs=1e-3)


def test_shifts_are_as_large_as_those_of_the_environments():
    solid = tactile_sim.Pressable.of(block((0.01, 0.01, 0.003)))
    made = tactile_sim.plan_round(tactile_sim.TouchPlan(1, 4000), solid, "train", 0, 0)
    steps = np.diff(made.object_position_m[:, :2], axis=0)
    assert steps.std() == pytest.approx(1e-3, rel=0.05)
    turns = 2 * np.arctan2(made.object_quaternion[:, 2], made.object_quaternion[:, 3])
    assert np.diff(np.unwrap(turns)).std() == pytest.approx(5e-2, rel=0.05)


@pytest.mark.parametrize(
    "values",
    [
        *({"rounds": 0}, {"touches": 1.5}, {"positions": "moon"}, {"turn_rad": 4.0}, {"turn_rad": "far"}),
        *({"object_placement": "there"}, {"perturb": 3}, {"seed": -1}),
    ],
)
def test_invalid_plans_are_refused(values):
    with pytest.raises(InputError, match=f"{next(iter(values))} of the plan"):
        tactile_sim.TouchPlan(**values)


def test_invalid_sources_are_refused(scenes, touches, tmp_path):
    with pytest.raises(InputError, match="does not exist; expected a folder"):
        TouchGenerator.of(tmp_path / "nothing", SPEC)
    with pytest.raises(InputError, match="unknown split 'dev'"):
        plan_build(TouchGenerator.of(scenes, SPEC), ["dev"])
    shard = next(Path(scenes, "data").glob("train-*"))
    (tmp_path / "data").mkdir()
    pq.write_table(pq.read_table(shard).slice(0, 0), tmp_path / "data" / shard.name)
    with pytest.raises(InputError, match="no rounds to make for train"):
        tactile_sim.generate(tmp_path, SPEC, tmp_path / "out", ["train"])
    assert not (tmp_path / "out").exists()
    with pytest.raises(InputError, match="holds synthetic touches; `tactile-sim generate` is for meshes"):
        TouchGenerator.of(str(touches), SPEC)
    with pytest.raises(InputError, match="expected one of"):
        tactile_sim.TouchSetSpec(optics="lens")


def test_a_table_of_touches_is_an_option_of_the_command(scenes, tmp_path, capsys):
    (tmp_path / "places.csv").write_text("x_m,y_m\n0,0\n0.01,0\n")
    words = ("generate", scenes, "--split", "test", "--optics", "depth", "-w", 1, "--out", tmp_path / "out")
    given = ("--touches-from", tmp_path / "places.csv")
    assert call("tactile-sim", *words, *given, "--positions", "grid") == 2
    assert call("tactile-sim", *words, *given, "--rounds", 1) == 0
    assert "made 3 rounds" in capsys.readouterr().out
    assert call("tactile", "info", tmp_path / "out") == 0
    assert "optics = depth" in capsys.readouterr().out
    record = realtouch.load(tmp_path / "out", "test")[0]
    assert record.pos_in_cell.tolist() == [[0, 0], [0.01, 0]]


def test_one_look_at_a_mesh_file(tmp_path, capsys):
    block((0.02, 0.006, 0.004)).apply_scale(1000).export(tmp_path / "part.stl")
    words = ("--at-mm", "2,0", "--turn-deg", "17", "--optics", "depth", "--size", "80x60")
    words = ("render", tmp_path / "part.stl", *words, "--out", tmp_path / "touch.png")
    assert call("tactile-sim", *words) == 0
    assert "stops 6.125 mm above the plate" in capsys.readouterr().out
    assert decode_image((tmp_path / "touch.png").read_bytes()).shape == (60, 80, 3)
    assert call("tactile-sim", *words, "--layer-mm", "0.3", "--overwrite") == 0
    assert "stops 6.125 mm above the plate" not in capsys.readouterr().out  # tops are whole layers


def _rendered(capsys, *arguments) -> tuple[dict, str]:
    assert call("tactile-sim", "render", *arguments, "--optics", "depth", "--json") == 0
    said = capsys.readouterr()
    return json.loads(said.out), said.err


def test_contact_of_a_look_counts_the_object(tmp_path, capsys):
    """A block of 4 x 3 mm, 1 mm high: the gel touches it and the plate around it."""
    block((0.004, 0.003, 0.001)).apply_scale(1000).export(tmp_path / "low.stl")
    words = ("--unit", "mm", "--size", "80x60", "--out", tmp_path / "low.png")
    found, note = _rendered(capsys, tmp_path / "low.stl", *words)
    assert found["contact"] == pytest.approx(4 * 3 / (18.88 * 14.16), rel=0.1)
    assert note == ""


def test_a_touch_that_misses_the_mesh_reports_its_position(tmp_path, capsys):
    away = block()
    away.apply_translation([0.1, -0.03, 0.2])
    away.apply_scale(1000).export(tmp_path / "away.stl")
    arguments = (tmp_path / "away.stl", "--out", tmp_path / "touch.png")
    found, note = _rendered(capsys, *arguments)
    assert (found["contact"], found["sensor_z_m"]) == (0.0, 0.002125)
    assert "x 90.0 to 110.0 mm, y -33.0 to -27.0 mm" in note
    assert "--at-mm object" in note
    assert call("tactile-sim", "render", *arguments) == 2
    assert "exists; nothing was written; next: add --overwrite" in capsys.readouterr().err
    found, note = _rendered(capsys, *arguments, "--at-mm", "object", "--overwrite")
    assert found["contact"] > 0.2
    assert found["sensor_z_m"] == pytest.approx(0.004 + 0.002125)
    assert note == ""


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("glass",), "no optics 'glass'; expected one of depth"),
        (("depth", "own.npz"), "weights were given, but"),
    ],
)
def test_optics_that_are_not_there_are_named(given, words):
    with pytest.raises(InputError, match=words):
        make_optics(*given)


def test_some_objects_are_touched_as_among_all(scenes, touches, tmp_path):
    of_all = {row.id: row for split in ("train", "test") for row in realtouch.load(touches, split)}
    ids = realtouch.load(touches, "train").touches().object_ids
    chosen = {"ids": [int(ids[0]), (2, 4)], "labels": ["1", "2"], "per_class": 1}
    some = tactile_sim.TouchSetSpec((64, 48), "depth", plan=PLAN, image_format="png", **chosen)
    manifest = tactile_sim.generate(scenes, some, tmp_path / "some", ["train"])
    assert manifest.spec["options"]["per_class"] == 1
    made = realtouch.load(tmp_path / "some", "train")
    assert [row.id for row in made] == ["0-0", "0-1", "4-0", "4-1"]
    for row in made:
        assert (row.sensor_image[1] == of_all[row.id].sensor_image[1]).all()
    unknown = tactile_sim.TouchSetSpec(optics="depth", plan=PLAN, ids=[99])
    with pytest.raises(InputError, match="no object with id 99"):
        TouchGenerator.of(scenes, unknown)


def test_the_default_of_the_optics_needs_no_extra(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr("tactile_sim.sets.set_options.find_spec", lambda name: name)
    assert default_optics() == "taxim"
    monkeypatch.setattr("tactile_sim.sets.set_options.find_spec", lambda _: None)
    assert default_optics() == "depth"
    block().apply_scale(1000).export(tmp_path / "part.stl")
    words = (tmp_path / "part.stl", "--size", "32x24", "--out", tmp_path / "touch.png")
    assert call("tactile-sim", "render", *words) == 0
    assert "note: images are depth images; --optics taxim needs the extra `sim`" in capsys.readouterr().err
