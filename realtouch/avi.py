"""Motion JPEG in an AVI: the JPEGs of a file, found by the headers of its chunks, and files of ours.

No index is used: recorders leave it out, and it may be wrong. The layout is that of Microsoft's AVI RIFF file
reference and of the OpenDML AVI file format extensions, by which files over 1 GB have several RIFF parts.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable, Sequence
from fractions import Fraction

import numpy as np

from tactile_toolkit.array_types import Int64

MAX_CLIP_FRAMES = 10_000
"""Longest clip that is read; a touch has 58 to 90 frames."""

_RIFF = struct.Struct("<4sI4s")
_CHUNK = struct.Struct("<4sI")
_CHUNK_BYTES = 8
_OPENED_LISTS = (b"AVI ", b"AVIX", b"hdrl", b"strl", b"movi", b"rec ")
_JPEG_CODECS = (b"MJPG", b"JPEG")
# Kind, codec, scale and rate, whose quotient are the frames per second.
_STREAM_HEADER = struct.Struct("<4s4s12xII")
_CODEC_OF_PICTURES = slice(16, 20)  # in the header that follows


class AviPictures:
    """Where the JPEGs of an AVI lie.

    Reads headers alone. The lists of a file that was not closed state no size, or reach beyond its end: then
    the whole pictures before its end are taken.

    Parameters
    ----------
    read : callable
        Takes a position and a number of bytes; returns these, or those before the end of the file.
    end : int
        Bytes of the file.
    most : int
        Most pictures.

    Attributes
    ----------
    starts, sizes : ndarray of int64, shape (n,)
        Position in the file and bytes of each JPEG.
    slots : ndarray of int64, shape (n,)
        Time of each, in periods; a picture that was dropped or repeated takes a period, but no bytes.
    period_s : Fraction
        Seconds; 0 if the file states none.
    is_jpeg : bool
        Whether its pictures are JPEGs; if not, none are found.
    is_cut : bool
        Whether the file ends in the middle, as that of a recorder that was killed.

    Raises
    ------
    ValueError
        The file is damaged, has two streams of pictures, or too many pictures.
    """

    def __init__(self, read: Callable[[int, int], bytes | memoryview], end: int, most: int) -> None:
        self._read, self._streams, self._names = read, 0, (b"", b"")
        self.period_s, self.is_jpeg, self.is_cut = Fraction(0), False, False
        places, position, riff_end, slot = array("q"), 0, end, 0
        while position + _CHUNK_BYTES <= end:
            name, size = _CHUNK.unpack(read(position, _CHUNK_BYTES))
            start = position + _CHUNK_BYTES
            position = start + size + size % 2
            if name in (b"RIFF", b"LIST") and bytes(read(start, 4)) in _OPENED_LISTS:
                self.is_cut |= size == 0 or start + size > end
                position = start + 4
                if name == b"RIFF":
                    riff_end = start + size
            elif start + size > end or not name.isascii() or not name.decode().isprintable():
                if self.is_cut or start > riff_end:  # what follows the file is padding
                    break
                problem = f"an AVI that is damaged at byte {start - _CHUNK_BYTES:,}, after {slot:,} pictures"
                raise ValueError(f"{problem}; expected a chunk inside of the file")
            elif name in self._names:
                if size:
                    places.extend((start, size, slot))
                slot += 1
                if slot > most:
                    raise ValueError(f"an AVI of more than {most:,} pictures; the limit is that")
            elif name in (b"strh", b"strf"):
                self._read_header(name, bytes(read(start, min(size, _STREAM_HEADER.size))))
        found = np.frombuffer(places, np.int64).reshape(-1, 3)[: len(places) * self.is_jpeg]
        self.starts: Int64 = found[:, 0].copy()
        self.sizes: Int64 = found[:, 1].copy()
        self.slots: Int64 = found[:, 2].copy()

    def __len__(self) -> int:
        return len(self.sizes)

    def _read_header(self, name: bytes, header: bytes) -> None:
        """Read what is stated of a stream; its chunks are named by its number, compressed or plain."""
        number = self._streams - (name == b"strf")
        names = (b"%02ddc" % number, b"%02ddb" % number)
        self._streams += name == b"strh"
        if name == b"strf" and names == self._names:
            self.is_jpeg |= header[_CODEC_OF_PICTURES].upper() in _JPEG_CODECS
        elif name == b"strh" and header[:4] == b"vids" and len(header) == _STREAM_HEADER.size:
            if self._names[0]:
                raise ValueError("an AVI of several streams of pictures; expected one")
            _, codec, scale, rate = _STREAM_HEADER.unpack(header)
            self._names, self.is_jpeg = names, codec.upper() in _JPEG_CODECS
            if rate:
                self.period_s = Fraction(scale, rate)


class Avi(AviPictures):
    """A clip of MJPEG frames, each of which is found alone.

    Opening raises ValueError for another container or codec; where the file is damaged, cut short or exceeds
    :data:`MAX_CLIP_FRAMES`.
    """

    def __init__(self, data: memoryview) -> None:
        name, size, kind = _RIFF.unpack_from(data) if len(data) >= _RIFF.size else (b"", 0, b"")
        if name != b"RIFF" or kind != b"AVI ":
            found = f"{len(data):,} bytes that begin with {bytes(data[:8]).hex(' ')}"
            raise ValueError(f"{found}; expected an AVI with MJPEG frames")
        super().__init__(lambda start, count: data[start : start + count], len(data), MAX_CLIP_FRAMES)
        if self.is_cut:
            found = f"an AVI cut short: {len(data):,} bytes are there"
            raise ValueError(f"{found}; expected {size + _CHUNK_BYTES:,} by its header")
        if not self.period_s or not len(self):
            raise ValueError("an AVI without an MJPEG stream; expected one")
        self.data, self.fps = data, float(1 / self.period_s)

    def frame(self, number: int) -> memoryview:
        """Return the JPEG of one frame."""
        start = int(self.starts[number])
        return self.data[start : start + int(self.sizes[number])]


def write_avi(frames: Sequence[bytes], width: int, height: int, fps: float) -> bytes:
    """Write whole JPEGs as an AVI with one MJPEG stream and an index; equal frames give equal bytes.

    ``width`` and ``height`` are in pixels, ``fps`` in frames per second.
    """
    # So that 30000/1001, the rate of NTSC, comes back exactly.
    rate = Fraction(fps).limit_denominator(1001)
    largest = max(map(len, frames), default=0)
    # 0x10 says in the header that there is an index, and in the index that a frame stands alone.
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
    # All parts are joined once: a long clip should not be in memory several times.
    paddings = [b"\0" * (len(frame) % 2) for frame in frames]
    chunk_bytes = [
        _CHUNK_BYTES + len(frame) + len(rest) for frame, rest in zip(frames, paddings, strict=True)
    ]
    offsets = np.cumsum([4, *chunk_bytes])[:-1]  # from the name of the list, as FFmpeg counts them
    entries = [
        struct.pack("<4s3I", b"00dc", 0x10, offset, len(frame))
        for offset, frame in zip(offsets.tolist(), frames, strict=True)
    ]
    index = _chunk(b"idx1", b"".join(entries))
    movie_bytes = 4 + sum(chunk_bytes)
    parts = [header, _CHUNK.pack(b"LIST", movie_bytes), b"movi"]
    for frame, rest in zip(frames, paddings, strict=True):
        parts += (_CHUNK.pack(b"00dc", len(frame)), frame, rest)
    size = 4 + len(header) + _CHUNK_BYTES + movie_bytes + len(index)
    return b"".join([_RIFF.pack(b"RIFF", size, b"AVI "), *parts, index])


def _chunk(name: bytes, content: bytes) -> bytes:
    # RIFF fills chunks up to an even length, which their size does not count.
    return name + struct.pack("<I", len(content)) + content + b"\0" * (len(content) % 2)
