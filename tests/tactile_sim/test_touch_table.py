"""Touches from tables: they are made as the tables state."""

from __future__ import annotations

import numpy as np
import pytest

import realtouch
import tactile_sim
from tactile_sim.sets.generation import TouchGenerator
from tactile_toolkit.errors import InputError
from tests.tactile_sim.solids import block

TABLE = {
    "x_m": [0.01, -0.02, 0.0, 0.03],
    "y_m": [0.0, 0.01, -0.01, 0.0],
    "object_id": [1, 1, 0, 1],
    "round": [0, 1, 0, 1],
    "object_x_m": [0.0, 0.001, 0.0, 0.002],
    "object_y_m": [0.0, 0.0, 0.0, -0.001],
    "object_turn_rad": [0.0, 0.5, 0.0, -0.5],
}


def _write(folder, suffix, table):
    file = folder / f"touches{suffix}"
    mark = {".csv": ",", ".tsv": "\t"}[suffix]
    lines = [mark.join(table), *(mark.join(map(repr, row)) for row in zip(*table.values(), strict=True))]
    file.write_text("\n".join(lines) + "\n")
    return file


@pytest.mark.parametrize("suffix", [".csv", ".tsv"])
def test_files_of_all_formats_give_the_same_table(suffix, tmp_path):
    read = tactile_sim.TouchTable.read(_write(tmp_path, suffix, TABLE))
    assert tactile_sim.TouchTable(**TABLE).to_dict() == read.to_dict()
    assert (read.rounds, read.longest) == (2, 2)
    places, lies = read.of(1, 1)
    assert places.tolist() == [[-0.02, 0.01], [0.03, 0.0]]
    assert lies.tolist() == [[0.001, 0.0, 0.5], [0.002, -0.001, -0.5]]
    assert [len(read.of(*key)[0]) for key in ((0, 0), (0, 1), (1, 0), (7, 0))] == [1, 0, 1, 0]


def test_columns_state_their_units_and_an_index_is_ignored(tmp_path):
    scales = {"x_m": ("x_mm", 1e3), "y_m": ("y_cm", 1e2), "object_turn_rad": ("object_turn_deg", 180 / np.pi)}
    table = {"": [0, 1, 2, 3]}
    for name, values in TABLE.items():
        other, scale = scales.get(name, (name, 1))
        table[other] = [scale * value for value in values]
    made, read = tactile_sim.TouchTable(**TABLE), tactile_sim.TouchTable.read(_write(tmp_path, ".csv", table))
    for column in TABLE:
        np.testing.assert_allclose(getattr(read, column), getattr(made, column), rtol=1e-12, atol=1e-15)
    for wrong in ({"x_mm": [1.0], "x_m": [0.001], "y_m": [0.0]}, {"x_deg": [1.0], "y_m": [0.0]}, {"": [1]}):
        with pytest.raises(InputError, match="expected x_m, y_m"):
            tactile_sim.TouchTable.read(_write(tmp_path, ".csv", wrong))
    with pytest.raises(InputError, match=r"column x_m of the given touches is 0\.1 in row 0"):
        tactile_sim.TouchTable.read(_write(tmp_path, ".csv", {"x_mm": [100.0], "y_mm": [0.0]}))


def test_a_round_has_the_given_touches():
    solid = tactile_sim.Pressable.of(block())
    plan = tactile_sim.TouchPlan(positions="given", touch_table=tactile_sim.TouchTable(**TABLE))
    assert (plan.rounds, plan.touches) == (2, 2)
    made = tactile_sim.plan_round(plan, solid, "train", 1, 1)
    assert made.positions_m.tolist() == [[-0.02, 0.01], [0.03, 0.0]]
    assert (made.object_poses[1] == tactile_sim.pose(0.002, -0.001, turn_rad=-0.5)).all()
    assert (made.object_poses[2] == made.object_poses[1]).all()
    # Without poses, the object lies as the plan says, and is shifted as usual.
    places = {name: TABLE[name] for name in ("x_m", "y_m")}
    given = tactile_sim.TouchPlan(3, positions="given", touch_table=tactile_sim.TouchTable(**places))
    drawn = tactile_sim.TouchPlan(3, 4)
    one, other = (tactile_sim.plan_round(each, solid, "train", 5, 2) for each in (given, drawn))
    assert (one.object_poses == other.object_poses).all()
    assert one.positions_m.tolist() == np.transpose([TABLE["x_m"], TABLE["y_m"]]).tolist()


@pytest.mark.sim
def test_a_set_holds_the_rounds_that_are_given(scenes, tmp_path):
    spec = tactile_sim.TouchSetSpec(
        optics="depth",
        plan=tactile_sim.TouchPlan(positions="given", touch_table=tactile_sim.TouchTable(**TABLE)),
    )
    manifest = tactile_sim.generate(scenes, spec, tmp_path / "out", ["train"])
    assert manifest.spec["options"]["plan"]["given"]["rows"] == 4
    rounds = realtouch.load(tmp_path / "out", "train")
    assert [(r.id, len(r.pos_in_cell)) for r in rounds] == [("0-0", 1), ("1-0", 1), ("1-1", 2)]
    touched = rounds[2].info["touched_object_pose"].position_m
    assert touched[:, :2].tolist() == [[0.001, 0.0], [0.002, -0.001]]
    unknown = {**TABLE, "object_id": [1, 1, 0, 99]}
    plan = tactile_sim.TouchPlan(positions="given", touch_table=tactile_sim.TouchTable(**unknown))
    with pytest.raises(InputError, match="touches of objects 99 are given"):
        TouchGenerator.of(scenes, tactile_sim.TouchSetSpec(optics="depth", plan=plan))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"x_m": [0.0, 0.0, 0.0, 0.2]}, "column x_m .* is 0.2 in row 3; expected metres"),
        ({"y_m": [0.0, float("nan"), 0.0, 0.0]}, "is nan in row 1"),
        ({"x_m": ["a", "b", "c", "d"]}, "expected a number for each touch"),
        ({"round": [0, 1, 2.5, 0]}, "is 2.5 in row 2; expected an integer"),
        ({"object_id": [0, -1, 0, 0]}, "is -1 in row 1"),
        ({"object_turn_rad": [0.0, np.inf, 0.0, 0.0]}, "expected radians"),
        ({"object_turn_rad": None}, "have no object_turn_rad"),
        ({"x_m": [0.0]}, "columns of lengths x_m 1, y_m 4"),
    ],
)
def test_invalid_tables_are_refused(changed, message):
    with pytest.raises(InputError, match=message):
        tactile_sim.TouchTable(**{**TABLE, **changed})


def test_invalid_files_are_refused(tmp_path):
    for name, content, message in (
        ("no.csv", None, "cannot be read"),
        ("poses.txt", b"", r"expected a file \.csv"),
        ("words.csv", b"x_m,y_m\na,0\n", "column x_m: .*'a'; expected numbers"),
        ("other.csv", b"x_m,q,p,o,n,m\n0,0,0,0,0,0\n", "its columns are x_m, q, p, o, n, m; expected x_m"),
        ("half.csv", b"x_m\n0\n", "its columns are x_m; expected"),
        ("hole.csv", b"x_m,y_m\n0.0,\n0.0,0.0\n", "row 0; expected metres"),
        ("empty.csv", b"x_m,y_m\n", "expected"),
    ):
        file = tmp_path / name
        if content is not None:
            file.write_bytes(content)
        with pytest.raises(InputError, match=message):
            tactile_sim.TouchTable.read(file)


def test_a_plan_has_given_touches_or_none():
    table = tactile_sim.TouchTable(**TABLE)
    no_table = {"positions": "given", "touch_table": [(0.0, 0.0)]}
    for values in ({"positions": "given"}, {"touch_table": table}, no_table):
        with pytest.raises(InputError, match="expected positions 'given' and a TouchTable"):
            tactile_sim.TouchPlan(**values)
