"""Shards: how a split is divided, what a record states, and more shards than five digits can count."""

from __future__ import annotations

import json
import random
from dataclasses import replace

import pytest
from hypothesis import given, strategies as st

from tactile_toolkit.cards import FolderSummary
from tactile_toolkit.cards.yaml_head import card_head, check_card, configs, head_text
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.places.split_files import parquet_paths
from tactile_toolkit.store import Manifest, ShardName, Skipped, build, decode, open_folder
from tactile_toolkit.store.manifest import ShardRecord, add_up, shard_ranges
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
def test_a_plan_refuses_shards_whose_names_cannot_be_read_back(shard):
    with pytest.raises(InputError, match=f"the file of shard {shard} would not be found again"):
        replace(toy_plan(), tasks=(ToyTask(shard, (0,)),))


def test_files_are_in_order_of_their_numbers():
    counts = (0, 1, 9, 99_999, 100_000, 1_000_000)
    names = [f"data/{ShardName('train', index, 1_000_001)}.parquet" for index in counts]
    numbered = [f"default/train/{index:04d}.parquet" for index in (*counts, 9_999, 10_000)]
    mixed = random.Random(0).sample([*names, *numbered], len(names) + len(numbered))
    in_order = [f"default/train/{index:04d}.parquet" for index in sorted((*counts, 9_999, 10_000))]
    assert parquet_paths(mixed) == [*names, *in_order]


def test_datasets_reads_the_rows_in_the_order_of_the_numbers(tmp_path):
    """`datasets` sorts the matches of a pattern as text: 100000 would come before 10001."""
    from datasets import load_dataset

    numbers = (10_000, 10_001, 99_999, 100_000)
    tasks = tuple(ToyTask(ShardName("train", number, COUNT), (10 * number,)) for number in numbers)
    folder = open_folder(str(tmp_path))
    build(folder, replace(toy_plan(), tasks=tasks, report_file=None))
    facts = FolderSummary.of(folder)
    (entry,) = configs(facts)[0]["data_files"]
    assert entry["path"] == ["data/train-?????-of-*", "data/train-??????-of-*"]
    head = card_head(facts, license="mit", pretty_name="x", task_categories=["other"], tags=["x"])
    (tmp_path / "README.md").write_text(head_text(head))
    assert check_card(folder) == []
    rows = load_dataset(str(tmp_path), split="train", cache_dir=str(tmp_path / "cache"))
    assert list(rows["id"]) == [10 * number for number in numbers]


SHARD_SIZES = {"smallest": 50, "largest": 128, "usual_shards": 16}


@given(rows=st.integers(0, 10**5), smallest=st.integers(1, 500), more=st.integers(0, 500))
def test_shards_hold_every_row_once_in_order(rows: int, smallest: int, more: int) -> None:
    shards = shard_ranges("train", rows, smallest=smallest, largest=smallest + more, usual_shards=16)
    assert [name.index for name, _ in shards] == list(range(len(shards)))
    assert all(name.count == len(shards) and len(span) > 0 for name, span in shards)
    assert [0, *(span.stop for _, span in shards)] == [*(span.start for _, span in shards), rows]


@pytest.mark.parametrize(
    ("rows", "count", "size"),
    [
        (10, 1, 10),
        (500, 10, 50),
        (1_000, 16, 63),
        (11_480, 90, 128),
        (1 << 20, 8_192, 128),  # the most shards of 128 rows
        ((1 << 20) + 1, 4_097, 256),
        (10**7, 19_532, 512),
    ],
)
def test_shards_grow_with_large_splits(rows: int, count: int, size: int) -> None:
    shards = shard_ranges("train", rows, **SHARD_SIZES)
    assert (len(shards), len(shards[0][1])) == (count, size)
    assert shards[-1][0] == ShardName.parse(f"{shards[-1][0]}.parquet")


SKIPPED = (Skipped(3, "nine", "it ends"),)
SHARD = ShardName("train", 1, 3)
WHOLE = ShardRecord(SHARD.data_path, "train", 5, 7, "a" * 64, None, SKIPPED, {"n": [1]}, 9).to_dict()


def read(values: dict[str, object]) -> ShardRecord:
    return decode(json.dumps(values).encode(), ShardRecord, "m")


def test_a_record_is_read_back() -> None:
    assert read(WHOLE).to_dict() == WHOLE


@pytest.mark.parametrize(
    "name", ["data/rows.parquet", "data/train-1-of-3.parquet", "data/train-00001-of-00003", "", "data/", "."]
)
def test_a_record_whose_file_is_not_a_shard_is_damaged(name: str) -> None:
    with pytest.raises(ValueError, match="expected a shard's name and split"):
        _ = read(WHOLE | {"file": name}).shard


@pytest.mark.parametrize("value", [None, True, -1, 2.0, "train", [], {}, 1 << 63])
@pytest.mark.parametrize("name", ["file", "split", "rows", "bytes", "sha256", "skipped", "unpacked_bytes"])
def test_a_value_of_another_type_is_named(name: str, value: object) -> None:
    if (name, value) in (("file", "train"), ("split", "train"), ("skipped", [])):
        return  # of the right type
    with pytest.raises(IntegrityError, match=rf"'m' is damaged: .*Expected .* at `\$\.{name}"):
        read(WHOLE | {name: value})


def record(split, index, statistics, skipped=()):
    return ShardRecord(
        ShardName(split, index, 2).data_path, split, 1, 10, "0" * 64, None, skipped, statistics
    )


@pytest.mark.parametrize(
    ("parts", "total"),
    [
        ([{"n": 1}, {"n": 2}], {"n": 3}),
        ([{"n": [1, 2]}, {"n": [10]}], {"n": [11, 2]}),
        ([{"deep": {"n": [1]}}, {"deep": {"m": 2.5}}, {"n": 1}], {"deep": {"n": [1], "m": 2.5}, "n": 1}),
        ([], {}),
    ],
)
def test_counts_add_up(parts, total):
    assert add_up(parts) == total


def test_a_manifest_adds_up_each_split_and_is_read_back_from_its_text():
    records = (
        record("train", 0, {"n": [1, 2]}),
        record("train", 1, {"n": [3, 4]}),
        record("test", 0, {"n": [5, 6]}),
        record("test", 1, None),
    )
    manifest = Manifest("toy", "1", {}, ("train", "test"), records)
    assert manifest.statistics() == {"train": {"n": [4, 6]}, "test": {"n": [5, 6]}}
    assert '"statistics"' in manifest.to_json()
    restored = Manifest.from_json(manifest.to_json(), "here")
    assert restored.shards == records
    assert restored.to_json() == manifest.to_json()


@pytest.mark.parametrize("second", [record("train", 0, None), record("test", 0, None)])
def test_a_shard_that_is_listed_twice_or_of_no_split_is_damage(second):
    """The statistics agree with the listed shards, but the list is wrong."""
    text = Manifest("toy", "1", {}, ("train",), (record("train", 0, None), second)).to_json()
    with pytest.raises(
        IntegrityError, match="'here' is damaged: shards: one is listed twice, or of no split"
    ):
        Manifest.from_json(text, "here")


def test_manifest_without_statistics_has_no_such_field():
    manifest = Manifest("toy", "1", {}, ("train",), (record("train", 0, None),))
    assert "statistics" not in manifest.to_json()
    assert manifest.statistics() == {}
