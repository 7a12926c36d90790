"""Data sets with more shards than five digits can count: planned, written, listed, described and read."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest

from tactile_toolkit.cards import card_head, check_card, configs, folder_summary
from tactile_toolkit.cards.yaml_head import head_text
from tactile_toolkit.errors import InputError
from tactile_toolkit.places.split_files import parquet_paths
from tactile_toolkit.store import ShardName, build, open_folder
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
def test_sets_that_could_not_be_read_back_are_refused_while_planning(shard):
    with pytest.raises(InputError, match=f"the file of shard {shard} would not be found again"):
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


def test_datasets_reads_the_rows_in_the_order_of_the_numbers(tmp_path):
    """`datasets` sorts the matches of a pattern as text: 100000 would come before 10001."""
    from datasets import load_dataset

    numbers = (10_000, 10_001, 99_999, 100_000)
    tasks = tuple(ToyTask(ShardName("train", number, COUNT), (10 * number,)) for number in numbers)
    folder = open_folder(str(tmp_path))
    build(folder, replace(toy_plan(), tasks=tasks, report_file=None))
    facts = folder_summary(folder)
    (entry,) = configs(facts)[0]["data_files"]
    assert entry["path"] == ["data/train-?????-of-*", "data/train-??????-of-*"]
    head = card_head(facts, license="mit", pretty_name="x", task_categories=["other"], tags=["x"])
    (tmp_path / "README.md").write_text(head_text(head))
    assert check_card(folder) == []
    rows = load_dataset(str(tmp_path), split="train", cache_dir=str(tmp_path / "cache"))
    assert list(rows["id"]) == [10 * number for number in numbers]
