"""Blocks of row groups, unpacked once into memory-mapped Arrow files of the cache.

A file of a block holds an Arrow stream and the checksum of that. A disk may change what it holds, and a file
of another program may bear the name of one of ours: neither is served.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

import pyarrow as pa
import xxhash

from tactile_toolkit.cache import DiskCache, MemoryCache
from tactile_toolkit.read.arrow_views import table_bytes
from tactile_toolkit.read.row_group import RowGroup

Key = tuple[str, int, int]
"""Digest of what identifies the file, row group, and number of the block in it."""

_HELD_BYTES = 4 << 30
_LEAST_BYTES = 1 << 20
IN_MEMORY = 8


BLOCKS: MemoryCache[Key, RowGroup] = MemoryCache(
    _HELD_BYTES, lambda group: max(_LEAST_BYTES, group.mapped_bytes or IN_MEMORY * int(group.table.nbytes))
)
"""The blocks that this process has open: 4 GiB of maps, which the system drops from memory where it needs
room, or 4,096 of them, as a process may have 65,530 maps; or 512 MiB where the cache cannot be written."""

UNPACKED = DiskCache(
    "blocks",
    32 << 30,
    durable=False,  # its blocks have checksums: what a power cut leaves is noticed, and unpacked again
    warning="row groups cannot be kept unpacked, {problem}; what was used last stays in the memory of this "
    "process, all else is decoded again",
)
HELD_UP: set[Path] = set()  # locks that others did not release: this process does not wait for them again

# Part of the names of blocks: counted up when other types are unpacked from the same files.
LAYOUT = 2

_CHECKSUM = struct.Struct("<Q")

# Blocks that this process has checked, with what the file was then.
_checked: MemoryCache[str, tuple[int, ...]] = MemoryCache(1 << 16)


def block_file(key: Key) -> Path:
    """Return the file of a block in the cache."""
    return UNPACKED.path("{}-{:05d}-{:05d}.arrow".format(*key))


def are_kept(files: Sequence[Path]) -> bool:
    """Return whether blocks lie in the cache, and note that they are used."""
    for file in files:
        UNPACKED.mark_used(file)
    return all(file.exists() for file in files)


def write_block(file_name: str, table: Any, stream: IO[bytes]) -> None:
    """Write a table, of one chunk per column, into a stream as the content of a file of that name."""
    content = table_bytes(table)
    stream.write(content)
    stream.write(_CHECKSUM.pack(_checksum(content, file_name)))


def _checksum(content: Any, file_name: str) -> int:
    # Against accidents, not against forgers: 10.9 GB/s here, where CRC-32 makes 3.1 and SHA-256 1.4. The
    # checksum of a file that was renamed is another.
    seed = xxhash.xxh3_64_intdigest(file_name.encode())
    return int(xxhash.xxh3_64_intdigest(content, seed=seed))


def map_block(path: Path) -> tuple[Any, int]:
    """Map a block into memory, without a copy; its checksum is compared once in each process.

    Returns the table and how many bytes are mapped. The toolkit makes such files under another name and
    removes them, which leaves maps valid, and never changes one. A file that another program cuts while it is
    mapped is not noticed.

    Raises OSError; ValueError when the file is not intact, or is of another program or another name.
    """
    # Asked first: what takes the place of the file from here on is not what was checked.
    found = stat_key(path.stat())
    # The map's own buffer, still without a copy: from the map, Arrow would read in its own threads.
    stored = pa.memory_map(str(path)).read_buffer()
    size = len(stored) - _CHECKSUM.size
    if size < 0:
        raise ValueError(f"{len(stored)} bytes that are not a block")
    content = stored.slice(0, size)
    if _checked.get(str(path)) != found:
        if _CHECKSUM.pack(_checksum(content, path.name)) != stored.slice(size):
            raise ValueError("the block does not match its checksum")
        _checked.put(str(path), found)
    return pa.Table.from_batches([pa.ipc.open_stream(content).read_next_batch()]), size


def stat_key(facts: os.stat_result) -> tuple[int, int, int, int]:
    """Return what distinguishes a file from one that took its place, or from itself with other content."""
    return facts.st_dev, facts.st_ino, facts.st_size, facts.st_mtime_ns
