"""Videos as sequences of JPEG or PNG: their times, and any of their pictures.

The JPEGs of MJPEG stay as they are. Everything else is decoded by FFmpeg (PyAV, extra ``video``) and encoded
again (:mod:`realtouch.coded_video`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import lru_cache
from typing import IO

from realtouch import avi_scan, video_files
from tactile_toolkit import errors, store, touch

_MAX_HZ = 1_000_000
_MAX_PERIOD_S = 86_400
_KEPT_VIDEOS = 8


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
        The file cannot be read, is damaged, exceeds the limits of :mod:`realtouch.video_files`, has several
        streams of pictures, or asks to turn its pictures.
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
    with folder.open_inside(path) as stream, video_files.named_problems():
        yield from video.read(stream, numbers)


@lru_cache(_KEPT_VIDEOS)
def _open_video(address: str, path: str, version: object) -> video_files.Video:
    with store.open_folder(address).open_inside(path) as stream, video_files.named_problems():
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
        found = _pictures_of(stream)
        if found.is_jpeg:
            return _video_of_jpegs(found)
    with errors.needs_extra("reading this video", "av", "video"):
        from realtouch.coded_video import coded_video  # PyAV, an extra
    return coded_video(stream, demuxer, is_cut=demuxer == "mov" and video_files.check_boxes(stream))


def _pictures_of(stream: IO[bytes]) -> avi_scan.AviPictures:
    def read(position: int, count: int) -> bytes:
        stream.seek(position)
        return stream.read(count)

    try:
        return avi_scan.AviPictures(read, stream.seek(0, 2), video_files.MAX_PICTURES)
    except ValueError as error:
        raise errors.ItemError("damaged", str(error)) from error


def _video_of_jpegs(found: avi_scan.AviPictures) -> video_files.Video:
    if not len(found):
        raise errors.ItemError("length", "an AVI without pictures; expected one or more")
    if not 1 / _MAX_HZ <= found.period_s <= _MAX_PERIOD_S:
        raise errors.ItemError(
            "rate", f"an AVI with a picture each {float(found.period_s):g} s; expected a rate"
        )

    def read(stream: IO[bytes], numbers: Iterable[int]) -> Iterator[bytes | errors.ItemError]:
        for number in numbers:
            stream.seek(int(found.starts[number]))
            yield video_files.kept_jpeg(stream.read(min(int(found.sizes[number]), touch.MAX_IMAGE_BYTES + 1)))

    times, note = video_files.seconds_of(found.slots, found.period_s), ""
    if found.is_cut:
        note = video_files.CUT_SHORT
    return video_files.Video(times, int(found.sizes.mean()), note, read)
