"""Large row groups: unpacked in blocks, found again by every process, streamed from any position."""

from __future__ import annotations

from pathlib import Path

import fsspec
import numpy as np
import pytest

import realtouch
from realtouch.touches.datasets import TouchStream
from tactile_toolkit.cache import CACHE_VARIABLE
from tactile_toolkit.read import Shard, ShardedTable, shard as shard_module
from tactile_toolkit.read.shard import BLOCKS
from tests.realtouch import factories
from tests.realtouch.factories import Layout


@pytest.fixture
def one_group(single_rows: list[dict], tmp_path: Path) -> Path:
    """Six rounds in one row group."""
    rows = [{**row, "id": f"{row['id']}{copy}"} for copy in "ab" for row in single_rows]
    return factories.write_set(tmp_path / "set", {"train": rows}, "single", Layout(group_rows=100))


@pytest.mark.parametrize("rows_per_block", [1, 2, 4, 6])
def test_blocks_read_as_one(rows_per_block: int, one_group: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = [(record.id, record.sensor_image[:]) for record in realtouch.load(one_group)]
    shard = Shard(str(next((one_group / "data").glob("*.parquet"))))
    size = shard.metadata.row_group(0).total_byte_size
    monkeypatch.setattr(shard_module, "_BLOCK_BYTES", size * rows_per_block // 6 + 1)
    monkeypatch.setenv(CACHE_VARIABLE, str(one_group / "cache"))
    BLOCKS.clear()
    dataset = realtouch.load(one_group)
    assert list(dataset.table.shards[0].block_rows) == [rows_per_block]
    for row in (5, 0, 3, 1, 4, 2):  # in any order
        record = dataset[row]
        assert (record.id, record.row.number) == (whole[row][0], row)
        np.testing.assert_array_equal(record.sensor_image[:], whole[row][1])
    assert [record.id for record in realtouch.load(one_group, streaming=True)] == [name for name, _ in whole]
    assert len(list((one_group / "cache" / "blocks").glob("*.arrow"))) == -(-6 // rows_per_block)
    assert len(dataset.touches().with_contact()) == 24


def test_streams_read_remote_files_piece_by_piece(one_group: Path) -> None:
    file = next((one_group / "data").glob("*.parquet"))
    memory = fsspec.filesystem("memory")
    memory.pipe_file("/touches/train.parquet", file.read_bytes())
    stream = TouchStream((Shard("memory://touches/train.parquet"),))
    local = realtouch.load(one_group)
    for ours, theirs in zip(stream, local, strict=True):
        assert ours.id == theirs.id
        np.testing.assert_array_equal(ours.sensor_image[2], theirs.sensor_image[2])
    assert stream.label_names == local.label_names


def test_derived_values_are_kept(one_group: Path) -> None:
    table = ShardedTable((Shard(str(next((one_group / "data").glob("*.parquet")))),))
    calls = []

    def ones(shard: Shard) -> list[np.ndarray]:
        groups = list(ShardedTable((shard,)).blocks(["label"]))
        calls.extend(group.names for group in groups)
        return [np.ones(len(group.table)) for group in groups]

    for _ in range(2):
        assert table.per_shard("ones", ones).tolist() == [1.0] * 6
    assert calls == [("label",)]
