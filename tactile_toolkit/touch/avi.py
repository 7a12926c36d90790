"""Finding the frames of an AVI through its index, so that one frame costs one JPEG.

Only what the clips of touches use is read: RIFF with one video stream of MJPEG frames and an ``idx1`` index.
Each frame stands alone. The layout is that of Microsoft's AVI RIFF file reference.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "AviIndex",
    "MAX_CLIP_BYTES",
    "MAX_CLIP_FRAMES",
    "NoIndexError",
    "find_frame",
    "read_index",
    "write_avi",
]

MAX_CLIP_FRAMES = 10_000
"""Longest clip that is read; a touch has 58 to 90 frames."""

MAX_CLIP_BYTES = 1 << 30
"""Largest encoded clip that is looked at; a touch has about 200 kB."""

_ENTRY = np.dtype("<u4")  # four of them make an entry: name of the chunk, flags, place, size
_ENTRY_BYTES = 16
_CHUNK_HEADER = struct.Struct("<4sI")
_CHUNK_HEADER_BYTES = _CHUNK_HEADER.size
_STREAM_HEADER = struct.Struct("<4s4s12xII4xI")


class NoIndexError(ValueError):
    """The file is no AVI with indexed MJPEG frames; it may be readable by other means."""


@dataclass(frozen=True, slots=True, eq=False)
class AviIndex:
    """Where the frames of a clip lie.

    Attributes
    ----------
    fps : float
        Frames per second that the file states.
    starts, sizes : ndarray of int64, shape (N,)
        First byte and number of bytes of each frame in the file.
    slots : ndarray of int64, shape (N,), or None
        Number of each frame in the file's own count, in which a repeated frame takes a slot without bytes;
        None when there are no repeated frames.
    """

    fps: float
    starts: NDArray[np.int64]
    sizes: NDArray[np.int64]
    slots: NDArray[np.int64] | None

    def __len__(self) -> int:
        return len(self.starts)

    def frame(self, data: memoryview, index: int) -> memoryview:
        """Return the bytes of one frame."""
        start = int(self.starts[index])
        return data[start : start + int(self.sizes[index])]


def read_index(data: memoryview) -> AviIndex:
    """Read the index of an AVI.

    Parameters
    ----------
    data : memoryview
        The whole file.

    Raises
    ------
    NoIndexError
        Another container or codec, or no index.
    ValueError
        The file is cut short, its index points outside of it or has frames overlap, or it exceeds
        :data:`MAX_CLIP_FRAMES` or :data:`MAX_CLIP_BYTES`.
    """
    if len(data) > MAX_CLIP_BYTES:
        message = f"a clip of {len(data):,} bytes; the limit is {MAX_CLIP_BYTES:,}"
        raise ValueError(message)
    if len(data) < 12 or bytes(data[:4]) != b"RIFF" or bytes(data[8:12]) != b"AVI ":
        message = f"{len(data):,} bytes that begin with {bytes(data[:12]).hex(' ')}; expected an AVI"
        raise NoIndexError(message)
    declared = int.from_bytes(data[4:8], "little") + _CHUNK_HEADER_BYTES
    if declared > len(data):
        message = f"an AVI cut short: {len(data):,} bytes are there; expected {declared:,} by its header"
        raise ValueError(message)
    chunks = {name: (start, size) for name, start, size in _chunks(data, 12, declared)}
    stream, fps = _video_stream(data, *_part(chunks, b"hdrl"))
    return _frames(data, stream, fps, _part(chunks, b"movi"), _part(chunks, b"idx1"))


def _part(chunks: dict[bytes, tuple[int, int]], name: bytes) -> tuple[int, int]:
    if name not in chunks:
        message = f"an AVI without {name.decode()!r}; expected an index of MJPEG frames"
        raise NoIndexError(message)
    return chunks[name]


def _chunks(data: memoryview, place: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Yield name, start and size of each chunk; a list goes by the name of its kind, its start after that."""
    while place + _CHUNK_HEADER_BYTES <= end:
        name, size = _CHUNK_HEADER.unpack_from(data, place)
        start = place + _CHUNK_HEADER_BYTES
        place = start + size + size % 2
        if start + size > end:
            message = f"an AVI whose part {name!r} ends {start + size - end:,} bytes behind its end"
            raise ValueError(message)
        if name == b"LIST" and size >= 4:
            yield bytes(data[start : start + 4]), start + 4, size - 4
        else:
            yield name, start, size


def _video_stream(data: memoryview, start: int, size: int) -> tuple[int, float]:
    """Return number and frame rate of the MJPEG stream."""
    number = -1
    for part, stream_start, stream_size in _chunks(data, start, start + size):
        if part != b"strl":
            continue
        number += 1
        fps = _frame_rate(data, stream_start, stream_size)
        if fps is not None:
            return number, fps
    message = "an AVI without an MJPEG stream; expected one"
    raise NoIndexError(message)


def _frame_rate(data: memoryview, start: int, size: int) -> float | None:
    """Return the frame rate of a stream; None when it is not one of MJPEG frames."""
    for name, place, length in _chunks(data, start, start + size):
        if name != b"strh" or length < _STREAM_HEADER.size:
            continue
        kind, codec, scale, rate, frames = _STREAM_HEADER.unpack_from(data, place)
        if kind != b"vids" or codec.upper() != b"MJPG" or not scale or not rate:
            return None
        if frames > MAX_CLIP_FRAMES:
            message = f"a clip that declares {frames:,} frames; the limit is {MAX_CLIP_FRAMES:,}"
            raise ValueError(message)
        return float(rate / scale)
    return None


def _frames(
    data: memoryview, stream: int, fps: float, movi: tuple[int, int], index: tuple[int, int]
) -> AviIndex:
    words = np.frombuffer(data, _ENTRY, index[1] // _ENTRY_BYTES * 4, index[0]).reshape(-1, 4)
    compressed, plain = (int.from_bytes(b"%02d" % stream + kind, "little") for kind in (b"dc", b"db"))
    if not (words[:, 0] == compressed).all():
        words = words[(words[:, 0] == compressed) | (words[:, 0] == plain)]
    if len(words) > MAX_CLIP_FRAMES:
        message = f"a clip of {len(words):,} frames; the limit is {MAX_CLIP_FRAMES:,}"
        raise ValueError(message)
    entries, slots = words.astype(np.int64), None
    if not entries[:, 3].all():
        slots = np.flatnonzero(entries[:, 3])
        entries = entries[slots]
    if len(entries) == 0:
        message = "an AVI whose index lists no frame"
        raise NoIndexError(message)
    starts = entries[:, 2] + (_base(data, entries[0], movi) + _CHUNK_HEADER_BYTES)
    sizes = entries[:, 3]
    _require_inside(starts, sizes, movi)
    _require_apart(starts, sizes)
    return AviIndex(fps, starts, sizes, slots)


def _base(data: memoryview, first: NDArray[np.int64], movi: tuple[int, int]) -> int:
    """Tell from where the index counts: the list of frames, or the file (writers differ)."""
    for base in (movi[0] - 4, 0):
        place = int(first[2]) + base
        if int.from_bytes(data[place : place + 4], "little") == first[0]:
            return base
    message = "an AVI whose index does not point at frames"
    raise NoIndexError(message)


def _require_inside(starts: NDArray[np.int64], sizes: NDArray[np.int64], movi: tuple[int, int]) -> None:
    if starts.min() < movi[0] or (starts + sizes).max() > movi[0] + movi[1]:
        outside = np.flatnonzero((starts < movi[0]) | (starts + sizes > movi[0] + movi[1]))
        message = f"an AVI whose frame {outside[0]} of {len(starts)} lies outside of it"
        raise ValueError(message)


def _require_apart(starts: NDArray[np.int64], sizes: NDArray[np.int64]) -> None:
    """Refuse an index that names bytes twice: a small file would decode to any amount of pixels."""
    ends = starts + sizes
    if (starts[1:] >= ends[:-1]).all():
        return
    order = np.argsort(starts, kind="stable")
    overlaps = np.flatnonzero(starts[order[1:]] < ends[order[:-1]])
    if len(overlaps):
        first, second = order[overlaps[0]], order[overlaps[0] + 1]
        message = f"an AVI whose index has frames {first} and {second} of {len(starts)} overlap"
        raise ValueError(message)


def write_avi(frames: Sequence[bytes], width: int, height: int, fps: float) -> bytes:
    """Write JPEGs as an AVI with one MJPEG stream and an index; equal frames give equal bytes.

    Parameters
    ----------
    frames : sequence of bytes
        One whole JPEG per frame.
    width, height : int
        Their size, pixels.
    fps : float
        Frames per second.
    """
    rate = Fraction(fps).limit_denominator(1001)
    largest = max(map(len, frames), default=0)
    main = struct.pack(
        "<14I", round(1e6 / fps), 0, 0, 0x10, len(frames), 0, 1, largest, width, height, 0, 0, 0, 0
    )
    stream = struct.pack(
        "<4s4sIHHIIIIIIII4H", b"vids", b"MJPG", 0, 0, 0, 0, rate.denominator, rate.numerator, 0, len(frames),
        largest, 0xFFFFFFFF, 0, 0, 0, width, height,
    )  # fmt: skip
    picture = struct.pack("<IiiHH4sIiiII", 40, width, height, 1, 24, b"MJPG", width * height * 3, 0, 0, 0, 0)
    streams = _chunk(b"LIST", b"strl" + _chunk(b"strh", stream) + _chunk(b"strf", picture))
    header = _chunk(b"LIST", b"hdrl" + _chunk(b"avih", main) + streams)
    chunks = [_chunk(b"00dc", frame) for frame in frames]
    places = np.cumsum([4, *map(len, chunks)])
    entries = [
        struct.pack("<4s3I", b"00dc", 0x10, place, len(frame))
        for place, frame in zip(places.tolist(), frames, strict=False)
    ]
    movie = _chunk(b"LIST", b"movi" + b"".join(chunks))
    return _chunk(b"RIFF", b"AVI " + header + movie + _chunk(b"idx1", b"".join(entries)))


def _chunk(name: bytes, content: bytes) -> bytes:
    return name + struct.pack("<I", len(content)) + content + b"\0" * (len(content) % 2)


_LIST = struct.Struct("<4sI4s")
_CHUNK = struct.Struct("<4sI")
_INDEX_ENTRY = struct.Struct("<4s4xII")  # name of the chunk, flags, place, size
_FRAME_NAMES = (b"00dc", b"00db")
_CODEC = slice(108, 116)  # kind and codec of the first stream, where no other list comes before it


def find_frame(data: memoryview, frame: int, count: int) -> memoryview | None:
    """Return the bytes of one frame.

    Parameters
    ----------
    data : memoryview
        The whole file.
    frame : int
        Number of the frame, from 0.
    count : int
        How many frames the clip must have.

    Returns
    -------
    memoryview or None
        None when the file is not of the plain form: another container, other counts, places outside of it.
    """
    try:
        return _find_frame(data, frame, count)
    except struct.error:  # a place behind the end
        return None


def _find_frame(data: memoryview, frame: int, count: int) -> memoryview | None:
    name, size, kind = _LIST.unpack_from(data, 0)
    end = size + _CHUNK.size
    if name != b"RIFF" or kind != b"AVI " or end > len(data) or not 0 <= frame < count:
        return None
    if bytes(data[_CODEC]).upper() != b"VIDSMJPG":
        return None
    place, movie, movie_end = _LIST.size, 0, 0
    while place + _LIST.size <= end:
        name, size, kind = _LIST.unpack_from(data, place)
        place += _CHUNK.size
        if name == b"idx1":
            break
        if name == b"LIST" and kind == b"movi":
            movie, movie_end = place, place + size
        place += size + size % 2
    if name != b"idx1" or not movie or movie_end > end or size != count * 16 or place + size > end:
        return None
    # Places count from the name of the list of frames, as FFmpeg writes them.
    name, offset, length = _INDEX_ENTRY.unpack_from(data, place + frame * 16)
    start = movie + offset + _CHUNK.size
    if name not in _FRAME_NAMES or not length or start + length > movie_end:
        return None
    if _CHUNK.unpack_from(data, movie + offset) != (name, length):
        return None
    return data[start : start + length]
