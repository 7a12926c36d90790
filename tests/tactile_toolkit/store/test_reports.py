"""The report over all shards: the same bytes for any source of its rows, a few at a time."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.read import Shard
from tactile_toolkit.store import build, open_folder, parquet
from tactile_toolkit.store.parquet import ParquetStyle, merge_reports
from tests.tactile_toolkit.toy import folder_bytes, toy_plan

REPORT = "reports/toy.parquet"


@pytest.fixture(autouse=True)
def small_row_groups(monkeypatch):
    """Shards extend over several row groups, as in large sets."""
    monkeypatch.setattr(parquet, "REPORT_STYLE", ParquetStyle(rows_per_group=3))


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    build(open_folder(str(tmp_path / "whole")), toy_plan())
    return tmp_path / "whole"


@pytest.mark.parametrize("splits", [("train", "test"), ("test", "train")])
def test_rows_come_from_the_run_before_and_from_this_one(tmp_path, whole, splits):
    folder = open_folder(str(tmp_path / "set"))
    for split in splits:
        build(folder, toy_plan((split,)))
    assert folder_bytes(tmp_path / "set") == folder_bytes(whole)
    (tmp_path / "set" / "data/train-00002-of-00004.parquet").unlink()  # made again, the others are not
    build(folder, toy_plan())
    assert folder_bytes(tmp_path / "set") == folder_bytes(whole)
    assert Counter(Shard(folder.address(REPORT)).read()["shard"].to_pylist()) == {
        **{f"train-{index:05d}-of-00004": 5 - index % 2 for index in range(4)},
        "test-00000-of-00002": 5,
        "test-00001-of-00002": 4,
    }


def test_rows_that_are_nowhere_are_named_and_the_report_stays(whole):
    folder = open_folder(str(whole))
    manifest = build(folder, toy_plan())
    before = folder_bytes(whole)
    first, *others = manifest.shards
    more = replace(manifest, files={}, shards=(msgspec.structs.replace(first, rows=first.rows + 1), *others))
    with pytest.raises(IntegrityError, match=r"holds 5 rows of shard train-00000-of-00004, expected 6"):
        merge_reports(folder, REPORT, more)
    assert folder_bytes(whole) == before
    assert len(Shard(folder.address(REPORT)).read(["id"])) == 27


def test_a_report_of_more_shards_than_the_manifest_is_put_right(tmp_path, whole):
    """A run of another split was killed between the two."""
    folder = open_folder(str(tmp_path / "set"))
    build(folder, toy_plan(("train",)))
    before = folder_bytes(tmp_path / "set")
    (tmp_path / "set" / REPORT).write_bytes((whole / REPORT).read_bytes())
    build(folder, toy_plan(("train",)))
    assert folder_bytes(tmp_path / "set") == before
