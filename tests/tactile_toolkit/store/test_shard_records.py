"""What was written of a shard, as manifests keep it."""

from __future__ import annotations

import pytest

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.store.fields import Fields
from tactile_toolkit.store.shards import ShardName, ShardRecord

WHOLE = ShardRecord(ShardName("train", 1, 3), rows=5, bytes=7, sha256="a" * 64).to_dict()


def test_a_record_is_what_was_written() -> None:
    assert ShardRecord.from_fields(Fields(WHOLE, "m")).to_dict() == WHOLE


@pytest.mark.parametrize(
    "name", ["data/rows.parquet", "data/train-1-of-3.parquet", "data/train-00001-of-00003", "", "data/", "."]
)
def test_a_record_whose_file_is_not_a_shard_is_damaged(name: str) -> None:
    with pytest.raises(IntegrityError, match="'m' is damaged, file: found"):
        ShardRecord.from_fields(Fields(WHOLE | {"file": name}, "m"))
