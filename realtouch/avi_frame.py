"""One frame of an AVI, without reading the whole index: a few dozen bytes are looked at.

Only the plain case is known here: one stream of frames, all of them stored, as many as the round says.
Whatever looks different is left to :mod:`realtouch.avi`, which reads every entry and says what is wrong.
"""

from __future__ import annotations

import struct

__all__ = ["find_frame"]

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
