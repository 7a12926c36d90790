"""The JPEGs of any AVI, found by the headers of its chunks.

The index is not used: some recorders leave it out, and it may be wrong. Layout: Microsoft's AVI RIFF file
reference and of the OpenDML AVI file format extensions, by which files over 1 GB have several RIFF parts.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable
from fractions import Fraction

import numpy as np

from realtouch.avi import CHUNK, CHUNK_BYTES, STREAM_HEADER
from tactile_toolkit.array_types import Int64

_OPENED_LISTS = (b"AVI ", b"AVIX", b"hdrl", b"strl", b"movi", b"rec ")
_JPEG_CODECS = (b"MJPG", b"JPEG")
_FORMAT_CODEC = slice(16, 20)  # biCompression in the stream format `strf`, a BITMAPINFOHEADER


class AviPictures:
    """Positions and sizes of the JPEGs of an AVI.

    Only headers are read. If a file was not closed, the sizes of its lists are 0, or reach beyond its end;
    then all complete pictures are taken.

    Parameters
    ----------
    read : callable
        Function of a position and a number of bytes; returns these bytes, fewer at the end of the file.
    end : int
        Size of the file, bytes.
    most : int
        Greatest number of pictures.

    Attributes
    ----------
    starts, sizes : ndarray of int64, shape (n,)
        Position in the file and size of each JPEG, bytes.
    slots : ndarray of int64, shape (n,)
        Time of each, in periods; a picture that was dropped or repeated takes a period, but no bytes.
    period_s : Fraction
        Time between pictures, seconds; 0 if the file does not state it.
    is_jpeg : bool
        Whether the pictures are JPEGs; if not, the arrays are empty.
    is_cut : bool
        Whether the file is truncated, for example because the recorder was killed.

    Raises
    ------
    ValueError
        The file is damaged, has two streams of pictures, or too many pictures.
    """

    def __init__(self, read: Callable[[int, int], bytes | memoryview], end: int, most: int) -> None:
        self._read = read
        self._streams = 0
        self._names = (b"", b"")
        self.period_s = Fraction(0)
        self.is_jpeg = self.is_cut = False
        places = array("q")
        position, riff_end, slot = 0, end, 0
        while position + CHUNK_BYTES <= end:
            name, size = CHUNK.unpack(read(position, CHUNK_BYTES))
            start = position + CHUNK_BYTES
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
                    f"an AVI that is damaged at byte {start - CHUNK_BYTES:,}, after {slot:,} pictures; "
                    "expected a chunk inside the file"
                )
            elif name in self._names:
                if size:
                    places.extend((start, size, slot))
                slot += 1
                if slot > most:
                    raise ValueError(f"an AVI of more than {most:,} pictures, which is the limit")
            elif name in (b"strh", b"strf"):
                self._read_header(name, bytes(read(start, min(size, STREAM_HEADER.size))))
        found = np.frombuffer(places, np.int64).reshape(-1, 3)
        if not self.is_jpeg:
            found = found[:0]
        self.starts: Int64 = found[:, 0].copy()
        self.sizes: Int64 = found[:, 1].copy()
        self.slots: Int64 = found[:, 2].copy()

    def __len__(self) -> int:
        return len(self.sizes)

    def _read_header(self, name: bytes, header: bytes) -> None:
        """Read the header (``strh``) or the format (``strf``) of a stream.

        Chunks are named by the number of their stream and ``dc`` (compressed) or ``db`` (plain pictures).
        """
        if name == b"strh":
            self._streams += 1
        number = self._streams - 1
        names = (b"%02ddc" % number, b"%02ddb" % number)
        if name == b"strf" and names == self._names:
            self.is_jpeg |= header[_FORMAT_CODEC].upper() in _JPEG_CODECS
        elif name == b"strh" and header[:4] == b"vids" and len(header) == STREAM_HEADER.size:
            if self._names[0]:
                raise ValueError("an AVI of several streams of pictures; expected one")
            _, codec, scale, rate = STREAM_HEADER.unpack(header)
            self._names, self.is_jpeg = names, codec.upper() in _JPEG_CODECS
            if rate:
                self.period_s = Fraction(scale, rate)
