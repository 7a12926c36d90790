"""The clips of a round."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from realtouch.columns.poses import (
    clip_lengths,
    clip_poses,
    clip_times,
    media_count,
    padded_times,
    pose_sequences,
    times_of_touches,
    touch_times,
)
from realtouch.contact import (
    DEFAULT_MIN_AREA,
    DEFAULT_MIN_CHANGE,
    ContactMethod,
    contact_window,
    contact_windows,
    deepest_frame,
    most_changed_frame,
    require_method,
)
from realtouch.integrity.damage import damaged
from realtouch.media.clip_frames import DECODERS, ClipFrames, Decoder
from realtouch.media.images import in_parallel, positions_of
from realtouch.poses import Poses
from tactile_toolkit.errors import InputError, IntegrityError, ItemError, MissingExtraError
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.nested import BytesColumn, nested_column
from tactile_toolkit.touch.avi import find_frame
from tactile_toolkit.touch.jpeg import Pixels, decode_image, room_for

if TYPE_CHECKING:
    from torchcodec.decoders import VideoDecoder

__all__ = [
    "DECODERS",
    "Decoder",
    "SensorClips",
    "TouchClip",
    "contact_frames_of",
    "contact_windows_of",
    "decode_frames",
]

NO_CONTACT = "no-contact"


class TouchClip(ClipFrames):
    """The clip of one touch.

    ``clip[i]`` gives (H, W, 3) uint8; a slice, ints or a boolean mask give (n, H, W, 3). No frame is kept.
    Iterating yields ``{"data": (3, H, W) uint8, "pts": seconds}`` per frame, as the ``VideoReader`` of
    torchvision did; use :meth:`frames`, or ``numpy.asarray``, for arrays. Safe to share between threads and
    to pickle.

    Parameters
    ----------
    row : Row
        The round.
    touch : int
        Number of the touch in it.
    decoder : "libjpeg" or "ffmpeg"
        Which decoder to use; see :mod:`realtouch.media.clip_frames`.
    """

    __slots__ = ()

    @property
    def timestamps_s(self) -> NDArray[np.float64]:
        """Time stamp of each frame, shape (N,), float64, seconds on the clock of the recording.

        Those stored with the round; the file's own clock in data sets without them.
        """
        times = clip_times(self._row, self.touch)
        return self.media_times_s if times is None else times

    def at(self, time_s: float) -> Pixels:
        """Decode the frame shown at a time: the last one stamped at or before it, (H, W, 3) uint8.

        Raises
        ------
        InputError
            The time lies before the first frame, or more than one frame's duration behind the last.
        """
        times = self.timestamps_s
        if not len(times) or not times[0] <= time_s <= times[-1] + 1.0 / self.fps:
            span = f"{times[0]:.3f} to {times[-1]:.3f} s" if len(times) else "no frames"
            message = f"no frame at {time_s} s; expected a time within the clip, {span}"
            raise InputError(message)
        return self[int(np.searchsorted(times, time_s, side="right")) - 1]

    @property
    def poses(self) -> Poses:
        """Pose of the gel in each frame, N poses, metres, cell frame."""
        return clip_poses(self._row, self.touch)

    @property
    def contact_window(self) -> slice:
        """Frames from first to last registered contact; see :func:`realtouch.contact.contact_window`."""
        start_s, end_s = touch_times(self._row, self.touch)
        return contact_window(self.timestamps_s, start_s, end_s)

    def contact_index(
        self,
        method: str = "contact_end",
        *,
        min_change: float = DEFAULT_MIN_CHANGE,
        min_area: float = DEFAULT_MIN_AREA,
    ) -> int:
        """Choose the frame that shows the contact.

        Parameters
        ----------
        method : str
            ``"contact_start"`` and ``"contact_end"``: first and last frame of :attr:`contact_window`;
            ``"peak"``: the frame of the window with the lowest gel, the earliest of equals; ``"median"``: the
            frame of the whole clip that differs most from its median, see
            :func:`realtouch.contact.most_changed_frame`.
        min_change, min_area : float
            Thresholds of ``"median"``: grey levels and share of the picture.

        Raises
        ------
        InputError
            No such method.
        ItemError
            ``"median"`` finds no frame that shows contact (reason ``"no-contact"``).
        """
        chosen = require_method(method)
        if chosen == "median":
            return self._most_changed(min_change, min_area)
        window = self.contact_window
        if chosen == "contact_start":
            return int(window.start)
        if chosen == "contact_end":
            return int(window.stop) - 1
        return int(window.start) + deepest_frame(self.poses.position_m[window, 2])

    def contact_frame(self, method: str = "contact_end", **thresholds: float) -> Pixels:
        """Decode the frame that shows the contact, (H, W, 3) uint8; see :meth:`contact_index`."""
        return self[self.contact_index(method, **thresholds)]

    def contact_into(self, out: Pixels, method: str = "contact_end", **thresholds: float) -> None:
        """Decode the frame that shows the contact into an array of its size, shape (H, W, 3), uint8."""
        self.decode_into(out, self.contact_index(method, **thresholds))

    def to_torchcodec(self) -> VideoDecoder:
        """Return a ``torchcodec`` decoder of the clip, as `datasets` hands them out.

        Raises
        ------
        MissingExtraError
            torchcodec is not installed.
        """
        try:
            from torchcodec.decoders import VideoDecoder
        except ImportError as error:
            feature = "TouchClip.to_torchcodec()"
            raise MissingExtraError(feature, "torchcodec", "torch") from error
        return VideoDecoder(bytes(self.data))

    def _most_changed(self, min_change: float, min_area: float) -> int:
        frame = most_changed_frame(self.frames(), min_change=min_change, min_area=min_area)
        if frame is None:
            message = (
                f"touch {self.touch} of {self._row.path!r}, row {self._row.number}, shows no contact: no "
                f"frame differs from the median by {min_change} levels on {min_area:.2%} of its pixels"
            )
            raise ItemError(NO_CONTACT, message)
        return frame

    def __repr__(self) -> str:
        return f"TouchClip(touch {self.touch}, {self._count} frames)"


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
            The frames exceed :data:`tactile_toolkit.touch.jpeg.MAX_BATCH_PIXELS`.
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


def contact_windows_of(clips: SensorClips) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the frames of contact of every clip; see :func:`realtouch.contact.contact_window`.

    Parameters
    ----------
    clips : SensorClips
        Clips of a round.

    Returns
    -------
    starts, stops : ndarray, shape (T,), int64
        First frame of contact of each clip, and one more than the last.

    Raises
    ------
    IntegrityError
        Times are missing or impossible; names file, row and touch.
    """
    times = padded_times(clips.row)
    if times is None:
        windows = [clip.contact_window for clip in clips]
        starts, stops = ([getattr(window, end) for window in windows] for end in ("start", "stop"))
        return np.array(starts, np.int64), np.array(stops, np.int64)
    return contact_windows(*times, *times_of_touches(clips.row))


def contact_frames_of(clips: SensorClips, method: ContactMethod) -> list[int]:
    """Return the frame that shows the contact of every clip, by time or by pose.

    Parameters
    ----------
    clips : SensorClips
        Clips of a round.
    method : str
        ``"contact_start"``, ``"contact_end"`` or ``"peak"``; see :meth:`realtouch.TouchClip.contact_index`.

    Raises
    ------
    IntegrityError
        Times or poses are missing or impossible; names file, row and touch.
    """
    starts, stops = _plain_windows(clips)
    if method == "contact_start":
        return starts
    if method == "contact_end":
        return [stop - 1 for stop in stops]
    heights = [touch.position_m[:, 2] for touch in pose_sequences(clips.row)]
    windows = zip(heights, starts, stops, strict=True)
    return [start + deepest_frame(z_m[start:stop]) for z_m, start, stop in windows]


def _plain_windows(clips: SensorClips) -> tuple[list[int], list[int]]:
    starts, stops = contact_windows_of(clips)
    return starts.tolist(), stops.tolist()


def decode_frames(
    clips: SensorClips, touches: Sequence[int], frames: Sequence[int], out: Pixels, threads: int
) -> None:
    """Decode one frame each of several clips.

    Parameters
    ----------
    clips : SensorClips
        Clips of a round.
    touches, frames : sequence of int
        Which frame of which clip; of equal length n.
    out : ndarray, shape (n, H, W, 3), uint8
        Where to put them.
    threads : int
        How many to decode at a time.

    Raises
    ------
    IntegrityError
        A frame is damaged or of another size; names file, row and touch.
    """

    def decode(place: int) -> None:
        touch, frame, pixels = touches[place], frames[place], out[place]
        data = clips.find_frame(touch, frame)
        if data is None:
            clips[touch].decode_into(pixels, frame)
            return
        try:
            decode_image(data, pixels)
        except ValueError as error:
            raise clips.damaged_frame(touch, frame, error) from error

    in_parallel(decode, len(touches), threads)
