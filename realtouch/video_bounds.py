"""Limits of videos of unknown origin, checked before a demuxer or decoder sees them."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator
from typing import IO

import numpy as np

from tactile_toolkit.errors import ItemError
from tactile_toolkit.touch import MAX_IMAGE_PIXELS

MAX_PICTURES = 2_000_000
"""Longest video that is read: nine hours at 60 Hz."""

MAX_PIXELS_IN_ALL = 1 << 40
"""Most pixels of all pictures of a video: an hour of 4096 x 2160 at 30 Hz."""

MAX_DURATION_S = 1e6

_START_BYTES = 1024
_IMAGE_BRANDS = (b"avif", b"avis", b"heic", b"heix", b"hevc", b"hevx", b"mif1", b"msf1")
_TOP_BOXES = (b"ftyp", b"moov", b"mdat", b"free", b"skip", b"wide", b"pnot", b"uuid", b"styp")
_TS_PACKETS = ((188, 0), (192, 4))  # bytes of a packet, and where its mark stands in it
_TS_SEEN = 4
# Boxes of ISO/IEC 14496-12 that hold others, and those that state how many samples or edits there are, by the
# byte at which the count stands.
_HOLDERS = (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"edts", b"moof", b"traf")
_COUNTS_AT = {b"stsz": 8, b"stz2": 8, b"trun": 4, b"elst": 4}
_RUNS = (b"stts", b"ctts")  # run lengths
_MOST_RUN_BYTES = 1 << 26
_MOST_BOXES = 1 << 20
_MOST_EDITS = 1 << 10
_MOST_SAMPLES = 8 * MAX_PICTURES  # of sound, too
_BOX = struct.Struct(">I4s")


def demuxer_of(start: bytes) -> str:
    """Return FFmpeg's name for the container that a file begins as: avi, mov, matroska or mpegts.

    Empty if it is none of these; ``start`` is what :func:`read_start` returns.
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
    """Return the first bytes of a file, from which :func:`demuxer_of` tells what it is."""
    stream.seek(0)
    return stream.read(_START_BYTES)


def require_picture_size(width: int, height: int) -> None:
    """Raise ItemError for pictures without pixels, or with too many."""
    if not 0 < width * height <= MAX_IMAGE_PIXELS:
        raise ItemError(
            "size", f"pictures of {width:,} x {height:,} pixels; the limit is {MAX_IMAGE_PIXELS:,} pixels"
        )


def require_bounded_boxes(stream: IO[bytes]) -> None:
    """Raise ItemError if the boxes of an MP4 or MOV state more samples than a video may have.

    A demuxer makes room for all samples that a file of a few bytes states.
    """
    counts = Counter[bytes]()
    for name, start, size in _boxes(stream):
        if name in _COUNTS_AT:
            stream.seek(start + _COUNTS_AT[name])
            counts[name] += int.from_bytes(stream.read(4), "big")
        elif name in _RUNS:
            stream.seek(start + 8)
            found = stream.read(min(size - 8, _MOST_RUN_BYTES))
            counts[name] += int(np.frombuffer(found, ">u4", len(found) // 8 * 2)[::2].sum(dtype=np.uint64))
        elif name == b"cmov":
            raise ItemError("packed", "a MOV whose header is compressed; expected a plain one")
        limit = _MOST_EDITS if name == b"elst" else _MOST_SAMPLES
        if counts[name] > limit:
            what = f"a video whose header states {counts[name]:,} entries in {name.decode()!r}"
            raise ItemError("length", f"{what}; the limit is {limit:,}")


def _boxes(stream: IO[bytes]) -> Iterator[tuple[bytes, int, int]]:
    """Yield name, start and size of the content of each box; ItemError for more than a video has."""
    position, end = 0, stream.seek(0, 2)
    for _ in range(_MOST_BOXES):
        stream.seek(position)
        header = stream.read(16)
        if len(header) < _BOX.size:
            return
        size, name = _BOX.unpack_from(header)
        start = position + _BOX.size
        if size == 1:
            size, start = int.from_bytes(header[8:], "big"), position + 16
        elif size == 0:
            size = end - position
        yield name, start, max(0, position + size - start)
        position = start if name in _HOLDERS else max(start, position + size)
    raise ItemError("length", f"a video of more than {_MOST_BOXES:,} boxes; the limit is that")
