"""Files of videos: format by their first bytes, and limits that are checked before decoding."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import IO

import numpy as np

from tactile_toolkit import errors, store, touch
from tactile_toolkit.value_types import Float64, Int64

MAX_PICTURES = 2_000_000
"""Longest video that is read: nine hours at 60 Hz."""

CUT_SHORT = "cut short; read up to the last whole picture"
"""Note on a file that is truncated."""

TOO_LARGE = f"a picture of more than {touch.MAX_IMAGE_BYTES:,} bytes"
"""Problem of a picture that exceeds the limit."""

VIDEO_ENDINGS = (
    ".avi",
    ".flv",
    ".m4v",
    ".mkv",
    ".mov",
    ".mp4",
    ".mpeg",
    ".mpg",
    ".mts",
    ".ts",
    ".webm",
    ".wmv",
)
_START_BYTES = 1024
_IMAGE_BRANDS = (b"avif", b"avis", b"heic", b"heix", b"hevc", b"hevx", b"mif1", b"msf1")
_TOP_BOXES = (b"ftyp", b"moov", b"mdat", b"free", b"skip", b"wide", b"pnot", b"uuid", b"styp")
_TS_PACKETS = ((188, 0), (192, 4))  # bytes of a packet, and position of the sync byte in it
_TS_SEEN = 4
# Boxes of ISO/IEC 14496-12 that hold others; those that state a count, at which byte, and the largest one.
_HOLDERS = (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"edts", b"moof", b"traf")
_MAX_SAMPLES = 2 * MAX_PICTURES  # of sound, too
_COUNTS = {
    b"stsz": (8, _MAX_SAMPLES),
    b"stz2": (8, _MAX_SAMPLES),
    b"trun": (4, _MAX_SAMPLES),
    b"elst": (4, 32),  # each takes a pass over all samples
}
_RUNS = (b"stts", b"ctts")  # run lengths
_MAX_RUN_BYTES = 1 << 26
_MAX_BOXES = 1 << 20
_BOX = struct.Struct(">I4s")

ReadPictures = Callable[[IO[bytes], Iterable[int]], Iterator[bytes | errors.ItemError]]
"""Yields some pictures of the opened file, encoded, or why one cannot be read."""


def demuxer_of(start: bytes) -> str:
    """Return FFmpeg's name of the container of a file: avi, mov, matroska or mpegts.

    Empty for other containers; ``start`` are the first bytes, as :func:`read_start` returns them.
    """
    if start[:4] == b"RIFF" and start[8:12] in (b"AVI ", b"AVIX"):
        return "avi"
    if start[4:8] in _TOP_BOXES and start[8:12] not in _IMAGE_BRANDS:
        return "mov"
    if start[:4] == b"\x1a\x45\xdf\xa3":
        return "matroska"
    for size, at in _TS_PACKETS:
        marks = start[at : at + size * _TS_SEEN : size]
        if marks == b"\x47" * _TS_SEEN:
            return "mpegts"
    return ""


def read_start(stream: IO[bytes]) -> bytes:
    """Return the first bytes of a file, by which :func:`demuxer_of` recognises it."""
    stream.seek(0)
    return stream.read(_START_BYTES)


def is_video(folder: store.DataFolder, path: str) -> bool:
    """Return whether a file begins as a video or has the ending of one, so that its problem is listed."""
    if path.lower().endswith(VIDEO_ENDINGS):
        return True
    try:
        with folder.open_inside(path) as stream:
            return bool(demuxer_of(read_start(stream)))
    except errors.InputError:
        return False


def check_boxes(stream: IO[bytes]) -> bool:
    """Return whether an MP4 or MOV ends in the middle.

    Raises ItemError if its boxes state more samples than a video may have: a demuxer allocates memory for all
    samples that are stated, even in a file of a few bytes.
    """
    counts = Counter[bytes]()
    end = stream.seek(0, 2)
    position = 0
    for _ in range(_MAX_BOXES):
        stream.seek(min(position, end))  # a box may state more bytes than a file can have
        header = stream.read(16)
        if len(header) < _BOX.size:
            return position > end
        size, name = _BOX.unpack_from(header)
        start = position + _BOX.size
        if size == 1:
            size = int.from_bytes(header[8:], "big")
            start = position + 16
        position = max(start, position + size) if size else end
        stream.seek(start)
        at, limit = _COUNTS.get(name, (0, _MAX_SAMPLES))
        if name == b"cmov":
            raise errors.ItemError("packed", "a MOV whose header is compressed; expected a plain one")
        if name in _COUNTS:
            counts[name] += int.from_bytes(stream.read(at + 4)[at:], "big")
        elif name in _RUNS:
            runs = stream.read(min(position - start, _MAX_RUN_BYTES))
            counts[name] += int(np.frombuffer(runs, ">u4", len(runs) // 4)[2::2].sum(dtype=np.uint64))
        elif name in _HOLDERS:
            position = start
        if counts[name] > limit:
            raise errors.ItemError(
                "length",
                f"a video whose header states {counts[name]:,} entries in {name.decode(errors='replace')!r}; "
                f"the limit is {limit:,}",
                next="leave its sound out, or cut it into shorter ones",
            )
    raise errors.ItemError("length", f"a video of more than {_MAX_BOXES:,} boxes, which is the limit")


@dataclass(frozen=True, eq=False)
class Video:
    """A video; its pictures are numbered in the order in which they are shown.

    Attributes
    ----------
    time_s : ndarray of float64, shape (n,)
        Time of each picture, seconds from the first, increasing.
    picture_bytes : int
        Approximate size of an encoded picture in bytes.
    conversion : str
        How the pictures are converted; empty if they are taken as they are.
    read : callable
        Reads its pictures.
    """

    time_s: Float64
    picture_bytes: int
    conversion: str
    read: ReadPictures

    def __len__(self) -> int:
        return len(self.time_s)


def seconds_of(ticks: Int64, tick_s: Fraction) -> Float64:
    """Return times from the first in seconds."""
    since_first: Float64 = (ticks - ticks[0]).astype(np.float64)
    return since_first * tick_s.numerator / tick_s.denominator
