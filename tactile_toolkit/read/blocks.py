"""Blocks of rows that lie unpacked in the cache: one file each, checked, then mapped into memory.

A file holds an Arrow stream and the checksum of that. A disk may change what it holds, and a file of another
program may bear the name of one of ours: neither is served.
"""

from __future__ import annotations

import io
import os
import struct
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from tactile_toolkit.bounds import cache_limit_bytes
from tactile_toolkit.cache import DiskCache, MemoryCache, cache_folder
from tactile_toolkit.read.columns import RowGroup
from tactile_toolkit.run.system import locked
from tactile_toolkit.store.files import of_the_process

Key = tuple[str, int, int]
"""Digest of what identifies the file, row group, and number of the block in it."""

_END = struct.Struct("<Q8s")  # checksum, mark
_MARK = b"TTBLOCK2"

_HELD_BYTES = 4 << 30
_LEAST_BYTES = 1 << 20
_IN_MEMORY = 8


def _held_bytes(group: RowGroup) -> int:
    return max(_LEAST_BYTES, group.mapped_bytes or _IN_MEMORY * int(group.table.nbytes))


BLOCKS: MemoryCache[Key, RowGroup] = MemoryCache(_HELD_BYTES, _held_bytes)
"""The blocks that this process has open: 4 GiB of maps, which the system drops from memory where it needs
room, or 4,096 of them, as a process may have 65,530 maps; or 512 MiB where the cache cannot be written."""

_UNPACKED = DiskCache(
    "blocks",
    32 << 30,
    durable=False,  # its blocks have checksums: what a power cut leaves is noticed, and unpacked again
    warning="row groups cannot be kept unpacked, {problem}; what was used last stays in the memory of this "
    "process, all else is decoded again",
)

# Blocks that this process has checked, with what the file was then.
_checked: MemoryCache[str, tuple[int, ...]] = MemoryCache(1 << 16)


class _Checksummed(io.RawIOBase):
    """A stream that is written to, with the checksum of what was."""

    def __init__(self, write: Callable[[Any], int], seed: int) -> None:
        import xxhash

        super().__init__()
        self._write = write
        # Against accidents, not against forgers: 10.9 GB/s here, where CRC-32 makes 3.1 and SHA-256 1.4.
        self.digest = xxhash.xxh3_64(seed=seed)

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        self.digest.update(data)
        return self._write(data)


def _seed(file_name: str) -> int:
    """Return a number for a name: the checksum of a file that was renamed is another."""
    import xxhash

    return int(xxhash.xxh3_64_intdigest(file_name.encode()))


def _file(key: Key) -> Path:
    return _UNPACKED.path("{}-{:05d}-{:05d}.arrow".format(*key))


def is_kept(key: Key) -> bool:
    """Return whether a block lies in the cache, and note that it is used."""
    file = _file(key)
    if not file.exists():
        return False
    _UNPACKED.mark_used(file)
    return True


def can_keep() -> bool:
    """Return whether blocks can be written into the cache, as far as is known."""
    return not _UNPACKED.is_given_up


def keep(key: Key, table: Any) -> bool:
    """Write a block into the cache; return whether it is there now."""
    file = _file(key)

    def fill(stream: IO[bytes]) -> None:
        write_block(stream, file.name, table)

    # Each time: a notebook may set the variable at any time.
    _UNPACKED.limit_bytes = cache_limit_bytes()
    return file.exists() or _UNPACKED.write(file.name, int(table.nbytes), fill)


def write_block(stream: IO[bytes], file_name: str, table: Any) -> None:
    """Write a table, of one chunk per column, as the content of a file of that name."""
    import pyarrow as pa

    block = _Checksummed(stream.write, _seed(file_name))
    with pa.ipc.new_stream(block, table.schema) as writer:
        writer.write_table(table)
    stream.write(_END.pack(block.digest.intdigest(), _MARK))


def mapped(key: Key) -> tuple[Any, int] | None:
    """Map a block of the cache as :func:`map_block`; None when it is not there, or damaged: then it goes."""
    file = _file(key)
    try:
        found = map_block(file)
    except FileNotFoundError:
        return None
    except (ValueError, OSError) as error:
        if of_the_process(error) is None:
            _UNPACKED.drop(file)
        return None
    _UNPACKED.mark_used(file)
    return found


def map_block(path: Path) -> tuple[Any, int]:
    """Map a block into memory, without a copy; its checksum is compared once in each process.

    Returns the table and how many bytes are mapped. Nothing is mapped of a file that was cut: what lies
    behind its end would end the process. The toolkit makes such files under another name and removes them,
    which leaves maps valid, and never changes one. A file that another program cuts while it is mapped is
    not noticed.

    Raises OSError; ValueError when the file is not intact, or is of another program or another name.
    """
    import pyarrow as pa
    import xxhash

    with path.open("rb", buffering=0) as stream:
        # Asked first: what takes the place of the file from here on is not what was checked.
        facts = os.fstat(stream.fileno())
        size = facts.st_size - _END.size
        stream.seek(max(size, 0))
        end = stream.read()
    checksum, mark = _END.unpack(end) if len(end) == _END.size else (0, b"")
    # From the map's own buffer, still without a copy: from the map, Arrow would read in its own threads.
    stored = pa.memory_map(str(path)).read_buffer() if mark == _MARK else None
    if stored is None or len(stored) != facts.st_size:
        raise ValueError(f"{facts.st_size:,} bytes that are not a block")
    content = stored.slice(0, size)
    if _checked.get(str(path)) != stat_key(facts):
        if xxhash.xxh3_64_intdigest(content, seed=_seed(path.name)) != checksum:
            raise ValueError("the block does not match its checksum")
        _checked.put(str(path), stat_key(facts))
    return pa.Table.from_batches([pa.ipc.open_stream(content).read_next_batch()]), size


def stat_key(facts: os.stat_result) -> tuple[int, int, int, int]:
    """Return what distinguishes a file from one that took its place, or from itself with other content."""
    return facts.st_dev, facts.st_ino, facts.st_size, facts.st_mtime_ns


@contextmanager
def locked_file(digest: str) -> Iterator[None]:
    """Hold the lock of the row groups of a file, for all processes; without locks no process waits."""
    folder = cache_folder() / "locks"
    with ExitStack() as stack:
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            # 256 files for all: one each would stay in the cache for good.
            stack.enter_context(locked(folder / digest[:2]))
        yield
