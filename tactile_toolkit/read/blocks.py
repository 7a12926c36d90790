"""Files of unpacked blocks: written once, mapped into memory, checked before any of it is believed.

One Arrow stream for each block, then where each lies and its checksum, then the checksum of that. A disk may
change what it holds, and a file of another program may bear the name of one of ours: neither may be served.
"""

from __future__ import annotations

import io
import os
import struct
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import IO, Any, NamedTuple

from tactile_toolkit.cache import MemoryCache

__all__ = ["MappedBlock", "identity_of", "map_block", "write_blocks"]

_MARK = b"TTBLOCK1"
_BLOCK = struct.Struct("<QQQ")  # start, size in bytes, checksum
_END = struct.Struct("<QQ8s")  # number of blocks, checksum of what lies where, mark
_ALIGNMENT = 64  # what Arrow recommends for its buffers

# Blocks that this process has checked, by file and number, with what the file was then.
_checked: MemoryCache[tuple[str, int], tuple[int, ...]] = MemoryCache(1 << 16)

# Schemas by their stored bytes: blocks share them, for to parse one takes longer than to map a block.
_schemas: MemoryCache[bytes, Any] = MemoryCache(64)


class _Checksummed(io.RawIOBase):
    """A stream that is written to, with the checksum of what was."""

    def __init__(self, write: Callable[[Any], int]) -> None:
        import xxhash

        super().__init__()
        self._write = write
        # Against accidents, not against forgers: 10.9 GB/s here, where CRC-32 makes 3.1 and SHA-256 1.4.
        self.digest = xxhash.xxh3_64()

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        self.digest.update(data)
        return self._write(data)


class MappedBlock(NamedTuple):
    """A block as a table, and how many bytes of its file it is."""

    table: Any
    size_bytes: int


def write_blocks(stream: IO[bytes], file_name: str, schema: Any, tables: Iterable[Any]) -> None:
    """Write tables of one schema, each of one chunk per column, as the blocks of a file of that name."""
    import pyarrow as pa

    entries = b""
    for table in tables:
        start, block = stream.tell(), _Checksummed(stream.write)
        with pa.ipc.new_stream(block, schema) as writer:
            writer.write_table(table)
        size = stream.tell() - start
        entries += _BLOCK.pack(start, size, block.digest.intdigest())
        stream.write(bytes(-size % _ALIGNMENT))
    stream.write(entries)
    stream.write(_END.pack(len(entries) // _BLOCK.size, _list_checksum(file_name, entries), _MARK))


def _list_checksum(file_name: str, entries: bytes) -> int:
    import xxhash

    return xxhash.xxh3_64_intdigest(file_name.encode() + b"\0" + entries)


def map_block(path: Path, number: int) -> MappedBlock:
    """Map a block into memory as a table, without a copy; its checksum is compared once in each process.

    Nothing is mapped of a file that was cut: what lies behind its end would end the process. No file of
    blocks is ever written again or cut by the toolkit, only made under another name and removed, which leaves
    maps valid. A file that another program cuts while it is mapped is not noticed.

    Raises OSError; ValueError when the file is not intact, is of another program or another name, or has
    fewer blocks.
    """
    import pyarrow as pa
    import xxhash

    with path.open("rb", buffering=0) as stream:
        # Asked first: what takes the place of the file from here on is not what was checked.
        identity = identity_of(facts := os.fstat(stream.fileno()))
        end = facts.st_size - _END.size
        stream.seek(max(end, 0))
        tail = stream.read()
        count, checksum, mark = _END.unpack(tail) if len(tail) == _END.size else (0, 0, b"")
        entries_start = end - count * _BLOCK.size
        if mark != _MARK or entries_start < 0:
            message = f"{facts.st_size:,} bytes that are not a file of blocks"
            raise ValueError(message)
        stream.seek(entries_start)
        entries = stream.read(end - entries_start)
    if _list_checksum(path.name, entries) != checksum or number >= count:
        message = f"the list of {count} blocks is damaged or of another file, or lacks block {number}"
        raise ValueError(message)
    start, size, checksum = _BLOCK.unpack_from(entries, number * _BLOCK.size)
    # From the map's own buffer, still without a copy: from the map, Arrow would read in its own threads.
    mapped = pa.memory_map(str(path)).read_buffer()
    content = memoryview(mapped)
    if len(content) != facts.st_size:
        message = f"{len(content):,} bytes where {facts.st_size:,} were a moment ago"
        raise ValueError(message)
    checked = (str(path), number)
    if _checked.get(checked) != identity:
        if xxhash.xxh3_64_intdigest(content[start : start + size]) != checksum:
            message = f"block {number} does not match its checksum"
            raise ValueError(message)
        _checked.put(checked, identity)
    return MappedBlock(_table(mapped.slice(start, size)), size)


def _table(block: Any) -> Any:
    """Read the stream of a block: the message of its schema, then that of its rows."""
    import pyarrow as pa

    reader = pa.BufferReader(block)
    head = pa.ipc.read_message(reader)
    stored = head.metadata.to_pybytes()
    schema = _schemas.get_or_make(stored, lambda: pa.ipc.read_schema(head))
    rows = pa.ipc.read_message(reader)
    if rows.type == "record batch":
        batch = pa.ipc.read_record_batch(rows, schema)
    else:  # dictionaries, as pandas stores categories
        batch = pa.ipc.open_stream(block).read_next_batch()
    return pa.Table.from_batches([batch])


def identity_of(facts: os.stat_result) -> tuple[int, ...]:
    """Return what tells a file from one that took its place, or from itself with other content."""
    return facts.st_dev, facts.st_ino, facts.st_size, facts.st_mtime_ns
