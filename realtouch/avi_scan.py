"""The JPEGs of any AVI, found by the headers of its chunks.

No index is used: recorders leave it out, and it may be wrong. The layout is that of Microsoft's AVI RIFF file
reference and of the OpenDML AVI file format extensions, by which files over 1 GB have several RIFF parts.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable
from fractions import Fraction

import numpy as np

from realtouch.avi import STREAM_HEADER
from tactile_toolkit.array_types import Int64

_CHUNK = struct.Struct("<4sI")
_CHUNK_BYTES = 8
_OPENED_LISTS = (b"AVI ", b"AVIX", b"hdrl", b"strl", b"movi", b"rec ")
_JPEG_CODECS = (b"MJPG", b"JPEG")
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
                raise ValueError(
                    f"an AVI that is damaged at byte {start - _CHUNK_BYTES:,}, after {slot:,} pictures; "
                    "expected a chunk inside of the file"
                )
            elif name in self._names:
                if size:
                    places.extend((start, size, slot))
                slot += 1
                if slot > most:
                    raise ValueError(f"an AVI of more than {most:,} pictures; the limit is that")
            elif name in (b"strh", b"strf"):
                self._read_header(name, bytes(read(start, min(size, STREAM_HEADER.size))))
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
        elif name == b"strh" and header[:4] == b"vids" and len(header) == STREAM_HEADER.size:
            if self._names[0]:
                raise ValueError("an AVI of several streams of pictures; expected one")
            _, codec, scale, rate = STREAM_HEADER.unpack(header)
            self._names, self.is_jpeg = names, codec.upper() in _JPEG_CODECS
            if rate:
                self.period_s = Fraction(scale, rate)
