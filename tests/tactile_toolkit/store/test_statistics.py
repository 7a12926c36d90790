from __future__ import annotations

import pytest

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.store import Manifest, ShardName, ShardRecord, add_up


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


def test_manifest_adds_up_each_split_and_survives_its_text():
    records = (
        record("train", 0, {"n": [1, 2]}),
        record("train", 1, {"n": [3, 4]}),
        record("test", 0, {"n": [5, 6]}),
        record("test", 1, None),
    )
    manifest = Manifest("toy", "1", {}, ("train", "test"), records)
    assert manifest.statistics() == {"train": {"n": [4, 6]}, "test": {"n": [5, 6]}}
    assert '"statistics"' in manifest.to_json()
    again = Manifest.from_json(manifest.to_json(), "here")
    assert again.shards == records
    assert again.to_json() == manifest.to_json()


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
