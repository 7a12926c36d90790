"""Reading without a writable cache: every row, in bounded memory, without needless decoding."""

from __future__ import annotations

import os
import threading
import warnings
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tactile_toolkit.cache import CACHE_VARIABLE
from tactile_toolkit.read import Shard, ShardedTable, shard as shard_module
from tactile_toolkit.read.shard import BLOCKS

ROWS_PER_BLOCK, BLOCKS_PER_GROUP = 100, 6


@pytest.fixture
def shard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Shard:
    """Two row groups of 600 rows, in blocks of 100 each."""
    path = tmp_path / "train-00000-of-00001.parquet"
    values = np.random.default_rng(0).normal(size=(1_200, 20))
    table = pa.table({"id": np.arange(1_200), "values": pa.array(list(values), pa.list_(pa.float64()))})
    pq.write_table(table, path, row_group_size=600, use_dictionary=False)
    size_bytes = Shard(str(path)).metadata.row_group(0).total_byte_size
    monkeypatch.setattr(shard_module, "_BLOCK_BYTES", size_bytes // BLOCKS_PER_GROUP + 1)
    made = Shard(str(path))
    assert list(made.block_rows) == [ROWS_PER_BLOCK] * 2
    return made


@pytest.fixture
def no_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the cache folder by a file, and allow memory for three blocks."""
    (tmp_path / "taken").write_text("")
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "taken"))
    monkeypatch.setattr(BLOCKS, "limit", 3 << 20)  # blocks count at least 1 MiB
    BLOCKS.clear()


@pytest.fixture
def decoded(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return the first rows of the blocks that are decoded."""
    first_rows, blocks = [], Shard.blocks

    def counted(self: Shard, index: int, columns: list[str] | None = None):
        for group in blocks(self, index, columns):
            first_rows.append(group.first_row)
            yield group

    monkeypatch.setattr(Shard, "blocks", counted)
    return first_rows


def given_up(shard: Shard) -> ShardedTable:
    """Return rows after the cache was tried and given up."""
    table = ShardedTable((shard,))
    with pytest.warns(RuntimeWarning, match="cannot be kept"):
        table.locate(0)
    BLOCKS.clear()
    return table


def test_every_row_is_read_in_bounded_memory_after_one_warning(shard: Shard, no_cache: None) -> None:
    table = ShardedTable((shard,))
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        order = [*range(1_200), *np.random.default_rng(1).permutation(1_200)[:60].tolist()]
        for row in order:
            group, place = table.locate(row)
            assert group.flat("id")[place] == row
            assert len(BLOCKS) <= 3
    (only,) = [str(entry.message) for entry in warned]
    assert f"'{os.environ[CACHE_VARIABLE]}/blocks' cannot be written: Not a directory" in only


def test_a_pass_over_blocks_in_memory_decodes_each_once(shard, no_cache, decoded, monkeypatch):
    table = given_up(shard)
    monkeypatch.setattr(BLOCKS, "limit", 8 << 20)
    decoded.clear()
    for row in range(1_200):
        for _ in range(2):
            table.locate(row)
    assert decoded == list(range(0, 1_200, ROWS_PER_BLOCK))


def test_threads_get_the_rows_that_they_ask_for(shard: Shard, no_cache: None) -> None:
    table, wrong = given_up(shard), []

    def look(seed: int) -> None:
        for row in np.random.default_rng(seed).integers(0, 1_200, 100).tolist():
            group, place = table.locate(row)
            if group.flat("id")[place] != row:
                wrong.append(row)

    threads = [threading.Thread(target=look, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def test_a_cache_that_is_back_is_used(shard, no_cache, tmp_path, monkeypatch):
    with pytest.warns(RuntimeWarning, match="cannot be kept"):
        assert not ShardedTable((shard,)).locate(0)[0].mapped_bytes
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "other"))
    assert ShardedTable((shard,)).locate(700)[0].mapped_bytes
