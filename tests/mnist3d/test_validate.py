"""Checking rows of other people's data sets: what is missing in one row costs no other."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from mnist3d.make import GenerateSpec, generate
from mnist3d.solid import SolidSpec
from mnist3d.sources.synthetic import SyntheticSource
from mnist3d.validate import validate_paths

SHARD = Path("data") / "test-00000-of-00001.parquet"


@pytest.fixture(scope="module")
def rows(tmp_path_factory) -> pa.Table:
    folder = tmp_path_factory.mktemp("digits")
    generate(
        GenerateSpec(SyntheticSource(), SolidSpec(target_vertices=2_000), limit=4), str(folder), ("test",)
    )
    return pq.ParquetFile(folder / SHARD).read().select(["id", "label", "mesh.vertices", "mesh.faces"])


@pytest.mark.parametrize("column", ["id", "label", "mesh.vertices", "mesh.faces"])
def test_a_row_without_a_value_is_named_and_the_others_are_checked(rows, tmp_path, column):
    values = rows[column].to_pylist()
    values[2] = None
    spoilt = rows.set_column(
        rows.schema.get_field_index(column), column, pa.array(values, rows.schema.field(column).type)
    )
    (tmp_path / "data").mkdir()
    pq.write_table(spoilt, tmp_path / SHARD, row_group_size=2)
    (checked,) = validate_paths([str(tmp_path)])
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
    assert validate_paths([str(tmp_path)], limit=2)[0].failed == 0
