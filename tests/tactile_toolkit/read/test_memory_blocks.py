"""Reading where the cache cannot be written: every row, in bounded memory, decoded no more than it takes."""

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
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.read import parquet as rowgroups
from tactile_toolkit.read.columns import RowGroup
from tactile_toolkit.read.parquet import MemoryBlocks, Shard, ShardedTable
from tests.forked import run_forked, start_forked

BLOCK_BYTES = 80  # ten numbers of eight bytes


def memory_of(limit_bytes: int) -> MemoryBlocks:
    return MemoryBlocks(limit_bytes, lambda group: group.table.nbytes)


class Decoding:
    """Row groups of five blocks of ten numbers; counts the blocks that were decoded."""

    def __init__(self, blocks: int = 5) -> None:
        self.blocks = blocks
        self.decoded: list[int] = []

    def __call__(self):
        for number in range(self.blocks):
            self.decoded.append(number)
            yield RowGroup(pa.table({"id": np.arange(10) + 10 * number}), first_row=10 * number)


def test_a_row_group_that_fits_is_decoded_once_whatever_the_order():
    memory, decoding = memory_of(5 * BLOCK_BYTES), Decoding()
    for number in (3, 0, 4, 1, 2, 4, 0):
        assert memory.block("a", number, decoding).first_row == 10 * number
    assert decoding.decoded == [0, 1, 2, 3, 4]
    assert memory.size == 5 * BLOCK_BYTES


def test_a_pass_over_a_larger_one_decodes_each_block_once():
    memory, decoding = memory_of(2 * BLOCK_BYTES), Decoding()
    for number in range(5):
        for _ in range(3):
            assert memory.block("a", number, decoding).flat("id")[0] == 10 * number
        assert memory.size <= 2 * BLOCK_BYTES
    assert decoding.decoded == [0, 1, 2, 3, 4]
    memory.block("a", 0, decoding)
    assert decoding.decoded == [0, 1, 2, 3, 4, 0]


def test_what_was_used_longest_ago_leaves_first():
    memory = memory_of(2 * BLOCK_BYTES)
    for name in ("a", "b", "a", "c"):
        memory.block(name, 0, Decoding())
    assert memory.get(("b", 0)) is None
    assert memory.get(("a", 0)) is not None
    assert memory.get(("c", 0)) is not None


def test_one_block_larger_than_the_limit_is_kept_alone():
    memory, decoding = memory_of(1), Decoding()
    for number in (0, 0, 1, 1):
        memory.block("a", number, decoding)
    assert decoding.decoded == [0, 1]
    assert memory.size == BLOCK_BYTES


def test_a_block_that_is_not_there():
    memory = memory_of(1_000)
    with pytest.raises(IndexError, match="block 5 of 'a'; the row group has 5"):
        memory.block("a", 5, Decoding())
    assert memory.block("a", 4, Decoding()).first_row == 40


def test_threads_get_the_blocks_that_they_ask_for():
    memory, decoding = memory_of(2 * BLOCK_BYTES), Decoding()
    wrong: list[tuple[int, int]] = []

    def look(seed: int) -> None:
        for number in np.random.default_rng(seed).integers(0, 5, 200).tolist():
            first_row = memory.block("a", number, decoding).first_row
            if first_row != 10 * number:
                wrong.append((number, first_row))

    threads = [threading.Thread(target=look, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []
    assert memory.size <= 2 * BLOCK_BYTES


@pytest.fixture
def shard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Shard:
    """Two row groups of 600 rows, in blocks of 100."""
    path = tmp_path / "train-00000-of-00001.parquet"
    values = np.random.default_rng(0).normal(size=(1_200, 20))
    table = pa.table({"id": np.arange(1_200), "values": pa.array(list(values), pa.list_(pa.float64()))})
    pq.write_table(table, path, row_group_size=600, use_dictionary=False)
    size_bytes = Shard(str(path)).metadata.row_group(0).total_byte_size
    monkeypatch.setattr(rowgroups, "_BLOCK_BYTES", size_bytes // 6 + 1)
    made = Shard(str(path))
    assert list(made.block_rows) == [100, 100]
    return made


@pytest.fixture
def no_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> MemoryBlocks:
    """A cache folder whose place is taken by a file, and memory for three blocks."""
    (tmp_path / "taken").write_text("")
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "taken"))
    memory = memory_of(3 * 100 * (20 * 8 + 4 + 8) + 100)
    monkeypatch.setattr(rowgroups, "MEMORY", memory)
    return memory


def test_every_row_is_read_in_bounded_memory_after_one_warning(shard: Shard, no_cache: MemoryBlocks) -> None:
    table = ShardedTable((shard,))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        order = [*range(1_200), *np.random.default_rng(1).permutation(1_200)[:60].tolist()]
        for row in order:
            group, place = table.locate(row)
            assert group.flat("id")[place] == row
            assert no_cache.size <= no_cache.limit
    (only,) = [str(entry.message) for entry in told]
    assert f"'{os.environ[CACHE_VARIABLE]}/blocks' cannot be written: Not a directory" in only
    assert len(table._groups) == 0


def test_a_pass_decodes_every_row_group_once(shard: Shard, no_cache: MemoryBlocks) -> None:
    table, decoded = ShardedTable((shard,)), []
    blocks = Shard.blocks

    def counted(self: Shard, index: int, columns: list[str] | None = None):
        decoded.append(index)
        yield from blocks(self, index, columns)

    with pytest.warns(RuntimeWarning, match="cannot be kept"):
        table.locate(0)  # here the file is tried, and given up
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Shard, "blocks", counted)
        for row in range(1_200):
            table.locate(row)
    assert decoded == [1]


def test_a_cache_that_is_back_is_used(
    shard: Shard, no_cache: MemoryBlocks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.warns(RuntimeWarning, match="cannot be kept"):
        assert not ShardedTable((shard,)).locate(0)[0].mapped_bytes
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "other"))
    assert ShardedTable((shard,)).locate(700)[0].mapped_bytes


def test_damage_is_told_as_damage(shard: Shard, no_cache: MemoryBlocks) -> None:
    content = bytearray(Path(shard.path).read_bytes())
    content[2_000:60_000] = bytes(58_000)
    Path(shard.path).write_bytes(content)
    with pytest.warns(RuntimeWarning, match="cannot be kept"), pytest.raises(IntegrityError, match="damaged"):
        ShardedTable((Shard(shard.path),)).locate(5)


FULL_DISK = """
    import resource, signal, sys, warnings
    from tactile_toolkit.read.parquet import Shard, ShardedTable
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, resource.RLIM_INFINITY))
    warnings.simplefilter("always")
    table = ShardedTable((Shard(sys.argv[1]),))
    for row in range(1_200):
        group, place = table.locate(row)
        assert group.flat("id")[place] == row
"""


def test_a_full_disk(shard: Shard, tmp_path: Path) -> None:
    """A real limit on file size stands for a full disk: the kernel refuses the write half way."""
    done = start_forked(FULL_DISK, shard.path, **{CACHE_VARIABLE: str(tmp_path / "cache")})
    assert done.end() == 0, done.err
    assert done.err.count("RuntimeWarning") == 1
    assert "cannot be written: File too large" in done.err
    assert list((tmp_path / "cache").rglob("*.arrow")) == []


def test_a_forked_process_starts_anew() -> None:
    code = """
        import os, pyarrow as pa
        from tactile_toolkit.read.columns import RowGroup
        from tactile_toolkit.read.parquet import MEMORY
        def decode():
            yield RowGroup(pa.table({"id": [1]}))
        MEMORY.block("a", 0, decode)
        MEMORY._lock.acquire()
        child = os.fork()
        if child == 0:
            os._exit(0 if MEMORY.size == 0 and MEMORY.block("a", 0, decode).mapped_bytes == 0 else 1)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        assert MEMORY.get(("a", 0)) is not None
    """
    run_forked(code)
