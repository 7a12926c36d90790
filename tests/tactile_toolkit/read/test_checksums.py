"""Damaged files are never served: shards are refused by name, and blocks of the cache are made again."""

from __future__ import annotations

import os
import pickle
from collections import Counter
from pathlib import Path

import fsspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from realtouch.checks.verification import has_page_checksums
from tactile_toolkit.cache import CACHE_VARIABLE
from tactile_toolkit.errors import InputError, IntegrityError, ToolkitError
from tactile_toolkit.read import Shard, ShardedTable
from tactile_toolkit.read.shard import BLOCKS, map_block, write_block
from tactile_toolkit.store import ParquetStyle, open_folder
from tests.forked import run_forked
from tests.mesh_columns import list_array

VERTICES = "mesh.vertices"
NAME = "train-00000-of-00001.parquet"
STYLE = ParquetStyle(20, encodings=((f"{VERTICES}.list.element.list.element", "BYTE_STREAM_SPLIT"),))


def rows(seed: int = 0) -> pa.Table:
    rng = np.random.default_rng(seed)
    vertices = [rng.normal(size=(50, 3)).astype(np.float32) for _ in range(60)]
    metadata = {"huggingface": '{"info": {"features": {"label": {"names": ["zero", "one"]}}}}'}
    columns = {"id": pa.array(range(60)), VERTICES: list_array(vertices, pa.float32())}
    return pa.table({**columns, "text": ["word"] * 60}).replace_schema_metadata(metadata)


@pytest.fixture
def shard_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    file = tmp_path / NAME
    file.write_bytes(STYLE.encode(rows()))
    return file


def test_blocks_are_restored_and_aligned_for_arrow(tmp_path: Path) -> None:
    """Arrow reads numbers of 8 bytes at once, which some processors do only at multiples of 8."""
    for number, count in enumerate((1, 70, 3)):
        table = pa.table({"x": pa.array(range(count), pa.int8())}, metadata={"a": "b"})
        with (tmp_path / f"{number}").open("wb") as stream:
            write_block(f"{number}", table, stream)
        mapped, size = map_block(tmp_path / f"{number}")
        assert mapped.equals(table, check_metadata=True)
        assert size < (tmp_path / f"{number}").stat().st_size
        assert mapped["x"].chunk(0).buffers()[1].address % 8 == 0


def flipped(content: bytes, offset: int, bit: int) -> bytes:
    changed = bytearray(content)
    changed[offset] ^= 1 << bit
    return bytes(changed)


def read_all(file: Path) -> pa.Table:
    shard = Shard(str(file))
    groups = range(shard.metadata.num_row_groups)
    return pa.concat_tables(block.table for group in groups for block in shard.blocks(group))


def outcome(file: Path, expected: pa.Table) -> str:
    try:
        return "right" if read_all(file).equals(expected, check_metadata=True) else "SILENT"
    except IntegrityError as error:
        return "named" if NAME in str(error) else str(error)


@pytest.mark.parametrize("part", ["file", "footer"])
def test_a_flipped_bit_is_always_found(shard_file: Path, part: str) -> None:
    """In pages by checksums of Parquet; in the footer, which holds class names and columns, by ours."""
    expected, content, rng = read_all(shard_file), shard_file.read_bytes(), np.random.default_rng(1)
    first = 0 if part == "file" else len(content) - 8 - int.from_bytes(content[-8:-4], "little")
    outcomes: Counter[str] = Counter()
    for offset, bit in zip(rng.integers(first, len(content), 300), rng.integers(8, size=300), strict=True):
        shard_file.write_bytes(flipped(content, int(offset), int(bit)))
        outcomes[outcome(shard_file, expected)] += 1
    assert outcomes.total() == outcomes["named"] + outcomes["right"], outcomes
    # Headers of pages have a few bits without meaning.
    assert outcomes["named"] >= (290 if part == "file" else 300), outcomes


def test_page_checksums_are_detected(shard_file: Path, tmp_path: Path) -> None:
    folder = open_folder(str(tmp_path))
    assert has_page_checksums(folder, NAME)
    for name, options in {
        "plain": {},
        "new": {"data_page_version": "2.0"},
        "none": {"compression": None},
    }.items():
        for checked in (True, False):
            pq.write_table(rows(), tmp_path / name, write_page_checksum=checked, **options)
            assert has_page_checksums(folder, name) is checked
    pq.write_table(rows().slice(0, 0), tmp_path / "empty")
    assert has_page_checksums(folder, "empty")  # it has no data that could be damaged


def values_of(file: Path) -> list[list[float]]:
    BLOCKS.clear()  # as in a new process
    table = ShardedTable((Shard(str(file)),))
    return [group.ragged(VERTICES)[row].ravel().tolist() for group, row in map(table.locate, range(60))]


def mutations(content: bytes, count: int) -> list[tuple[str, bytes]]:
    rng = np.random.default_rng(2)
    mutated = []
    for number in range(count):
        offset, length = int(rng.integers(len(content))), int(rng.integers(1, 5000))
        kind = ("flip", "cut", "zeros", "noise", "longer", "moved", "foreign", "empty")[number % 8]
        end = content[offset + length :]
        changed = {
            "flip": flipped(content, offset, number % 7),
            "cut": content[:offset],
            "zeros": content[:offset] + bytes(len(content[offset : offset + length])) + end,
            "noise": content[:offset] + rng.bytes(len(content[offset : offset + length])) + end,
            "longer": content + rng.bytes(length),
            "moved": content[:offset] + end,
            "foreign": b"ARROW1\0\0" + rng.bytes(length),
            "empty": b"",
        }[kind]
        mutated.append((kind, changed))
    return mutated


def test_damaged_blocks_are_made_again(shard_file: Path, tmp_path: Path) -> None:
    expected = values_of(shard_file)
    files = sorted((tmp_path / "cache" / "blocks").glob("*.arrow"))
    assert len(files) == 3
    content = files[1].read_bytes()
    for kind, changed in mutations(content, 80):
        files[1].write_bytes(changed)
        assert values_of(shard_file) == expected, kind
        assert files[1].read_bytes() == content, kind
    files[1].write_bytes(files[0].read_bytes())  # intact, but with other rows
    assert values_of(shard_file) == expected
    files[1].unlink()
    if hasattr(os, "mkfifo"):
        os.mkfifo(files[1])  # opening it would wait for a writer
    assert values_of(shard_file) == expected


@pytest.mark.thorough
def test_a_shard_that_is_cut_while_it_is_read_is_named(tmp_path: Path) -> None:
    clips = [np.random.default_rng(row).bytes(1 << 16) for row in range(2400)]
    table = pa.table({"id": range(2400), "clip": clips})
    pq.write_table(table, tmp_path / NAME, use_dictionary=False, write_batch_size=64)
    code = """
        import os, sys
        from tactile_toolkit.errors import IntegrityError
        from tactile_toolkit.read import Shard
        blocks = Shard(sys.argv[1]).blocks(0)
        assert len(next(blocks).table) < 1200
        os.truncate(sys.argv[1], 100_000)
        try:
            list(blocks)
        except IntegrityError as error:
            assert sys.argv[1] in str(error), error
        else:
            raise AssertionError
    """
    run_forked(code, tmp_path / NAME)


def replace_rows(file: Path) -> None:
    new_file = file.with_name("new")
    new_file.write_bytes(STYLE.encode(rows(1)))
    new_file.replace(file)


def test_a_file_replaced_under_an_open_set_is_refused(shard_file: Path, tmp_path: Path) -> None:
    table = ShardedTable((Shard(str(shard_file)),))
    first = table.locate(0)[0].ragged(VERTICES)[0].tolist()
    copy = pickle.dumps(table)
    replace_rows(shard_file)
    for open_table in (table, pickle.loads(copy)):
        with pytest.raises(IntegrityError, match=r"replaced or changed.*next: load the data set again"):
            open_table.locate(59)
        with pytest.raises(IntegrityError, match="replaced or changed"):
            open_table.column("id")
    assert table.locate(0)[0].ragged(VERTICES)[0].tolist() == first  # blocks that were open stay valid
    assert ShardedTable((Shard(str(shard_file)),)).locate(0)[0].ragged(VERTICES)[0].tolist() != first


def test_a_shard_replaced_before_it_was_opened_is_refused(shard_file: Path, tmp_path: Path) -> None:
    """Rows are known from the manifest, so loading has opened only the first shard."""
    second = tmp_path / "second.parquet"
    second.write_bytes(shard_file.read_bytes())
    table = ShardedTable((Shard(str(shard_file), 60), Shard(str(second), 60)))
    table.locate(0)
    replace_rows(second)
    with pytest.raises(IntegrityError, match=r"second\.parquet' was replaced or changed"):
        table.locate(60)


@pytest.mark.parametrize("local", [True, False])
@pytest.mark.parametrize(("rows", "extra_bytes", "words"), [(59, 0, "60 rows"), (60, 1, "bytes")])
def test_a_file_that_is_not_the_one_of_the_manifest_is_refused(shard_file, local, rows, extra_bytes, words):
    """This happens while a set is replaced: the manifest is new, and the shard is still the old one."""
    content = shard_file.read_bytes()
    fsspec.filesystem("memory").pipe_file(f"/stated/{NAME}", content)
    address = str(shard_file) if local else f"memory://stated/{NAME}"
    stated = len(content) + extra_bytes
    with pytest.raises(IntegrityError, match=rf"{NAME}': .*{words}; expected \d+ by the manifest; next: "):
        ShardedTable((Shard(address, rows, size_bytes=stated),)).locate(0)
    assert ShardedTable((Shard(address, 60, size_bytes=len(content)),)).locate(59)[1] == 19


def test_a_remote_file_replaced_under_an_open_set_is_refused(shard_file: Path) -> None:
    address = f"memory://replaced/{NAME}"
    store = fsspec.filesystem("memory")
    store.pipe_file(f"/replaced/{NAME}", shard_file.read_bytes())
    table = ShardedTable((Shard(address),))
    table.locate(0)
    store.pipe_file(f"/replaced/{NAME}", STYLE.encode(rows(1)))
    with pytest.raises(IntegrityError, match="replaced or changed"):
        table.locate(59)
    assert ShardedTable((Shard(address),)).locate(59)[1] == 19


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / NAME)
    with pytest.raises(IntegrityError, match="is not a file"):
        _ = Shard(str(tmp_path / NAME)).metadata


def test_a_name_that_is_not_utf_8_is_named(shard_file: Path, tmp_path: Path) -> None:
    odd = shard_file.rename(tmp_path / f"{os.fsdecode(b'a-' + bytes([255]))}.parquet")
    with pytest.raises(InputError, match="is not valid UTF-8") as caught:
        _ = Shard(str(odd)).metadata
    str(caught.value).encode()


def test_a_file_that_may_not_be_read_is_not_called_damaged(shard_file, monkeypatch):
    shard = Shard(str(shard_file))

    def refuse(path: str, _flags: int) -> int:
        raise PermissionError(13, "Permission denied", path)

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(ToolkitError, match="cannot be read: permission denied") as caught:
        _ = shard.metadata
    assert caught.value.exit_code == 2
