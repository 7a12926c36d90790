"""Records of shards in manifests."""

from __future__ import annotations

import json

import pytest

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.store import ShardName, ShardRecord, Skipped, decode

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


@pytest.mark.parametrize("other", [None, True, -1, 2.0, "train", [], {}, 1 << 63])
@pytest.mark.parametrize("name", ["file", "split", "rows", "bytes", "sha256", "skipped", "unpacked_bytes"])
def test_a_value_of_another_type_is_named(name: str, other: object) -> None:
    if (name, other) in (("file", "train"), ("split", "train"), ("skipped", [])):
        return  # of the right type
    with pytest.raises(IntegrityError, match=rf"'m' is damaged: .*Expected .* at `\$\.{name}"):
        read(WHOLE | {name: other})
