"""Validation of data sets of others: a faulty row does not affect other rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import trimesh

from mnist3d.digit_checks import check_content
from mnist3d.digit_generation import DigitSetSpec, generate
from mnist3d.digit_options import SolidSpec
from mnist3d.sources.synthetic import SyntheticSource
from tactile_toolkit.errors import InputError

SHARD = Path("data") / "test-00000-of-00001.parquet"


@pytest.fixture(scope="module")
def rows(tmp_path_factory) -> pa.Table:
    folder = tmp_path_factory.mktemp("digits")
    generate(
        DigitSetSpec(SyntheticSource(), SolidSpec(target_vertices=2_000), limit=4), str(folder), ("test",)
    )
    return pq.ParquetFile(folder / SHARD).read().select(["id", "label", "mesh.vertices", "mesh.faces"])


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("column", ["id", "label", "mesh.vertices", "mesh.faces"])
def test_a_row_without_a_value_is_named_and_the_others_are_checked(rows, tmp_path, column):
    values = rows[column].to_pylist()
    values[2] = None
    spoilt = rows.set_column(
        rows.schema.get_field_index(column), column, pa.array(values, rows.schema.field(column).type)
    )
    (tmp_path / "data").mkdir()
    pq.write_table(spoilt, tmp_path / SHARD, row_group_size=2)
    checked = check_content(str(tmp_path))
    ids = rows["id"].to_pylist()
    ids[2] = "row 2" if column == "id" else ids[2]
    assert [item.name for item in checked.items] == [f"test {name}" for name in ids]
    assert [item.report.is_solid for item in checked.items] == [True, True, False, True]
    broken = checked.items[2]
    assert broken.report.detail
    assert broken.table_row()[:2] == (broken.name, "NO")
    assert broken.table_row()[-1] == broken.report.detail
    (unreadable,) = checked.unreadable
    assert unreadable == (f"split 'test', row 2 of {SHARD.name}: field {column!r} is null; expected a value")
    assert check_content(str(tmp_path), limit=2).failed == 0


def test_mesh_files_are_checked_in_their_unit(rows: pa.Table, tmp_path: Path) -> None:
    """As by the command; changes during reading are in the table and in JSON."""
    ball = trimesh.creation.icosphere(1, 0.01)
    torn = ball.vertices[ball.faces].reshape(-1, 3)
    torn[0] += 1e-8
    path = str(tmp_path / "ball.obj")
    trimesh.Trimesh(torn, np.arange(len(torn)).reshape(-1, 3), process=False).export(path, digits=12)
    without = check_content(path)
    assert "--unit m " in without.unreadable[0]
    (item,) = check_content(path, unit="m").items
    assert item.report.size_mm == pytest.approx((20, 20, 20), rel=0.1)
    assert item.to_dict()["notes"] == ["1 corner welded"]
    assert item.table_row()[-1] == "small-contact, 1 corner welded"
    pq.write_table(rows, tmp_path / "train.parquet")
    with pytest.raises(InputError, match="unit is for mesh files"):
        check_content(str(tmp_path / "train.parquet"), unit="m")
