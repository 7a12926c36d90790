"""The clips of one round, and frames of many of them at once."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from realtouch.columns.per_frame import padded_times, times_of_touches
from realtouch.columns.per_touch import entries_of
from realtouch.columns.poses import pose_sequences
from realtouch.contact import ContactMethod, contact_windows, deepest_frame
from realtouch.damage import damaged
from realtouch.media.clips import TouchClip
from realtouch.media.images import in_parallel
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.sequence import checked_index, positions
from tactile_toolkit.touch.jpeg import Pixels, room_for


class SensorClips(Sequence[TouchClip]):
    """The clips of one round; each is opened when it is asked for."""

    __slots__ = ("_count", "row")

    def __init__(self, row: Row) -> None:
        _, start, stop = entries_of(row, "sensor_video")
        self.row, self._count = row, stop - start

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> TouchClip: ...
    @overload
    def __getitem__(self, index: slice | Sequence[int]) -> list[TouchClip]: ...
    def __getitem__(self, index: Any) -> TouchClip | list[TouchClip]:
        """Open one clip, or some; raises as :class:`TouchClip`."""
        if isinstance(index, (slice, list, tuple, np.ndarray)):
            return [TouchClip(self.row, touch) for touch in positions(index, self._count).tolist()]
        return TouchClip(self.row, checked_index(operator.index(index), self._count, "touch", "touches"))

    def room(self, count: int, out: Pixels | None = None) -> Pixels:
        """Return an array for ``count`` frames of the first clip's size: a new one, or ``out`` if it fits.

        Raises InputError when ``out`` cannot take them, IntegrityError when they exceed
        :data:`tactile_toolkit.touch.jpeg.MAX_BATCH_PIXELS`.
        """
        size = self[0].size if self._count else (0, 0)
        try:
            return room_for(count, size, out)
        except ValueError as error:
            raise damaged(self.row, "sensor_video", str(error)) from error

    def __reduce__(self) -> tuple[Any, ...]:
        return (SensorClips, (self.row,))

    def __repr__(self) -> str:
        return f"SensorClips({self._count} touches)"


def contact_windows_of(clips: SensorClips) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return first frame of contact, and one more than the last, of every clip of a round, shapes (T,).

    See :func:`realtouch.contact.contact_window`. Raises IntegrityError when times are missing or impossible.
    """
    times = padded_times(clips.row)
    if times is not None:
        return contact_windows(*times, *times_of_touches(clips.row))
    windows = [clip.contact_window for clip in clips]
    starts, stops = ([getattr(window, end) for window in windows] for end in ("start", "stop"))
    return np.array(starts, np.int64), np.array(stops, np.int64)


def contact_frames_of(clips: SensorClips, method: ContactMethod) -> list[int]:
    """Return the frame of every clip of a round that shows the contact, by time or pose, not by the picture.

    See :meth:`TouchClip.contact_index`. Raises IntegrityError when times or poses are missing or impossible.
    """
    windows = contact_windows_of(clips)
    starts: list[int] = windows[0].tolist()
    stops: list[int] = windows[1].tolist()
    if method == "contact_start":
        return starts
    if method == "contact_end":
        return [stop - 1 for stop in stops]
    heights = [touch.position_m[:, 2] for touch in pose_sequences(clips.row)]
    return [
        start + deepest_frame(z_m[start:stop])
        for z_m, start, stop in zip(heights, starts, stops, strict=True)
    ]


def decode_frames(
    clips: SensorClips, touches: Sequence[int], frames: Sequence[int], out: Pixels, threads: int
) -> None:
    """Decode one frame each of n clips into ``out``, shape (n, H, W, 3), uint8, in some threads.

    Raises IntegrityError when a frame is damaged or of another size; it names file, row and touch.
    """
    in_parallel(
        lambda number: clips[touches[number]].decode_into(out[number], frames[number]), len(touches), threads
    )
