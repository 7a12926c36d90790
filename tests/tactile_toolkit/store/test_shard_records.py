"""What was written of a shard, as manifests keep it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

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


VALUES = st.sampled_from(
    [
        None,
        True,
        0,
        5,
        -1,
        1 << 40,
        (1 << 40) + 1,
        1 << 63,
        2.0,
        "train",
        "",
        [],
        {},
        [1],
        {"n": [1]},
        "A" * 64,
    ]
) | st.sampled_from(
    ["b" * 64, "b" * 63, [{"id": 3, "reason": "r", "message": "m"}], "data/train-00002-of-00003.parquet"]
)


@given(
    changes=st.lists(
        st.tuples(st.integers(0, 2), st.sampled_from([*WHOLE, "statistics"]), VALUES), max_size=3
    )
)
def test_records_read_together_are_those_read_one_by_one(changes: list[tuple[int, str, object]]) -> None:
    written = [
        {**WHOLE, "file": f"data/train-{index:05d}-of-00003.parquet", "unpacked_bytes": 9}
        for index in range(3)
    ]
    for index, name, value in changes:
        written[index][name] = value
    fields = Fields({"shards": written}, "m")
    outcomes: list[object] = []
    for read in (
        lambda: ShardRecord.all_from(fields, "shards"),
        lambda: tuple(map(ShardRecord.from_fields, fields.objects("shards"))),
    ):
        try:
            outcomes.append(read())
        except IntegrityError as error:
            outcomes.append(str(error))
    assert outcomes[0] == outcomes[1]
