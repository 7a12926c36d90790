"""Clips of touches: frames are decoded one by one, only those asked for.

The reference decoder is libjpeg: an AVI of MJPEG frames is a string of JPEGs, found through the file's index.
FFmpeg (PyAV) is the other; on frames with halved colour resolution (4:2:0) the two differ by 3 to 11 grey
levels, because FFmpeg interpolates colours in another way. A clip whose index cannot be read always goes
through FFmpeg.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from dataset_store.errors import InputError, ItemError, MissingExtraError
from dataset_store.records import Row
from realtouch.avi import AviIndex, NoIndexError, read_index
from realtouch.contact import (
    DEFAULT_MIN_AREA,
    DEFAULT_MIN_CHANGE,
    contact_window,
    deepest_frame,
    most_changed_frame,
    require_method,
)
from realtouch.damage import damaged
from realtouch.ffmpeg import ffmpeg_count, ffmpeg_fps, ffmpeg_frames, ffmpeg_size
from realtouch.fields import (
    clip_length,
    clip_poses,
    clip_times,
    media_count,
    touch_times,
)
from realtouch.images import in_parallel, positions_of
from realtouch.jpeg import Pixels, decode_image, image_size
from realtouch.nested import nested_column
from realtouch.poses import Poses

if TYPE_CHECKING:
    from torchcodec.decoders import VideoDecoder

__all__ = ["DECODERS", "Decoder", "SensorClips", "TouchClip"]

Decoder = Literal["libjpeg", "ffmpeg"]
DECODERS: tuple[Decoder, ...] = ("libjpeg", "ffmpeg")
NO_CONTACT = "no-contact"
T = TypeVar("T")


class TouchClip(Sequence[Pixels]):
    """The clip of one touch.

    ``clip[i]`` gives (H, W, 3) uint8; a slice, ints or a boolean mask give (n, H, W, 3). No frame is kept.
    Iterating yields ``{"data": (3, H, W) uint8, "pts": seconds}`` per frame, as the ``VideoReader`` of
    torchvision did; use :meth:`frames` for arrays. Safe to share between threads and to pickle.

    Parameters
    ----------
    row : Row
        The round.
    touch : int
        Number of the touch in it.
    decoder : "libjpeg" or "ffmpeg"
        Which decoder to use; see the module's text.
    """

    __slots__ = ("_count", "_index", "_row", "_wanted_decoder", "data", "touch")

    def __init__(self, row: Row, touch: int, decoder: Decoder = "libjpeg") -> None:
        if decoder not in DECODERS:
            message = f"no decoder {decoder!r}; expected one of {', '.join(DECODERS)}"
            raise InputError(message)
        self._row, self.touch, self._wanted_decoder = row, touch, decoder
        self.data = self._stored_bytes()
        self._index = self._read_index()
        self._count = self._frame_count()

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
        frame = self._place(operator.index(index))
        if self.decoder == "libjpeg":
            return self._decode(frame)
        pixels: Pixels = self._named(partial(ffmpeg_frames, self.data, [frame], self._count))[0]
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
        """
        wanted = positions_of(index, self._count)
        if self.decoder == "ffmpeg":
            return self._named(partial(ffmpeg_frames, self.data, wanted, self._count))
        pixels = np.empty((len(wanted), *self.size, 3), np.uint8)
        in_parallel(lambda place: self._decode(wanted[place], pixels[place]), len(wanted), threads)
        return pixels

    def decode_into(self, out: Pixels, frame: int) -> None:
        """Decode one frame into an array of its size, shape (H, W, 3), uint8."""
        if self.decoder == "libjpeg":
            self._decode(self._place(frame), out)
        else:
            out[...] = self[frame]

    def __iter__(self) -> Iterator[dict[str, Any]]:  # type: ignore[override]
        """Yield ``{"data", "pts"}``: a (3, H, W) uint8 tensor (without torch an array), and seconds."""
        to_data = _tensor_maker()
        for frame, time_s in enumerate(self.media_times_s):
            yield {"data": to_data(self[frame].transpose(2, 0, 1)), "pts": float(time_s)}

    @property
    def decoder(self) -> Decoder:
        """Which decoder is used: ``"ffmpeg"`` whenever the index of the clip cannot be read."""
        return self._wanted_decoder if self._index is not None else "ffmpeg"

    @property
    def has_index(self) -> bool:
        """Whether the clip is an indexed AVI of JPEGs, whose frames are found without decoding others."""
        return self._index is not None

    def with_decoder(self, decoder: Decoder) -> TouchClip:
        """Return the same clip, decoded by ``"libjpeg"`` (the reference) or ``"ffmpeg"``."""
        return TouchClip(self._row, self.touch, decoder)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of a frame, pixels."""
        if self._index is None:
            return self._named(partial(ffmpeg_size, self.data))
        return self._named(lambda: image_size(self.encoded(0)))

    @property
    def fps(self) -> float:
        """Frames per second that the file states; 25 in the published sets."""
        return self._index.fps if self._index is not None else self._named(partial(ffmpeg_fps, self.data))

    @property
    def media_times_s(self) -> NDArray[np.float64]:
        """Time of each frame on the file's own clock, shape (N,), seconds from its first frame."""
        slots = self._index.slots if self._index is not None else None
        return (np.arange(self._count) if slots is None else slots) / self.fps

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

    def encoded(self, frame: int) -> memoryview:
        """Return the JPEG of one frame as it is stored.

        Raises
        ------
        InputError
            The clip is not an indexed AVI of MJPEG frames.
        """
        if self._index is None:
            message = (
                f"touch {self.touch}: the clip is no indexed AVI of JPEG frames; decode its frames instead"
            )
            raise InputError(message)
        return self._index.frame(self.data, self._place(frame))

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

    def _stored_bytes(self) -> memoryview:
        column = nested_column(self._row.group, "sensor_video")
        start, stop = column.inside(0, self._row.index, self._row.index + 1)
        blob: memoryview | None = column.values[start + self.touch] if self.touch < stop - start else None
        if blob is None or len(blob) == 0:
            problem = "no bytes are stored; expected an AVI"
            raise damaged(self._row, "sensor_video", problem, self.touch)
        return blob

    def _read_index(self) -> AviIndex | None:
        try:
            return self._named(lambda: read_index(self.data), let_through=NoIndexError)
        except NoIndexError:
            return None

    def _frame_count(self) -> int:
        stated = clip_length(self._row, self.touch)
        if self._index is None:
            return self._named(partial(ffmpeg_count, self.data)) if stated is None else stated
        if stated is not None and stated != len(self._index):
            problem = f"a clip of {len(self._index)} frames; expected {stated} by 'video_length_frames'"
            raise damaged(self._row, "sensor_video", problem, self.touch)
        return len(self._index)

    def _decode(self, frame: int, out: Pixels | None = None) -> Pixels:
        try:
            return decode_image(self.encoded(frame), out)
        except ValueError as error:
            raise damaged(self._row, "sensor_video", f"frame {frame}: {error}", self.touch) from error

    def _named(self, work: Callable[[], T], let_through: type[ValueError] | tuple[()] = ()) -> T:
        try:
            return work()
        except let_through:
            raise
        except ValueError as error:
            raise damaged(self._row, "sensor_video", str(error), self.touch) from error

    def _place(self, frame: int) -> int:
        if not -self._count <= frame < self._count:
            message = f"frame {frame} is out of range for {self._count} frames"
            raise IndexError(message)
        return frame + self._count if frame < 0 else frame

    def __reduce__(self) -> tuple[Any, ...]:
        return (TouchClip, (self._row, self.touch, self._wanted_decoder))

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

    __slots__ = ("_count", "_decoder", "_row")

    def __init__(self, row: Row, decoder: Decoder = "libjpeg") -> None:
        self._row, self._decoder = row, decoder
        self._count = media_count(row, "sensor_video")

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
            return [TouchClip(self._row, touch, self._decoder) for touch in positions_of(index, self._count)]
        touch = operator.index(index)
        if not -self._count <= touch < self._count:
            message = f"touch {touch} is out of range for {self._count} touches"
            raise IndexError(message)
        return TouchClip(self._row, touch % self._count, self._decoder)

    def __reduce__(self) -> tuple[Any, ...]:
        return (SensorClips, (self._row, self._decoder))

    def __repr__(self) -> str:
        return f"SensorClips({self._count} touches)"


def _tensor_maker() -> Callable[[Pixels], Any]:
    try:
        import torch
    except ImportError:
        return np.ascontiguousarray
    return lambda pixels: torch.from_numpy(np.ascontiguousarray(pixels))
