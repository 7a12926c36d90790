"""Open files and memory maps of a process that reads many shards."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tactile_toolkit.read import RecordDataset, Shard, ShardedTable
from tactile_toolkit.read.shard import BLOCKS

SHARDS, MAPS = 100, 16


def _held() -> tuple[int, int]:
    """Return the open files of this process, and maps of unpacked row groups."""
    maps = Path("/proc/self/maps").read_text().splitlines()
    return len(list(Path("/proc/self/fd").iterdir())), sum(line.endswith(".arrow") for line in maps)


@pytest.mark.thorough
@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="maps are looked up in /proc")
def test_open_files_and_maps_are_bounded_for_many_shards(tmp_path, monkeypatch):
    monkeypatch.setattr(BLOCKS, "limit", MAPS << 20)  # each counts at least 1 MiB
    monkeypatch.setenv("TACTILE_TOOLKIT_CACHE", str(tmp_path / "cache"))
    shards = []
    for index in range(SHARDS):
        shards.append(Shard(str(tmp_path / f"train-{index:05d}-of-{SHARDS:05d}.parquet"), 2))
        pq.write_table(pa.table({"id": [2 * index, 2 * index + 1]}), shards[-1].path)
    rows = RecordDataset(ShardedTable(tuple(shards)))
    most_files = most_maps = 0
    before = _held()
    for turn in range(2):
        for position, number in enumerate(np.random.default_rng(turn).permutation(2 * SHARDS).tolist()):
            assert rows[number].row.value("id") == number
            if position % 20 == 19:
                files, maps = _held()
                most_files, most_maps = max(files, most_files), max(maps, most_maps)
    assert most_files <= before[0] + 2
    assert most_maps - before[1] <= MAPS + 2
