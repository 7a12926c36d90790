"""Messages in the files of ROS bags: MCAP, bags of ROS 1, and databases of SQLite.

Files are read from start to end. Their indexes are not used: they may be wrong, and a recorder that was
stopped wrote none. Damaged parts are left out and counted. Sizes are compared before memory is allocated.
"""

from __future__ import annotations

import sqlite3
import struct
import sys
import weakref
import zlib
from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from tactile_toolkit import errors, store, touch
from tactile_toolkit.columns import tables

_MAX_MESSAGES = 1 << 23
_MAX_CHUNK_BYTES = 1 << 27
_MAX_EXPANSION = 200  # of the whole file, by all chunks
_MAX_HEAD_BYTES = 1 << 20  # of the names in a record
_LEAST_ROW_BYTES = 8  # of a database
_UNPACKERS = {
    "zstd": ("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd", "ZstdDecompressor"),
    "lz4": ("lz4.frame", "LZ4FrameDecompressor"),
    "bz2": ("bz2", "BZ2Decompressor"),
}
_PLAIN = ("", "none")  # methods of chunks that are not packed
_ZSTD_MARK = b"\x28\xb5\x2f\xfd"  # no message that is not packed begins so
# Numbers of records, by the specifications.
_MCAP_FOOTER, _MCAP_SCHEMA, _MCAP_CHANNEL, _MCAP_MESSAGE, _MCAP_CHUNK = 2, 3, 4, 5, 6
_ROS1_MESSAGE, _ROS1_CHUNK, _ROS1_CONNECTION = 2, 5, 7
_TABLES = """SELECT count(*) FROM sqlite_master
    WHERE type = 'table' AND name IN ('messages', 'topics') AND sql LIKE 'CREATE TABLE%'"""
_TOPICS = "SELECT id, name, type, serialization_format FROM topics"
_MESSAGES = "SELECT rowid, topic_id, timestamp, length(data) FROM messages ORDER BY rowid"
_DAMAGE = (struct.error, LookupError, ValueError)

Read = Callable[[int, int], bytes]
"""Returns bytes of a file or chunk, given their offset and number; fewer at the end."""
Location = tuple[int, int, int]
"""Number of a chunk, or -1 for the file; offset in it; size in bytes."""


class Channel(NamedTuple):
    """A topic, the type of its messages, such as ``sensor_msgs/msg/Image``, and their encoding."""

    topic: str
    kind: str
    encoding: str


class Message(NamedTuple):
    """A message: number of its channel, time of receipt in nanoseconds, location."""

    channel: int
    received_ns: int
    location: Location


class _Chunk(NamedTuple):
    """Records that are together: offset, size in the file, unpacked size, method, and checksum or 0."""

    start: int
    packed_bytes: int
    size: int
    method: str
    crc: int = 0


class BagFile:
    """An open file of records, some of which are in chunks.

    Attributes
    ----------
    channels : dict
        Channels by their numbers; complete after the last message.
    problems : Counter
        What could not be read, in words, and how often; complete after the last message.
    """

    _first = 0  # offset of the first record

    def __init__(self, folder: store.DataFolder, path: str) -> None:
        self.channels: dict[int, Channel] = {}
        self.problems = Counter[str]()
        self._stream = tables.open_source(folder, path)
        self._size = self._stream.seek(0, 2)
        weakref.finalize(self, self._stream.close)
        self._chunks: list[_Chunk] = []
        self._stated_bytes = 0
        self._unpacked: tuple[int, bytes] = (-1, b"")

    def messages(self) -> Iterator[Message]:
        """Yield the messages in the order of the file, whatever their times."""
        whole = (self._read_file, self._first, self._size, -1)
        with suppress(*_DAMAGE):
            # Topics that are stated at the end, too: the chunk that states them first may be damaged.
            deque(self._records(*whole), maxlen=0)
        for number, message in enumerate(self._walk(*whole)):
            if number == _MAX_MESSAGES:
                self.problems[f"what follows after {_MAX_MESSAGES:,} messages"] += 1
                return
            yield message

    def read(self, location: Location, most_bytes: int | None = None) -> bytes:
        """Return a message, or its first bytes; ItemError if it is too large or cannot be read."""
        chunk, start, size = location
        if size > touch.MAX_IMAGE_BYTES:
            raise errors.ItemError("message", f"a message of more than {touch.MAX_IMAGE_BYTES:,} bytes")
        size = size if most_bytes is None else min(size, most_bytes)
        return self._read_file(start, size) if chunk < 0 else self._in_chunk(chunk)[start : start + size]

    def _records(self, read: Read, start: int, stop: int, chunk: int) -> Iterator[Message | _Chunk]:
        """Yield the messages and chunks of the file, or of the chunk with a number, and note channels.

        Raises struct.error, LookupError or ValueError for a damaged record, or one that does not end.
        """
        raise NotImplementedError

    def _walk(self, read: Read, start: int, stop: int, chunk: int) -> Iterator[Message]:
        try:
            for record in self._records(read, start, stop, chunk):
                if isinstance(record, Message):
                    yield record
                elif chunk < 0:
                    available = self._size - record.start
                    if record.method in _PLAIN and available < record.packed_bytes:
                        # The recorder was stopped within the chunk.
                        record = record._replace(packed_bytes=available, size=available, crc=0)
                    self._chunks.append(record)
                    yield from self._walk_chunk(len(self._chunks) - 1)
        except _DAMAGE:
            self.problems["what follows a record that is damaged or does not end"] += 1

    def _walk_chunk(self, number: int) -> Iterator[Message]:
        self._stated_bytes += self._chunks[number].size
        try:
            if self._stated_bytes > _MAX_EXPANSION * self._size + _MAX_CHUNK_BYTES:
                raise errors.ItemError("chunk", f"a chunk beyond {_MAX_EXPANSION} times the size of the file")
            content = self._in_chunk(number)
        except errors.ItemError as error:
            self.problems[error.message] += 1
        else:
            yield from self._walk(partial(_part, content), 0, len(content), number)

    def _in_chunk(self, number: int) -> bytes:
        """Return the content of a chunk; the last one is kept."""
        if self._unpacked[0] == number:
            return self._unpacked[1]
        chunk = self._chunks[number]
        if max(chunk.packed_bytes, chunk.size) > _MAX_CHUNK_BYTES:
            raise errors.ItemError("chunk", f"a chunk of more than {_MAX_CHUNK_BYTES:,} bytes")
        self._unpacked = (-1, b"")  # frees memory
        content = self._read_file(chunk.start, chunk.packed_bytes)
        if chunk.method not in _PLAIN:
            content = _unpacked(content, chunk.method, chunk.size)
        if len(content) != chunk.size or (chunk.crc and zlib.crc32(content) != chunk.crc):
            raise errors.ItemError("chunk", "a damaged chunk")
        self._unpacked = (number, content)
        return content

    def _read_file(self, start: int, size: int) -> bytes:
        self._stream.seek(start)
        return self._stream.read(size)


def _part(content: bytes, start: int, size: int) -> bytes:
    return content[start : start + size]


def _unpacked(content: bytes, method: str, most_bytes: int) -> bytes:
    """Unpack bytes, at most one more than stated; ItemError if they are damaged."""
    if method not in _UNPACKERS:
        raise errors.ItemError("chunk", f"a chunk packed by {method[:20]!r}; expected zstd, lz4 or bz2")
    module, name = _UNPACKERS[method]
    with errors.needs_extra("reading packed ROS bags", module, "ros"):
        unpacker = getattr(import_module(module), name)()
    try:
        made: bytes = unpacker.decompress(content, max_length=most_bytes + 1)
    except Exception as error:  # each library has its own
        raise errors.ItemError("chunk", "a damaged chunk") from error
    return made


def _texts(read: Read, start: int, count: int) -> list[str]:
    """Return texts, each of which follows its length."""
    texts = []
    for _ in range(count):
        (size,) = struct.unpack("<I", read(start, 4))
        (text,) = struct.unpack(f"{size}s", read(start + 4, min(size, _MAX_HEAD_BYTES)))
        texts.append(text.decode(errors="replace"))
        start += 4 + size
    return texts


class _Mcap(BagFile):
    _first = 8

    def __init__(self, folder: store.DataFolder, path: str) -> None:
        super().__init__(folder, path)
        self._schemas: dict[int, str] = {}

    def _records(self, read: Read, start: int, stop: int, chunk: int) -> Iterator[Message | _Chunk]:
        kind = 0
        while start < stop and kind != _MCAP_FOOTER:
            kind, size = struct.unpack("<BQ", read(start, 9))
            start += 9
            if not kind or (start + size > stop and kind != _MCAP_CHUNK):
                raise ValueError
            if kind == _MCAP_MESSAGE:
                channel, _, received_ns = struct.unpack("<HIq", read(start, 14))
                yield Message(channel, received_ns, (chunk, start + 22, max(size - 22, 0)))
            elif kind == _MCAP_CHUNK:
                unpacked_bytes, crc, letters = struct.unpack("<16xQII", read(start, 32))
                (method,) = _texts(read, start + 28, 1)
                content = start + 40 + letters
                (packed_bytes,) = struct.unpack("<Q", read(content - 8, 8))
                yield _Chunk(content, packed_bytes, unpacked_bytes, method, crc)
            elif kind == _MCAP_SCHEMA:
                (number,) = struct.unpack("<H", read(start, 2))
                (self._schemas[number],) = _texts(read, start + 2, 1)
            elif kind == _MCAP_CHANNEL:
                number, schema = struct.unpack("<HH", read(start, 4))
                topic, encoding = _texts(read, start + 4, 2)
                self.channels[number] = Channel(topic, _kind_of(self._schemas.get(schema, "")), encoding)
            start += size


def _kind_of(name: str) -> str:
    """Return the name of a type with its middle part, which ROS 1 leaves out."""
    return name if name.count("/") != 1 else name.replace("/", "/msg/")


class _Ros1(BagFile):
    _first = 13

    def _records(self, read: Read, start: int, stop: int, chunk: int) -> Iterator[Message | _Chunk]:
        while start < stop:
            head, start = _fields(read, start)
            (size,) = struct.unpack("<I", read(start, 4))
            kind = head["op"][0]
            if start + 4 + size > stop and kind != _ROS1_CHUNK:
                raise ValueError
            if kind == _ROS1_MESSAGE:
                channel, seconds, nanoseconds = struct.unpack("<III", head["conn"] + head["time"])
                yield Message(channel, seconds * 10**9 + nanoseconds, (chunk, start + 4, size))
            elif kind == _ROS1_CHUNK:
                (unpacked_bytes,) = struct.unpack("<I", head["size"])
                yield _Chunk(start + 4, size, unpacked_bytes, head["compression"].decode())
            elif kind == _ROS1_CONNECTION:
                (number,) = struct.unpack("<I", head["conn"])
                stated, _ = _fields(read, start)
                topic, name = (text.decode(errors="replace") for text in (head["topic"], stated["type"]))
                self.channels[number] = Channel(topic, _kind_of(name), "ros1")
            start += 4 + size


def _fields(read: Read, start: int) -> tuple[dict[str, bytes], int]:
    """Return the fields of a header, which follows its length, and the offset of its end."""
    (size,) = struct.unpack("<I", read(start, 4))
    content = read(start + 4, min(size, _MAX_HEAD_BYTES))
    if not 0 < size == len(content):
        raise ValueError
    fields = {}
    at = 0
    while at < size:
        (length,) = struct.unpack_from("<I", content, at)
        name, _, value = content[at + 4 : at + 4 + length].partition(b"=")
        fields[name.decode(errors="replace")] = value
        at += 4 + length
    return fields, start + 4 + size


class _Database(BagFile):
    """A database, of which rows of tables are read; views may contain any program."""

    def __init__(self, folder: store.DataFolder, path: str) -> None:
        super().__init__(folder, path)
        if not folder.is_local:
            address = folder.address(path)
            raise errors.InputError(
                f"{address!r} is a bag in SQLite; expected it on a disk", next="copy it to this machine"
            )
        if (folder.info(f"{path}-wal") or {}).get("size"):
            self.problems[f"what {path}-wal holds, until a program that writes to the bag has merged it"] += 1
        uri = Path(folder.address(path)).absolute().as_uri()
        self._database = sqlite3.connect(f"{uri}?mode=ro&immutable=1", uri=True, check_same_thread=False)
        self._database.text_factory = partial(str, encoding="utf-8", errors="replace")
        self._database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, touch.MAX_IMAGE_BYTES)
        weakref.finalize(self, self._database.close)

    def messages(self) -> Iterator[Message]:
        execute = self._database.execute
        try:
            execute("PRAGMA writable_schema=ON")  # else a database that was cut is not opened
            if execute(_TABLES).fetchone() != (2,):
                self.problems["a database without the tables messages and topics"] += 1
                return
            for number, *names in execute(_TOPICS):
                self.channels[number] = Channel(*map(str, names))
            for count, row in enumerate(execute(_MESSAGES)):
                if count > self._size // _LEAST_ROW_BYTES or not all(isinstance(cell, int) for cell in row):
                    raise sqlite3.DatabaseError
                number, channel, received_ns, size = row
                yield Message(channel, received_ns, (-1, number, size))
        except sqlite3.Error:
            self.problems["what follows a damaged row"] += 1

    def _read_file(self, start: int, size: int) -> bytes:
        try:
            with self._database.blobopen("messages", "data", start, readonly=True) as blob:
                content = blob.read()
        except sqlite3.Error as error:
            raise errors.ItemError("message", "its row is damaged") from error
        if content.startswith(_ZSTD_MARK):
            content = _unpacked(content, "zstd", touch.MAX_IMAGE_BYTES)
        return content


_KINDS = {b"\x89MCAP0\r\n": _Mcap, b"#ROSBAG V2.0\n": _Ros1, b"SQLite format 3\0": _Database}


def open_bag(folder: store.DataFolder, path: str) -> BagFile:
    """Open a file of a bag; InputError if it is none."""
    with tables.open_source(folder, path) as stream:
        start = stream.read(16)
    for mark, kind in _KINDS.items():
        if start.startswith(mark):
            return kind(folder, path)
    raise errors.InputError(
        f"{folder.address(path)!r} begins with {start[:8].hex(' ')}; expected MCAP, ROS 1 or SQLite"
    )
