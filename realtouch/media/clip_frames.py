"""Frames of one stored clip: found through the file's index and decoded one by one, only those asked for.

The reference decoder is libjpeg: an AVI of MJPEG frames is a string of JPEGs, found through the file's index.
FFmpeg (PyAV) is the other; on frames with halved colour resolution (4:2:0) the two differ by 3 to 11 grey
levels, because FFmpeg interpolates colours in another way. A clip whose index cannot be read always goes
through FFmpeg.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, Literal, Self, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from realtouch.columns.poses import clip_length
from realtouch.columns.stored_clips import stored_clip
from realtouch.integrity.damage import damaged
from realtouch.media.ffmpeg import ffmpeg_count, ffmpeg_fps, ffmpeg_frames, ffmpeg_size
from realtouch.media.images import in_parallel, positions_of
from tactile_toolkit.errors import InputError
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.touch.avi import AviIndex, NoIndexError, read_index
from tactile_toolkit.touch.jpeg import Pixels, decode_image, image_size, room_for

__all__ = ["DECODERS", "ClipFrames", "Decoder"]

Decoder = Literal["libjpeg", "ffmpeg"]
DECODERS: tuple[Decoder, ...] = ("libjpeg", "ffmpeg")
T = TypeVar("T")


class ClipFrames(Sequence[Pixels]):
    """The frames of the clip of one touch; no frame is kept.

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
        self.data = stored_clip(row, touch)
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

        Raises
        ------
        IntegrityError
            A frame is damaged, or they exceed :data:`tactile_toolkit.touch.jpeg.MAX_BATCH_PIXELS`.
        """
        wanted = positions_of(index, self._count)
        if self.decoder == "ffmpeg":
            return self._named(partial(ffmpeg_frames, self.data, wanted, self._count))
        size = self.size
        pixels = self._named(lambda: room_for(len(wanted), size))
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

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """Return all frames, shape (N, H, W, 3), for numpy: the items of an iteration are no arrays."""
        if copy is False:
            message = "frames are decoded into a new array; a clip cannot be an array without a copy"
            raise ValueError(message)
        return np.asarray(self.frames(), dtype)

    @property
    def decoder(self) -> Decoder:
        """Which decoder is used: ``"ffmpeg"`` whenever the index of the clip cannot be read."""
        return self._wanted_decoder if self._index is not None else "ffmpeg"

    @property
    def has_index(self) -> bool:
        """Whether the clip is an indexed AVI of JPEGs, whose frames are found without decoding others."""
        return self._index is not None

    def with_decoder(self, decoder: Decoder) -> Self:
        """Return the same clip, decoded by ``"libjpeg"`` (the reference) or ``"ffmpeg"``."""
        return type(self)(self._row, self.touch, decoder)

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
        return (type(self), (self._row, self.touch, self._wanted_decoder))


def _tensor_maker() -> Callable[[Pixels], Any]:
    try:
        import torch
    except ImportError:
        return np.ascontiguousarray
    return lambda pixels: torch.from_numpy(np.ascontiguousarray(pixels))
