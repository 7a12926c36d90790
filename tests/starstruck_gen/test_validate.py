"""Damaged rows, and folders whose run is not finished."""

from __future__ import annotations

from dataclasses import replace

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from starstruck_gen.sampling import SceneSpec
from starstruck_gen.scene import Placement, build_meshes
from starstruck_gen.scene_checks import check_content, check_scene
from starstruck_gen.scene_dataset import SceneRow, load, make_rows, scene_schema
from tactile_toolkit.mesh import Mesh, check_manifold

PUBLISHED = ["id", "label", "mesh.vertices", "mesh.faces"]


@pytest.fixture(scope="module")
def table() -> pa.Table:
    return SceneRow.table(make_rows(SceneSpec(distractors=(2, 4)), "train", 0, 0, 9), scene_schema())


def _written(table, path, change, columns=None) -> str:
    rows = table.to_pylist()
    change(rows[4])
    changed = pa.Table.from_pylist(rows, schema=table.schema)
    pq.write_table(changed.select(columns or table.column_names), path / "train-00000-of-00001.parquet")
    return str(path / "train-00000-of-00001.parquet")


def _raise_first(row, by_m=0.010):
    first = 20  # vertices of a star
    row["mesh.vertices"][:first] = [[x, y, z + by_m] for x, y, z in row["mesh.vertices"][:first]]


@pytest.mark.parametrize("columns", [None, PUBLISHED])
def test_single_object_above_the_plate_is_found(table, tmp_path, columns):
    checked = check_content(_written(table, tmp_path, _raise_first, columns))
    assert [(failure.id, checked.checked) for failure in checked.failures] == [(4, 9)]
    assert "is at z = 0.01 m; expected 0" in checked.failures[0].problem


def test_all_stand_on_the_plate_in_the_published_columns(table, tmp_path):
    checked = check_content(_written(table, tmp_path, lambda _: None, PUBLISHED))
    assert (checked.failed, checked.declared, checked.stars) == (0, False, 0)


def _turn_over(row):
    row["mesh.faces"] = [face[::-1] for face in row["mesh.faces"]]


def _lift(row):
    row["mesh.vertices"] = [[x, y, z + 0.001] for x, y, z in row["mesh.vertices"]]


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (_turn_over, "inside-out"),
        (lambda row: row["mesh.faces"].pop(), "not-manifold"),
        (_lift, "lowest point"),
        (lambda row: row.update(label=(row["label"] + 1) % 3), "an index into"),
        (lambda row: row["placements"].pop(), "one for each object"),
        (lambda row: row.update(distractor_count=5), "other objects; expected"),
        (lambda row: row["placements"][0].update(x_m=0.03), "not that of the declared objects"),
        (lambda row: row["placements"][0].update(shape="star(points=1e9)"), "points of shape 'star'"),
    ],
)
def test_a_fault_is_a_finding_of_its_scene_alone(table, tmp_path, change, problem):
    checked = check_content(_written(table, tmp_path, change))
    assert [(failure.id, checked.checked) for failure in checked.failures] == [(4, 9)]
    assert problem in checked.failures[0].problem


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    ("change", "field"),
    [
        (lambda row: row.update(label=None), "'label'"),
        (lambda row: row.update(placements=None), "'placements'"),
        (lambda row: row["placements"][1].update(shape=None), "'placements.shape'"),
        (lambda row: row["placements"].append(None), "'placements'"),
        (lambda row: row.update({"mesh.vertices": None}), "'mesh.vertices'"),
        (lambda row: row["mesh.faces"][0].__setitem__(1, None), "'mesh.faces'"),
        (lambda row: row.update(star_count=None), "'star_count'"),
    ],
)
def test_null_is_a_finding_of_its_scene_alone(table, tmp_path, change, field):
    checked = check_content(_written(table, tmp_path, change))
    assert [failure.id for failure in checked.failures] == [4]
    assert checked.failures[0].problem == f"field {field} of row 4 is null; expected a value"
    assert checked.stars > 0


def test_column_of_another_type_is_a_finding(table, tmp_path):
    words = table.set_column(1, "label", pa.array(["one"] * len(table)))
    pq.write_table(words.replace_schema_metadata(), tmp_path / "train-00000-of-00001.parquet")
    checked = check_content(tmp_path / "train-00000-of-00001.parquet")
    assert checked.failed == 9
    assert "cannot be read as a scene" in checked.failures[0].problem
    assert checked.to_dict()["declared"]


def test_cap_triangles_turned_by_rounding_are_found_although_the_solid_is_one(tmp_path):
    """No specification makes such a scene, but a data set of others may contain it."""
    (row,) = make_rows(SceneSpec(distractors=(1, 1)), "train", 0, 0, 1)
    fine = Placement("disc(segments=256)", 0.99, 0.4, 0.1, 1e-4, 0.005)
    placements = (row.placements[0], fine)
    mesh = build_meshes([placements])[0]
    turned = replace(row, placements=placements, vertices_m=mesh.vertices_m, faces=mesh.faces)
    pq.write_table(SceneRow.table([turned], scene_schema()), tmp_path / "train-00000-of-00001.parquet")
    (record,) = load(str(tmp_path))
    assert check_manifold(Mesh(record.vertices_m, record.faces)).problem is None
    assert "triangles of flat faces turned over" in check_scene(record)[0]


@pytest.mark.parametrize("overlap_m", [1e-6, 5e-3])
def test_objects_that_overlap_are_found(tmp_path, overlap_m):
    """No specification makes such a scene either."""
    (row,) = make_rows(SceneSpec(distractors=(1, 1)), "train", 0, 0, 1)
    side_m = 2**0.5 * 0.010
    pair = [Placement("box", x_m, 0.0, 0.0, 0.010, 0.005) for x_m in (0.0, side_m - overlap_m)]
    mesh = build_meshes([pair])[0]
    overlapping = replace(row, placements=tuple(pair), vertices_m=mesh.vertices_m, faces=mesh.faces)
    pq.write_table(SceneRow.table([overlapping], scene_schema()), tmp_path / "train-00000-of-00001.parquet")
    (record,) = load(str(tmp_path))
    assert check_scene(record)[0].startswith("overlap: two of 2 bodies overlap")
