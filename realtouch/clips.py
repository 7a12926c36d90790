"""Clips of touches: frames are found through the file's index and decoded one by one, only those asked for.

An AVI of MJPEG frames is a string of JPEGs, which libjpeg decodes. A clip whose index cannot be read goes
through FFmpeg (PyAV, the extra ``video``).
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, suppress
from functools import partial
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import DTypeLike, NDArray

from realtouch.clip_columns import (
    clip_length,
    pose_sequences,
    stamps_s,
    stored_clip,
    times_of_touches,
)
from realtouch.columns import entries_of
from realtouch.contact import ContactMethod, best_of, contact_window, require_method
from realtouch.damage import damaged, naming
from realtouch.images import in_parallel
from realtouch.poses import Poses
from tactile_toolkit.errors import InputError, needs_extra
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.sequence import checked_index, positions
from tactile_toolkit.touch.jpeg import Pixels, decode_image, image_size, room_for
from tactile_toolkit.touch.video import (
    Avi,
    NoIndexError,
    ffmpeg_facts,
    ffmpeg_frames,
    require_video,
)

if TYPE_CHECKING:
    from torchcodec.decoders import VideoDecoder

_SHOWN_FRAMES = 8


class TouchClip(Sequence[Pixels]):
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

    Attributes
    ----------
    data : memoryview
        The file as it is stored.
    touch : int
        Number of the touch in its round.

    Raises
    ------
    IntegrityError
        The clip is cut short, damaged, exceeds the limits or has another length than the round states; names
        file, row and touch.
    MissingExtraError
        The clip is not an AVI of JPEGs, and PyAV is not installed.
    """

    __slots__ = ("_avi", "_count", "_row", "data", "touch")

    def __init__(self, row: Row, touch: int) -> None:
        self._row, self.touch = row, touch
        self.data = stored_clip(row, touch)
        self._count = clip_length(row, touch)
        self._avi: Avi | None = None
        with self._naming(), suppress(NoIndexError):
            self._avi = Avi(self.data)
        if self._avi is not None and len(self._avi) != self._count:
            problem = f"a clip of {len(self._avi)} frames; expected {self._count} by 'video_length_frames'"
            raise damaged(row, "sensor_video", problem, touch)

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: Any) -> Pixels:  # type: ignore[override]
        """Decode one frame, or some into one array.

        Raises
        ------
        IntegrityError
            A frame is damaged; names file, row and touch.
        """
        if isinstance(index, (slice, list, tuple, np.ndarray)):
            return self.frames(index)
        frame = checked_index(operator.index(index), self._count, "frame", "frames")
        if self._avi is not None:
            return self._decode(frame)
        with self._naming():
            pixels: Pixels = ffmpeg_frames(self.data, [frame], self._count)[0]
        return pixels

    def frames(self, index: Any = slice(None), *, threads: int = 1) -> Pixels:
        """Decode frames into one array.

        Parameters
        ----------
        index : slice, sequence of int, or boolean mask
            Which frames; all by default.
        threads : int
            How many frames to decode at a time.

        Returns
        -------
        ndarray, shape (n, H, W, 3), uint8

        Raises
        ------
        IntegrityError
            A frame is damaged, or they exceed :data:`tactile_toolkit.touch.jpeg.MAX_BATCH_PIXELS`.
        """
        wanted = positions(index, self._count).tolist()
        with self._naming():
            if self._avi is None:
                return ffmpeg_frames(self.data, wanted, self._count)
            pixels = room_for(len(wanted), self.size)
        in_parallel(lambda number: self._decode(wanted[number], pixels[number]), len(wanted), threads)
        return pixels

    def __iter__(self) -> Iterator[dict[str, Any]]:  # type: ignore[override]
        """Yield ``{"data", "pts"}``: a (3, H, W) uint8 tensor (without torch an array), and seconds."""
        to_data: Callable[[Pixels], Any] = np.asarray
        # Consumers of torchvision's reader expect tensors; without torch the arrays do.
        with suppress(ImportError):
            import torch

            to_data = torch.from_numpy
        for frame, time_s in enumerate(self.media_times_s):
            pixels = np.ascontiguousarray(self[frame].transpose(2, 0, 1))
            yield {"data": to_data(pixels), "pts": float(time_s)}

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """Return all frames, shape (N, H, W, 3), for numpy: the items of an iteration are not arrays."""
        if copy is False:
            raise ValueError("frames are decoded into a new array; a clip cannot be an array without a copy")
        return np.asarray(self.frames(), dtype)

    @property
    def has_index(self) -> bool:
        """Whether the clip is an indexed AVI of JPEGs, whose frames are found without decoding others."""
        return self._avi is not None

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of a frame, pixels."""
        with self._naming():
            return ffmpeg_facts(self.data)[0] if self._avi is None else image_size(self.encoded(0))

    @property
    def fps(self) -> float:
        """Frames per second that the file states; 25 in the published sets."""
        with self._naming():
            return ffmpeg_facts(self.data)[1] if self._avi is None else self._avi.fps

    @property
    def media_times_s(self) -> NDArray[np.float64]:
        """Time of each frame on the file's own clock, shape (N,), seconds from its first frame."""
        # A repeated frame takes a slot of time.
        return (np.arange(self._count) if self._avi is None else self._avi.slots) / self.fps

    def encoded(self, frame: int) -> memoryview:
        """Return the JPEG of one frame as it is stored.

        Parameters
        ----------
        frame : int
            Which frame; from the end where negative.

        Returns
        -------
        memoryview

        Raises
        ------
        InputError
            The clip is not an indexed AVI of MJPEG frames.
        IntegrityError
            The index does not lead to the frame; names file, row and touch.
        """
        if self._avi is None:
            raise InputError(
                f"touch {self.touch}: the clip is not an indexed AVI of JPEGs", next="decode its frames"
            )
        number = checked_index(frame, self._count, "frame", "frames")
        with self._naming():
            return self._avi.frame(number)

    def contact_into(self, out: Pixels, method: str = "contact_end") -> None:
        """Decode the frame that shows the contact into an array of its size; see :meth:`contact_index`.

        Parameters
        ----------
        out : ndarray, shape (H, W, 3), uint8
            Where to put it.
        method : str
            As for :meth:`contact_index`.
        """
        self.decode_into(out, self.contact_index(method))

    def decode_into(self, out: Pixels, frame: int) -> None:
        """Decode one frame into an array of its size.

        Parameters
        ----------
        out : ndarray, shape (H, W, 3), uint8
            Where to put it.
        frame : int
            Which frame.
        """
        if self._avi is not None:
            self._decode(frame, out)
        else:
            out[...] = self[frame]

    @property
    def timestamps_s(self) -> NDArray[np.float64]:
        """Time stamp of each frame, shape (N,), float64, seconds on the clock of the recording.

        Those stored with the round; the file's own clock in data sets without them.
        """
        times = stamps_s(self._row, self.touch)
        return self.media_times_s if times is None else times[0]

    def at(self, time_s: float) -> Pixels:
        """Decode the frame shown at a time: the last one stamped at or before it, (H, W, 3) uint8.

        Raises
        ------
        InputError
            The time lies before the first frame, or more than one frame's duration after the last.
        """
        times = self.timestamps_s
        if not len(times) or not times[0] <= time_s <= times[-1] + 1.0 / self.fps:
            span = f"{times[0]:.3f} to {times[-1]:.3f} s" if len(times) else "no frames"
            raise InputError(f"no frame at {time_s} s; expected a time within the clip, {span}")
        return self[int(np.searchsorted(times, time_s, side="right")) - 1]

    @property
    def poses(self) -> Poses:
        """Pose of the gel in each frame, N poses, metres, cell frame."""
        return pose_sequences(self._row, self.touch)[0]

    @property
    def contact_window(self) -> slice:
        """Frames from first to last registered contact; see :func:`realtouch.contact.contact_window`."""
        start_s, end_s = times_of_touches(self._row, self.touch)
        return contact_window(self.timestamps_s, float(start_s[0]), float(end_s[0]))

    def contact_index(self, method: str = "contact_end") -> int:
        """Choose the frame that shows the contact.

        Parameters
        ----------
        method : str
            ``"contact_start"`` and ``"contact_end"``: first and last frame of :attr:`contact_window`;
            ``"peak"``: the frame of the window with the lowest gel, the earliest of equals; ``"best"``: the
            frame of the whole clip that changed most, see :func:`realtouch.best_frame`.

        Returns
        -------
        int

        Raises
        ------
        InputError
            The method is unknown.
        """
        chosen = require_method(method)
        if chosen == "best":
            return best_of(self.frames())[0]
        window = self.contact_window
        if chosen == "contact_start":
            return int(window.start)
        if chosen == "contact_end":
            return int(window.stop) - 1
        return int(window.start) + int(np.argmin(self.poses.position_m[window, 2]))

    def contact_frame(self, method: str = "contact_end") -> Pixels:
        """Decode the frame that shows the contact, (H, W, 3) uint8; see :meth:`contact_index`."""
        return self[self.contact_index(method)]

    def to_torchcodec(self) -> VideoDecoder:
        """Return a ``torchcodec`` decoder of the clip, as `datasets` hands them out.

        Raises
        ------
        MissingExtraError
            torchcodec is not installed.
        IntegrityError
            The clip is neither an AVI nor Matroska; names file, row and touch.
        """
        with self._naming():
            require_video(self.data)
        with needs_extra("TouchClip.to_torchcodec()", "torchcodec", "torch"):
            from torchcodec.decoders import VideoDecoder
        return VideoDecoder(bytes(self.data))

    def _decode(self, frame: int, out: Pixels | None = None) -> Pixels:
        with naming(self._row, "sensor_video", self.touch, f"frame {frame}: "):
            assert self._avi is not None
            return decode_image(self._avi.frame(frame), out)

    def _naming(self) -> AbstractContextManager[None]:
        """Turn a ValueError into damage of this clip."""
        return naming(self._row, "sensor_video", self.touch)

    def __reduce__(self) -> tuple[Any, ...]:
        return (TouchClip, (self._row, self.touch))

    def __repr__(self) -> str:
        return f"TouchClip(touch {self.touch}, {self._count} frames)"

    def _repr_html_(self) -> str:
        """Show frames from first to last in a notebook; those that are damaged are left out."""
        from realtouch.images import evenly_spaced, round_html

        frames = evenly_spaced(self._count, _SHOWN_FRAMES)
        pictures = [(f"frame {frame}", partial(self.__getitem__, frame)) for frame in frames]
        return round_html(f"Touch {self.touch}", [f"{self._count} frames"], pictures)


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
        with naming(self.row, "sensor_video"):
            return room_for(count, size, out)

    def __reduce__(self) -> tuple[Any, ...]:
        return (SensorClips, (self.row,))

    def __repr__(self) -> str:
        return f"SensorClips({self._count} touches)"


def contact_frames_of(clips: SensorClips, method: ContactMethod) -> list[int]:
    """Return the frame of every clip of a round that shows the contact, by time or pose, not by the picture.

    See :meth:`TouchClip.contact_index`. Raises IntegrityError when times or poses are missing or impossible.
    """
    times = stamps_s(clips.row)
    if times is None:
        times = [clip.media_times_s for clip in clips]
    ends = (each.tolist() for each in times_of_touches(clips.row))
    windows = [contact_window(*each) for each in zip(times, *ends, strict=True)]
    if method == "contact_start":
        return [window.start for window in windows]
    if method == "contact_end":
        return [window.stop - 1 for window in windows]
    pressed = zip(pose_sequences(clips.row), windows, strict=True)
    return [window.start + int(np.argmin(each.position_m[window, 2])) for each, window in pressed]


def decode_frames(
    clips: SensorClips, touches: Sequence[int], frames: Sequence[int], out: Pixels, threads: int
) -> None:
    """Decode one frame each of n clips into ``out``, shape (n, H, W, 3), uint8, in some threads.

    Raises IntegrityError when a frame is damaged or of another size; it names file, row and touch.
    """
    in_parallel(
        lambda number: clips[touches[number]].decode_into(out[number], frames[number]), len(touches), threads
    )
