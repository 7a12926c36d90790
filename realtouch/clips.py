"""The clips of a round."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any, overload

import numpy as np

from dataset_store.errors import IntegrityError
from dataset_store.records import Row
from realtouch.avi_frame import find_frame
from realtouch.clip import TouchClip
from realtouch.clip_frames import DECODERS, Decoder
from realtouch.damage import damaged
from realtouch.fields import clip_lengths, media_count
from realtouch.images import positions_of
from realtouch.jpeg import Pixels, room_for
from realtouch.nested import BytesColumn, nested_column

__all__ = ["DECODERS", "Decoder", "SensorClips", "TouchClip"]


class SensorClips(Sequence[TouchClip]):
    """The clips of one round; opening one reads its index, no frame.

    Parameters
    ----------
    row : Row
        The round.
    decoder : "libjpeg" or "ffmpeg"
        Decoder of its clips.
    """

    __slots__ = ("_blobs", "_count", "_decoder", "_lengths", "_start", "row")

    def __init__(self, row: Row, decoder: Decoder = "libjpeg") -> None:
        self.row, self._decoder = row, decoder
        self._count = media_count(row, "sensor_video")
        column = nested_column(row.group, "sensor_video")
        self._start = column.inside(0, row.index, row.index + 1)[0]
        self._blobs: BytesColumn = column.values
        self._lengths: list[int] | None = None

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> TouchClip: ...
    @overload
    def __getitem__(self, index: slice | Sequence[int]) -> list[TouchClip]: ...
    def __getitem__(self, index: Any) -> TouchClip | list[TouchClip]:
        """Open one clip, or some.

        Raises
        ------
        IntegrityError
            The clip is cut short, damaged or exceeds the limits; names file, row and touch.
        """
        if isinstance(index, (slice, list, tuple, np.ndarray)):
            return [TouchClip(self.row, touch, self._decoder) for touch in positions_of(index, self._count)]
        touch = operator.index(index)
        if not -self._count <= touch < self._count:
            message = f"touch {touch} is out of range for {self._count} touches"
            raise IndexError(message)
        return TouchClip(self.row, touch % self._count, self._decoder)

    def room(self, count: int, out: Pixels | None = None) -> Pixels:
        """Return an array for ``count`` frames of the first clip's size: a new one, or ``out`` if it fits.

        Returns
        -------
        ndarray, shape (count, H, W, 3), uint8

        Raises
        ------
        InputError
            ``out`` is no such array.
        IntegrityError
            The frames exceed :data:`realtouch.jpeg.MAX_BATCH_PIXELS`.
        """
        size = self[0].size if self._count else (0, 0)
        try:
            return room_for(count, size, out)
        except ValueError as error:
            raise damaged(self.row, "sensor_video", str(error)) from error

    def find_frame(self, touch: int, frame: int) -> memoryview | None:
        """Return the JPEG of one frame of one clip, without opening the clip; None where that takes more.

        Raises
        ------
        IntegrityError
            The length of a clip is missing or negative.
        """
        if self._lengths is None:
            stated = clip_lengths(self.row)
            self._lengths = [] if stated is None else stated.tolist()
        blob = self._blobs[self._start + touch]
        if self._decoder != "libjpeg" or not self._lengths or blob is None:
            return None
        return find_frame(blob, frame, self._lengths[touch])

    def damaged_frame(self, touch: int, frame: int, error: ValueError) -> IntegrityError:
        """Return the error for a frame that cannot be decoded."""
        return damaged(self.row, "sensor_video", f"frame {frame}: {error}", touch)

    def __reduce__(self) -> tuple[Any, ...]:
        return (SensorClips, (self.row, self._decoder))

    def __repr__(self) -> str:
        return f"SensorClips({self._count} touches)"
