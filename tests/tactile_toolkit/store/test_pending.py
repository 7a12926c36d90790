from __future__ import annotations

from dataclasses import replace

import pytest

from tactile_toolkit.errors import StorageError
from tactile_toolkit.run.processes import InlineRunner
from tactile_toolkit.store.build import build
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.job import inspect_job, manifest_so_far
from tactile_toolkit.store.manifest import read_manifest
from tests.tactile_toolkit.toy import folder_bytes, toy_plan


def make(path, plan):
    return build(DataFolder(str(path)), plan, InlineRunner())


@pytest.fixture
def interrupted(tmp_path):
    """A folder with the first two of four shards of train."""
    plan = toy_plan(("train",))
    broken = replace(plan.tasks[2], error=StorageError("stop"))
    with pytest.raises(StorageError, match="stop"):
        make(tmp_path / "set", replace(plan, tasks=(*plan.tasks[:2], broken)))
    return tmp_path / "set"


def indices(manifest, split="train"):
    return [record.shard.index for record in manifest.shards_of(split)]


def test_manifest_so_far_counts_what_an_unfinished_run_finished(interrupted):
    folder = DataFolder(str(interrupted))
    assert indices(read_manifest(folder)) == []
    so_far = manifest_so_far(folder)
    assert not so_far.complete
    assert indices(so_far) == [0, 1]
    assert so_far.split_table()["train"]["rows"] == 9
    before = folder_bytes(interrupted)
    manifest_so_far(folder)
    assert folder_bytes(interrupted) == before


def test_manifest_so_far_is_the_manifest_of_a_finished_run(tmp_path):
    assert manifest_so_far(DataFolder(str(tmp_path))) is None
    manifest = make(tmp_path / "set", toy_plan())
    assert manifest_so_far(DataFolder(str(tmp_path / "set"))) == manifest


@pytest.mark.parametrize("damage", ["record cut", "record no JSON object", "file cut", "file gone"])
def test_what_no_whole_receipt_vouches_for_is_not_counted_and_made_again(interrupted, tmp_path, damage):
    record = interrupted / ".pending" / "train-00001-of-00004.json"
    file = interrupted / "data" / "train-00001-of-00004.parquet"
    if damage == "record cut":
        record.write_bytes(record.read_bytes()[:-40])
    elif damage == "record no JSON object":
        record.write_text("{}")
    elif damage == "file cut":
        file.write_bytes(file.read_bytes()[:-40])
    else:
        file.unlink()
    folder = DataFolder(str(interrupted))
    assert indices(manifest_so_far(folder)) == [0]
    assert [record.shard.index for record in inspect_job(folder, toy_plan(("train",))).finished] == [0]
    make(interrupted, toy_plan())
    make(tmp_path / "whole", toy_plan())
    assert folder_bytes(interrupted) == folder_bytes(tmp_path / "whole")


def test_finishing_one_split_costs_nothing_of_another_that_is_under_way(interrupted, tmp_path):
    manifest = make(interrupted, toy_plan(("test",)))
    assert manifest.complete, "all that it lists is there"
    assert not manifest_so_far(DataFolder(str(interrupted))).complete
    assert manifest.splits == ("test",)
    assert indices(manifest_so_far(DataFolder(str(interrupted)))) == [0, 1]
    kept = inspect_job(DataFolder(str(interrupted)), toy_plan()).finished
    assert {str(record.shard) for record in kept} == {
        *(f"train-0000{index}-of-00004" for index in range(2)),
        *(f"test-0000{index}-of-00002" for index in range(2)),
    }
    assert make(interrupted, toy_plan(("train",))).complete
    make(tmp_path / "whole", toy_plan())
    assert folder_bytes(interrupted) == folder_bytes(tmp_path / "whole")
