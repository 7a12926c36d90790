"""Sets of more shards than five digits count: planned, written, listed, described and read back."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest

from tactile_toolkit.cards import check_card
from tactile_toolkit.cards.facts import FolderFacts, SplitFacts, card_head, configs, folder_facts, head_text
from tactile_toolkit.errors import InputError
from tactile_toolkit.places import open_place
from tactile_toolkit.places.layout import parquet_paths
from tactile_toolkit.store import DataFolder, ShardName, ShardRecord, build, inspect_job, write_manifest
from tests.tactile_toolkit.toy import ToyTask, toy_plan

COUNT = 100_001


@pytest.mark.parametrize("index", [0, 99_999, 100_000])
def test_a_name_of_any_number_of_digits_is_read_back(index):
    shard = ShardName("train", index, COUNT)
    assert ShardName.parse(f"{shard}.parquet") == shard
    assert shard.can_be_read_back


@pytest.mark.parametrize(
    "name",
    ["train-000001-of-00002", "train-00001-of-000002", "train-0001-of-00002", "train-0000\u0661-of-00002"],
)
def test_a_shard_has_one_name(name):
    assert ShardName.parse(f"{name}.parquet") is None


@pytest.mark.parametrize(
    "shard",
    [ShardName("a-b", 0, 1), ShardName("a b", 0, 1), ShardName("train", 2, 2), ShardName("train", 0, 10**12)],
)
def test_what_could_not_be_read_back_is_refused_while_planning(shard):
    with pytest.raises(InputError, match=f"shard {shard} cannot be named so that it is found again"):
        replace(toy_plan(), tasks=(ToyTask(shard, (0,)),))


def test_files_are_in_order_of_their_numbers():
    counts = (0, 1, 9, 99_999, 100_000, 1_000_000)
    names = [f"data/{ShardName('train', index, 1_000_001)}.parquet" for index in counts]
    numbered = [f"default/train/{index:04d}.parquet" for index in (*counts, 9_999, 10_000)]
    mixed = random.Random(0).sample([*names, *numbered], len(names) + len(numbered))
    found = parquet_paths(mixed)
    assert found[: len(names)] == names
    assert found[len(names) :] == [
        f"default/train/{index:04d}.parquet" for index in sorted((*counts, 9_999, 10_000))
    ]


@pytest.mark.thorough
def test_more_shards_than_five_digits_count_are_planned_and_read(tmp_path):
    """Three of the files are made; all records are there, as after a run that made them all."""
    tasks = tuple(ToyTask(ShardName("train", index, COUNT), (10 * index,)) for index in range(COUNT))
    plan = replace(toy_plan(), tasks=tasks, report_file=None)
    folder = DataFolder(str(tmp_path))
    assert len(inspect_job(folder, plan).remaining) == COUNT
    few = replace(plan, tasks=(tasks[0], *tasks[-2:]))
    made = {record.shard.index: record for record in build(folder, few).shards}
    records = [
        made.get(task.shard.index) or ShardRecord.of(task.shard, 1, 1, "0" * 64, unpacked_bytes=1)
        for task in tasks
    ]
    write_manifest(folder, plan.new_manifest().with_shards(records))
    shards = open_place(str(tmp_path)).shards("train")
    assert len(shards) == COUNT
    assert [shard.read()["id"].to_pylist() for shard in (shards[0], *shards[-2:])] == [
        [0],
        [999_990],
        [1_000_000],
    ]


def test_datasets_reads_the_rows_in_the_order_of_the_numbers(tmp_path):
    """`datasets` sorts what a pattern finds as text: 100000 would come before 10001."""
    from datasets import load_dataset

    numbers = (10_000, 10_001, 99_999, 100_000)
    tasks = tuple(ToyTask(ShardName("train", number, COUNT), (10 * number,)) for number in numbers)
    folder = DataFolder(str(tmp_path))
    build(folder, replace(toy_plan(), tasks=tasks, report_file=None))
    facts = folder_facts(folder)
    (entry,) = configs(facts)[0]["data_files"]
    assert entry["path"] == ["data/train-?????-of-*", "data/train-??????-of-*"]
    head = card_head(facts, license="mit", pretty_name="x", task_categories=["other"], tags=["x"])
    (tmp_path / "README.md").write_text(head_text(head))
    assert check_card(folder) == []
    rows = load_dataset(str(tmp_path), split="train", cache_dir=str(tmp_path / "cache"))
    assert list(rows["id"]) == [10 * number for number in numbers]


def test_files_of_others_are_not_taken_for_those_that_several_patterns_find():
    paths = ("data/train-00000-of-100001.parquet", "data/train-100000-of-100001.parquet")
    facts = FolderFacts((SplitFacts("train", (), paths, 2, 0, 0),), None)
    patterns = ["data/train-?????-of-*", "data/train-??????-of-*"]
    assert configs(facts, ["data/notes.md"])[0]["data_files"][0]["path"] == patterns
    mixed = configs(facts, ["data/train-00000-of-00009.parquet"])
    assert mixed[0]["data_files"][0]["path"] == list(paths)
