"""AVIs of MJPEG as cameras and programs write them: each JPEG found by the headers of the chunks alone.

No index is used: recorders leave it out, and it may be wrong. What is read follows Microsoft's AVI RIFF file
reference and the OpenDML AVI file format extensions, by which files over 1 GB have several RIFF parts.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import IO

import numpy as np

from realtouch.video_files import MAX_PICTURES, require_picture_size
from tactile_toolkit.array_types import Int64
from tactile_toolkit.errors import ItemError

_CHUNK = struct.Struct("<4sI")
_LIST = struct.Struct("<4sI4s")
_OPENED_LISTS = (b"RIFF", b"LIST")  # whose parts are looked at, except of those below
_PASSED_LISTS = (b"INFO", b"odml")
_JPEG_CODECS = (b"MJPG", b"JPEG")
# Kind, codec, scale and rate, whose quotient are the pictures a second.
_STREAM_HEADER = struct.Struct("<4s4s12xII")
# Width, height and codec of a stream of pictures.
_PICTURE_HEADER = struct.Struct("<4xii4x4s")
_MOST_STREAMS = 100  # whose numbers have two digits
_MOST_HZ = 1_000_000
_MOST_PERIOD_S = 86_400


@dataclass(frozen=True, eq=False)
class AviPictures:
    """Where the JPEGs of an AVI lie.

    Attributes
    ----------
    starts, sizes : ndarray of int64, shape (n,)
        Position in the file and bytes of each JPEG.
    slots : ndarray of int64, shape (n,)
        Time of each, in periods; a picture that was dropped leaves its period empty.
    period_s : Fraction
        Seconds.
    height : int
        Lines of a picture, as the header states them.
    is_cut : bool
        Whether the file ends in the middle, as that of a recorder that was killed.
    """

    starts: Int64
    sizes: Int64
    slots: Int64
    period_s: Fraction
    height: int
    is_cut: bool


def scan_avi(stream: IO[bytes]) -> AviPictures | None:
    """Find the JPEGs of an AVI; None if its pictures are not JPEGs.

    Reads headers alone. The lists of a file that was not closed state no size, or reach beyond its end: then
    the whole pictures before its end are taken. ItemError for any other damage, for two streams of pictures
    and for a rate that is none.
    """
    scan = _Scan(stream)
    starts, sizes, slots = array("q"), array("q"), array("q")
    slot = 0
    for name, start, size in scan.chunks():
        if name not in scan.picture_names():
            continue
        if not scan.is_jpeg:
            return None
        if size:
            starts.append(start)
            sizes.append(size)
            slots.append(slot)
        slot += 1
        if slot > MAX_PICTURES:
            raise ItemError("length", f"an AVI of more than {MAX_PICTURES:,} pictures; the limit is that")
    if scan.number is None or not scan.is_jpeg:
        return None
    at, of, when = (np.frombuffer(each, np.int64) for each in (starts, sizes, slots))
    return AviPictures(at, of, when, scan.period_s(), scan.height, scan.is_cut)


class _Scan:
    """A walk over the chunks of an AVI, and what its header states of the stream of pictures."""

    def __init__(self, stream: IO[bytes]) -> None:
        self.stream = stream
        self.end = stream.seek(0, 2)
        self.streams = 0
        self.number: int | None = None
        self.is_jpeg = False
        self.is_cut = False
        self.height = 0
        self._scale_rate = (0, 0)

    def chunks(self) -> Iterator[tuple[bytes, int, int]]:
        """Yield name, start and size of each chunk with content, in the order of the file."""
        position, pictures_seen, riff_end = 0, 0, self.end
        while position + _CHUNK.size <= self.end:
            name, size, kind = self._header(position)
            start = position + _CHUNK.size
            if name in _OPENED_LISTS:
                if size == 0 or start + size > self.end:
                    self.is_cut = True
                if name == b"RIFF":
                    riff_end = start + size
                if kind not in _PASSED_LISTS:
                    position = start + 4
                    continue
            elif not _is_name(name) or start + size > self.end:
                if self.is_cut or position >= riff_end:  # what follows the file is padding
                    return
                raise ItemError(
                    "damaged",
                    f"an AVI that is damaged at byte {position:,}, after {pictures_seen:,} pictures; "
                    "expected a chunk inside of the file",
                )
            elif name in (b"strh", b"strf"):
                self._read_header(name, start, size)
            else:
                pictures_seen += name in self.picture_names()
                yield name, start, size
            position = start + size + size % 2
        self.is_cut = self.is_cut or position < self.end

    def _header(self, position: int) -> tuple[bytes, int, bytes]:
        self.stream.seek(position)
        found = self.stream.read(_LIST.size)
        name, size = _CHUNK.unpack_from(found)
        return name, size, found[_CHUNK.size :]

    def _read_header(self, name: bytes, start: int, size: int) -> None:
        """Read what is stated of a stream."""
        self.stream.seek(start)
        found = self.stream.read(min(size, 64))
        if name == b"strh":
            self.streams += 1
            if len(found) < _STREAM_HEADER.size or found[:4] != b"vids":
                return
            if self.number is not None:
                raise ItemError("streams", "an AVI of several streams of pictures; expected one")
            _, codec, *scale_rate = _STREAM_HEADER.unpack_from(found)
            self.number, self._scale_rate = self.streams - 1, (scale_rate[0], scale_rate[1])
            self.is_jpeg = codec.upper() in _JPEG_CODECS
        elif self.number == self.streams - 1 and len(found) >= _PICTURE_HEADER.size:
            width, height, codec = _PICTURE_HEADER.unpack_from(found)
            self.is_jpeg = self.is_jpeg or codec.upper() in _JPEG_CODECS
            self.height = abs(height)
            require_picture_size(width, self.height)

    def picture_names(self) -> tuple[bytes, ...]:
        """Return how chunks of the stream of pictures are named, compressed or plain."""
        if self.number is None or self.number >= _MOST_STREAMS:
            return ()
        return b"%02ddc" % self.number, b"%02ddb" % self.number

    def period_s(self) -> Fraction:
        """Return the time from picture to picture; ItemError for none."""
        scale, rate = self._scale_rate
        if not scale or not rate or not 1 / _MOST_HZ <= scale / rate <= _MOST_PERIOD_S:
            raise ItemError("rate", f"an AVI of {rate:,} pictures in {scale:,} s; expected a rate")
        return Fraction(scale, rate)


def _is_name(name: bytes) -> bool:
    return name.isascii() and name.decode("ascii").isprintable()
