"""A process that may not open further files: reads are right or refused by name, and no data are lost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tactile_toolkit.cache import CACHE_VARIABLE
from tests.forked import run_forked

CODE = """
    import os, resource, sys, warnings
    from pathlib import Path
    from tactile_toolkit.errors import InputError
    from tactile_toolkit.read import Shard, ShardedTable
    warnings.simplefilter("error")
    shards = [ShardedTable((Shard(path),)) for path in sys.argv[1:]]
    blocks = Path(os.environ["TACTILE_TOOLKIT_CACHE"]) / "blocks"

    def files():
        return {file.name: file.stat().st_ino for file in blocks.glob("*.arrow")}

    def first_id(table):
        group, index = table.locate(0)
        return group.flat("id")[index].item()

    def refused_or_right(table, expected):
        try:
            assert first_id(table) == expected
            return 0
        except InputError as error:
            assert "too many open files" in str(error).lower() and ".parquet" in str(error), str(error)
            return 1

    assert first_id(shards[0]) == 0  # everything that is needed is loaded, one block lies in the cache
    before, refused = files(), 0
    assert len(before) == 1
    resource.setrlimit(resource.RLIMIT_NOFILE, (64, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
    for free in range(6):
        taken = []
        try:
            while True:
                taken.append(os.open(os.devnull, os.O_RDONLY))
        except OSError:
            pass
        for handle in taken[:free]:
            os.close(handle)
        refused += refused_or_right(ShardedTable((Shard(sys.argv[1]),)), 0)
        refused += refused_or_right(shards[1 + free], 1 + free)
        for handle in taken[free:]:
            os.close(handle)
        assert before.items() <= files().items()
    assert refused >= 2, refused
    assert first_id(ShardedTable((Shard(sys.argv[1]),))) == 0
    assert [first_id(table) for table in shards] == list(range(len(shards)))
    assert first_id(shards[-1]) == len(shards) - 1
    assert shards[-1].locate(0)[0].mapped_bytes and shards[0].locate(0)[0].mapped_bytes
    assert before.items() < files().items()
    assert not list(blocks.glob(".writing*"))
"""


def test_blocks_and_cache_outlive_a_moment_without_handles(tmp_path: Path) -> None:
    paths = []
    for number in range(8):
        paths.append(tmp_path / f"{number}.parquet")
        pq.write_table(pa.table({"id": np.arange(number, number + 50)}), paths[-1])
    run_forked(CODE, *paths, **{CACHE_VARIABLE: str(tmp_path / "cache")})


def test_a_folder_is_not_called_damaged(tmp_path: Path) -> None:
    name = "manifest.json"
    (tmp_path / name).write_text("{}")
    code = """
        import os, resource, sys
        from tactile_toolkit.errors import ToolkitError
        from tactile_toolkit.store import open_folder
        resource.setrlimit(resource.RLIMIT_NOFILE, (32, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
        folder, taken = open_folder(sys.argv[1]), []
        folder.read_bytes(sys.argv[2])
        try:
            while True:
                taken.append(os.open(os.devnull, os.O_RDONLY))
        except OSError:
            pass
        try:
            folder.read_bytes(sys.argv[2])
        except ToolkitError as error:
            os.close(taken.pop())
            assert error.exit_code == 2, error
            assert sys.argv[2] in str(error) and "too many open files" in str(error).lower(), error
            assert folder.read_bytes(sys.argv[2]) == b"{}"
        else:
            raise AssertionError
    """
    run_forked(code, tmp_path, name)
