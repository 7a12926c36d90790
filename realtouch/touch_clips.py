"""The clips of a round; frames are found by the headers of the file and decoded one by one.

An AVI of MJPEG frames is a sequence of JPEGs, which libjpeg decodes.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import DTypeLike

from realtouch import avi, contact, contact_picture, picture_views, schema, sensor_images, stored_round
from realtouch.poses import Poses
from tactile_toolkit import errors, pictures, read, wording
from tactile_toolkit.array_types import AnyArray, Float64, UInt8
from tactile_toolkit.touch import decode_image, image_size

if TYPE_CHECKING:
    from torchcodec.decoders import VideoDecoder

_SHOWN_FRAMES = 8


class TouchClip(Sequence[UInt8]):
    """The clip of one touch.

    ``clip[i]`` gives (H, W, 3) uint8; a slice, ints or a boolean mask give (n, H, W, 3). No frame is kept.
    Iterating yields ``{"data": (3, H, W) uint8, "pts": seconds}`` per frame, as the ``VideoReader`` of
    torchvision did; use :meth:`frames`, or ``numpy.asarray``, for arrays. Safe to share between threads and
    to pickle.

    Parameters
    ----------
    row : StoredRound
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
        The clip is not an AVI of JPEGs, cut short, damaged, exceeds the limits or has another length
        than the round states; names file, row and touch.
    """

    __slots__ = ("_avi", "data", "row", "touch")

    def __init__(self, row: stored_round.StoredRound, touch: int) -> None:
        self.row, self.touch = row, touch
        self.data = row.stored_clip(touch)
        stated = row.clip_length(touch)
        try:
            self._avi = avi.Avi(self.data)
        except ValueError as error:
            raise row.damaged("sensor_video", str(error), touch) from error
        if len(self._avi) != stated:
            raise row.damaged(
                "sensor_video",
                f"a clip of {len(self._avi)} frames; expected {stated} by 'video_length_frames'",
                touch,
            )

    def __len__(self) -> int:
        return len(self._avi)

    def __getitem__(self, index: Any) -> UInt8:  # type: ignore[override]
        """Decode one frame, or some into one array.

        Raises
        ------
        IntegrityError
            A frame is damaged; names file, row and touch.
        """
        if read.picks_several(index):
            return self.frames(index)
        return self._decode(read.checked_index(operator.index(index), len(self), "frame", "frames"))

    def frames(self, index: object = slice(None), *, threads: int = 1) -> UInt8:
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
            A frame is damaged, or they exceed :data:`realtouch.sensor_images.MAX_BATCH_PIXELS`.
        """
        wanted = read.positions(index, len(self)).tolist()
        with self.row.naming("sensor_video", self.touch):
            pixels = sensor_images.room_for(len(wanted), self.size)
        sensor_images.in_parallel(
            lambda number: self._decode(wanted[number], pixels[number]), len(wanted), threads
        )
        return pixels

    def __iter__(self) -> Iterator[dict[str, object]]:  # type: ignore[override]
        """Yield ``{"data", "pts"}``: a (3, H, W) uint8 tensor (without torch an array), and seconds."""
        to_data: Callable[[UInt8], object] = np.asarray
        # Users of torchvision's reader expect tensors; without torch, arrays are returned.
        with suppress(ImportError):
            import torch  # an extra

            to_data = torch.from_numpy
        for frame, time_s in enumerate(self.media_times_s):
            pixels = np.ascontiguousarray(self[frame].transpose(2, 0, 1))
            yield {"data": to_data(pixels), "pts": float(time_s)}

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> AnyArray:
        """Return all frames, shape (N, H, W, 3), for numpy: the items of an iteration are not arrays."""
        if copy is False:
            raise ValueError("frames are decoded into a new array; a clip cannot be an array without a copy")
        return np.asarray(self.frames(), dtype)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of a frame, pixels."""
        data = self.encoded(0)
        with self.row.naming("sensor_video", self.touch):
            return image_size(data)

    @property
    def fps(self) -> float:
        """Frames per second that the file states; 25 in the published sets."""
        return self._avi.fps

    @property
    def media_times_s(self) -> Float64:
        """Time of each frame on the file's own clock, shape (N,), seconds from its first frame."""
        return self._avi.slots / self.fps  # a repeated frame takes a slot of time

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
        IntegrityError
            The index does not lead to the frame; names file, row and touch.
        """
        number = read.checked_index(frame, len(self), "frame", "frames")
        try:
            return self._avi.frame(number)
        except ValueError as error:
            raise self.row.damaged("sensor_video", str(error), self.touch) from error

    def decode_into(self, out: UInt8, frame: int) -> None:
        """Decode one frame into an array of its size.

        Parameters
        ----------
        out : ndarray, shape (H, W, 3), uint8
            Where to put it.
        frame : int
            Which frame.
        """
        self._decode(frame, out)

    @property
    def timestamps_s(self) -> Float64:
        """Time stamp of each frame, shape (N,), float64, seconds on the clock of the recording.

        They are stored with the round; in data sets without them, they are on the file's own clock.
        """
        times = self.row.stamps_s(self.touch)
        return self.media_times_s if times is None else times[0]

    @property
    def poses(self) -> Poses:
        """Pose of the gel in each frame, N poses, metres, cell frame."""
        return self.row.pose_sequences(self.touch)[0]

    @property
    def contact_window(self) -> slice:
        """Frames from first to last registered contact; see :func:`realtouch.contact.contact_window`."""
        return contact_windows(self.row, self.touch)[0]

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
            The method is unknown, or it is ``"peak"`` and there are no poses.
        """
        chosen = contact.require_method(method)
        if chosen == "best":
            return contact_picture.best_of(self.frames())[0]
        return contact_frames_of(self.row, chosen, self.touch)[0]

    def contact_frame(self, method: str = "contact_end") -> UInt8:
        """Decode the frame that shows the contact, (H, W, 3) uint8; see :meth:`contact_index`."""
        return self[self.contact_index(method)]

    def to_torchcodec(self) -> VideoDecoder:
        """Return a ``torchcodec`` decoder of the clip, as `datasets` does.

        Raises
        ------
        MissingExtraError
            torchcodec is not installed.
        """
        with errors.needs_extra("TouchClip.to_torchcodec()", "torchcodec", "torch"):
            from torchcodec.decoders import VideoDecoder  # an extra
        return VideoDecoder(bytes(self.data))

    def _decode(self, frame: int, out: UInt8 | None = None) -> UInt8:
        try:
            return decode_image(self._avi.frame(frame), out)
        except ValueError as error:
            raise self.row.damaged("sensor_video", f"frame {frame}: {error}", self.touch) from error

    def __reduce__(self) -> tuple[object, ...]:
        return (TouchClip, (self.row, self.touch))

    def __repr__(self) -> str:
        return f"TouchClip(touch {self.touch}, {wording.with_count(len(self), 'frames')})"

    def _repr_html_(self) -> str:
        """Show frames from first to last in a notebook; those that are damaged are left out."""
        frames = picture_views.evenly_spaced(len(self), _SHOWN_FRAMES)
        images = [(f"frame {frame}", partial(self.__getitem__, frame)) for frame in frames]
        return pictures.grid_html(f"Touch {self.touch}", [wording.with_count(len(self), "frames")], images)


class SensorClips(Sequence[TouchClip]):
    """The clips of one round; each is opened on access."""

    __slots__ = ("_count", "row")

    def __init__(self, row: stored_round.StoredRound) -> None:
        _, start, stop = row.entries_of("sensor_video")
        self.row, self._count = row, stop - start

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> TouchClip: ...
    @overload
    def __getitem__(self, index: slice | Sequence[int]) -> list[TouchClip]: ...
    def __getitem__(self, index: Any) -> TouchClip | list[TouchClip]:
        """Open one clip, or some; raises as :class:`TouchClip`."""
        if read.picks_several(index):
            return [TouchClip(self.row, touch) for touch in read.positions(index, self._count).tolist()]
        return TouchClip(self.row, read.checked_index(operator.index(index), self._count, "touch", "touches"))

    def room(self, count: int, out: UInt8 | None = None) -> UInt8:
        """Return an array for ``count`` frames of the first clip's size: a new one, or ``out`` if it fits.

        Raises InputError when ``out`` cannot take them, IntegrityError when they exceed
        :data:`realtouch.sensor_images.MAX_BATCH_PIXELS`.
        """
        size = self[0].size if self._count else (0, 0)
        with self.row.naming("sensor_video"):
            return sensor_images.room_for(count, size, out)

    def __reduce__(self) -> tuple[object, ...]:
        return (SensorClips, (self.row,))

    def __repr__(self) -> str:
        return f"SensorClips({wording.with_count(self._count, 'touches')})"


def contact_windows(row: stored_round.StoredRound, touch: int | None = None) -> list[slice]:
    """Return the frames of contact of every clip of a round, or of ``touch``: see :func:`contact_window`.

    Opens clips only where the times of frames are not stored. Raises IntegrityError when times are missing or
    impossible.
    """
    times = row.stamps_s(touch)
    if times is None:
        touches: Sequence[int] = range(row.touch_total())
        if touch is not None:
            touches = [touch]
        times = [TouchClip(row, each).media_times_s for each in touches]
    ends = (each.tolist() for each in row.times_of_touches(touch))
    return [contact.contact_window(*each) for each in zip(times, *ends, strict=True)]


def contact_frames_of(
    row: stored_round.StoredRound, method: contact.ContactMethod, touch: int | None = None
) -> list[int]:
    """Return the frame that shows the contact, by time or pose, for every clip of a round, or for one clip.

    See :meth:`TouchClip.contact_index`. Raises InputError for ``"peak"`` without poses, IntegrityError as
    :func:`contact_windows`, and for poses.
    """
    windows = contact_windows(row, touch)
    if method == "contact_start":
        return [window.start for window in windows]
    if method == "contact_end":
        return [window.stop - 1 for window in windows]
    schema.require_poses_for(method, row.group.names, row.path)
    pressed = zip(row.pose_sequences(touch), windows, strict=True)
    return [window.start + int(np.argmin(each.position_m[window, 2])) for each, window in pressed]


def decode_frames(
    clips: SensorClips, touches: Sequence[int], frames: Sequence[int], out: UInt8, threads: int
) -> None:
    """Decode one frame each of n clips into ``out``, shape (n, H, W, 3), uint8, in some threads.

    Raises IntegrityError when a frame is damaged or of another size; it names file, row and touch.
    """
    opened = {touch: clips[touch] for touch in dict.fromkeys(touches)}
    # All frames are located before the first is decoded; alternating takes a tenth longer, as each
    # evicts the other from the caches of the processor.
    encoded = [opened[touch].encoded(frame) for touch, frame in zip(touches, frames, strict=True)]

    def decode(number: int) -> None:
        try:
            decode_image(encoded[number], out[number])
        except ValueError as error:
            raise clips.row.damaged(
                "sensor_video", f"frame {frames[number]}: {error}", touches[number]
            ) from error

    sensor_images.in_parallel(decode, len(encoded), threads)
