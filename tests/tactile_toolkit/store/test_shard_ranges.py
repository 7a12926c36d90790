"""How a split is divided into shards: all rows once, and sizes that follow from the split alone."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from tactile_toolkit.store import ShardName, shard_ranges

DIGITS = {"smallest": 50, "largest": 128, "wanted": 16}


@given(rows=st.integers(0, 10**5), smallest=st.integers(1, 500), more=st.integers(0, 500))
def test_shards_hold_every_row_once_in_order(rows: int, smallest: int, more: int) -> None:
    shards = shard_ranges("train", rows, smallest=smallest, largest=smallest + more, wanted=16)
    assert [name.index for name, _ in shards] == list(range(len(shards)))
    assert all(name.count == len(shards) and len(held) > 0 for name, held in shards)
    assert [0, *(held.stop for _, held in shards)] == [*(held.start for _, held in shards), rows]


@pytest.mark.parametrize(
    ("rows", "count", "size"),
    [
        (10, 1, 10),
        (500, 10, 50),
        (1_000, 16, 63),
        (11_480, 90, 128),
        (1 << 20, 8_192, 128),  # up to here as version 0.1.0 divided them
        ((1 << 20) + 1, 4_097, 256),
        (10**7, 19_532, 512),
    ],
)
def test_shards_grow_with_large_splits(rows: int, count: int, size: int) -> None:
    shards = shard_ranges("train", rows, **DIGITS)
    assert (len(shards), len(shards[0][1])) == (count, size)
    assert shards[-1][0] == ShardName.parse(f"{shards[-1][0]}.parquet")
