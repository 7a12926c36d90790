"""Videos as sequences of JPEG or PNG: their times, and any of their pictures.

The JPEGs of MJPEG stay as they are. Everything else is decoded by FFmpeg (PyAV, extra ``video``) and encoded
again (:mod:`realtouch.video.coded_video`).
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from functools import lru_cache
from typing import IO

import numpy as np

from realtouch.video import video_files
from realtouch.video.avi import CHUNK, CHUNK_BYTES, STREAM_HEADER
from tactile_toolkit import errors, store, touch
from tactile_toolkit.value_types import Int64

_MAX_HZ = 1_000_000
_MAX_PERIOD_S = 86_400
_KEPT_VIDEOS = 8

_OPENED_LISTS = (b"AVI ", b"AVIX", b"hdrl", b"strl", b"movi", b"rec ")
_JPEG_CODECS = (b"MJPG", b"JPEG")
_FORMAT_CODEC = slice(16, 20)  # biCompression in the stream format `strf`, a BITMAPINFOHEADER


def open_video(folder: store.DataFolder, path: str) -> video_files.Video:
    """Find the pictures of a video; only the first one is decoded.

    Parameters
    ----------
    folder : DataFolder
        The source.
    path : str
        Path of the file below it. What it is follows from its first bytes: AVI, MP4, MOV, Matroska, WebM or
        MPEG-TS.

    Raises
    ------
    ItemError
        The file cannot be read, is damaged, exceeds the limits of :mod:`realtouch.video.video_files`, has
        several streams of pictures, or asks to turn its pictures.
    MissingExtraError
        PyAV is needed and not installed.
    """
    return _open_video(folder.address(), path, folder.version(path))


def pictures_of_video(
    folder: store.DataFolder, path: str, numbers: Iterable[int]
) -> Iterator[bytes | errors.ItemError]:
    """Yield some pictures of a video, encoded as JPEG, or as PNG where its codec is lossless.

    Parameters
    ----------
    folder, path
        As for :func:`open_video`.
    numbers : iterable of int
        Numbers of pictures. The file is read once as long as they increase.

    Yields
    ------
    bytes or ItemError
        The picture, or why it cannot be read: it is damaged, or depends on another that is.

    Raises
    ------
    ItemError, MissingExtraError
        As :func:`open_video`.
    """
    video = open_video(folder, path)
    with folder.open_inside(path) as stream, _named_problems():
        yield from video.read(stream, numbers)


@contextmanager
def _named_problems() -> Iterator[None]:
    """Turn exceptions of FFmpeg and PyAV into ItemError."""
    try:
        yield
    except errors.ToolkitError:
        raise
    except Exception as error:  # besides FFmpegError, PyAV raises errors of the language
        reason = getattr(error, "strerror", None) or type(error).__name__
        raise errors.ItemError("video", f"it cannot be read ({reason}); expected an intact video") from error


@lru_cache(_KEPT_VIDEOS)
def _open_video(address: str, path: str, version: object) -> video_files.Video:
    with store.open_folder(address).open_inside(path) as stream, _named_problems():
        return _found_video(stream)


def _found_video(stream: IO[bytes]) -> video_files.Video:
    start = video_files.read_start(stream)
    demuxer = video_files.demuxer_of(start)
    if not demuxer:
        begin = start[:12].hex(" ") or "nothing"
        raise errors.ItemError(
            "container", f"a file that begins with {begin}; expected AVI, MP4, MOV, MKV, WebM or MPEG-TS"
        )
    if demuxer == "avi":
        index = _pictures_of(stream)
        if index.is_jpeg:
            return _video_of_jpegs(index)
    with errors.needs_extra("reading this video", "av", "video"):
        from realtouch.video.coded_video import coded_video  # PyAV, an extra
    return coded_video(stream, demuxer, is_cut=demuxer == "mov" and video_files.check_boxes(stream))


def _pictures_of(stream: IO[bytes]) -> AviPictures:
    def read(position: int, count: int) -> bytes:
        stream.seek(position)
        return stream.read(count)

    try:
        return AviPictures(read, stream.seek(0, 2), video_files.MAX_PICTURES)
    except ValueError as error:
        raise errors.ItemError("damaged", str(error)) from error


def _video_of_jpegs(index: AviPictures) -> video_files.Video:
    if not len(index):
        raise errors.ItemError("length", "an AVI without pictures; expected one or more")
    if not 1 / _MAX_HZ <= index.period_s <= _MAX_PERIOD_S:
        raise errors.ItemError(
            "rate", f"an AVI with a picture each {float(index.period_s):g} s; expected a rate"
        )

    def read(stream: IO[bytes], numbers: Iterable[int]) -> Iterator[bytes | errors.ItemError]:
        for number in numbers:
            if index.sizes[number] > touch.MAX_IMAGE_BYTES:
                yield errors.ItemError("image", video_files.TOO_LARGE)
                continue
            stream.seek(int(index.starts[number]))
            yield stream.read(int(index.sizes[number]))

    times = video_files.seconds_of(index.slots, index.period_s)
    note = ""
    if index.is_cut:
        note = video_files.CUT_SHORT
    return video_files.Video(times, int(index.sizes.mean()), note, read)


class AviPictures:
    """Positions and sizes of the JPEGs of an AVI.

    Only headers of chunks are read, not the index: some recorders leave it out, and it may be wrong. Layout:
    Microsoft's AVI RIFF file reference, and the OpenDML AVI file format extensions, by which files over 1 GB
    have several RIFF parts. If a file was not closed, the sizes of its lists are 0, or reach beyond its end;
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
        entries = array("q")
        position = 0
        riff_end = end
        slot = 0
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
                    entries.extend((start, size, slot))
                slot += 1
                if slot > most:
                    raise ValueError(f"an AVI of more than {most:,} pictures, which is the limit")
            elif name in (b"strh", b"strf"):
                self._read_header(name, bytes(read(start, min(size, STREAM_HEADER.size))))
        pictures = np.frombuffer(entries, np.int64).reshape(-1, 3)
        if not self.is_jpeg:
            pictures = pictures[:0]
        self.starts: Int64 = pictures[:, 0].copy()
        self.sizes: Int64 = pictures[:, 1].copy()
        self.slots: Int64 = pictures[:, 2].copy()

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
