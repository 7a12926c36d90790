"""The clip of one touch as it is stored: its bytes, and how many frames they hold."""

from __future__ import annotations

from realtouch.integrity.damage import damaged
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.nested import nested_column
from tactile_toolkit.touch.avi import NoIndexError, read_index

__all__ = ["counted_frames", "stored_clip"]


def stored_clip(row: Row, touch: int) -> memoryview:
    """Return the bytes of one clip, without a copy.

    Raises
    ------
    IntegrityError
        None are stored; names file, row and touch.
    """
    column = nested_column(row.group, "sensor_video")
    start, stop = column.inside(0, row.index, row.index + 1)
    blob: memoryview | None = column.values[start + touch] if touch < stop - start else None
    if blob is None or len(blob) == 0:
        raise damaged(row, "sensor_video", "no bytes are stored; expected an AVI", touch)
    return blob


def counted_frames(row: Row, touch: int) -> int:
    """Count the frames of one clip, decoding none.

    Raises
    ------
    IntegrityError
        The clip is damaged or exceeds the limits; names file, row and touch.
    """
    data = stored_clip(row, touch)
    try:
        return len(read_index(data))
    except NoIndexError:
        return _frames_without_index(row, touch, data)
    except ValueError as error:
        raise damaged(row, "sensor_video", str(error), touch) from error


def _frames_without_index(row: Row, touch: int, data: memoryview) -> int:
    from realtouch.media.ffmpeg import ffmpeg_count

    try:
        return ffmpeg_count(data)
    except ValueError as error:
        raise damaged(row, "sensor_video", str(error), touch) from error
