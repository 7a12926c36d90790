"""Clips of touches: frames are found through the file's index and decoded one by one, only those asked for.

An AVI of MJPEG frames is a string of JPEGs, which libjpeg decodes. A clip whose index cannot be read goes
through FFmpeg (PyAV, the extra ``video``).
"""

from __future__ import annotations

import contextlib
import operator
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from realtouch.changes import best_of
from realtouch.columns.per_frame import clip_length, clip_times, stored_clip, touch_times
from realtouch.columns.poses import clip_poses
from realtouch.contact import (
    DEFAULT_MIN_AREA,
    DEFAULT_MIN_CHANGE,
    contact_window,
    deepest_frame,
    most_changed_frame,
    require_method,
)
from realtouch.damage import damaged
from realtouch.media.images import in_parallel
from realtouch.poses import Poses
from tactile_toolkit.errors import InputError, IntegrityError, ItemError, MissingExtraError
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.sequence import checked_index, positions
from tactile_toolkit.touch.jpeg import Pixels, decode_image, image_size, room_for
from tactile_toolkit.touch.video import (
    Avi,
    AviIndex,
    NoIndexError,
    ffmpeg_count,
    ffmpeg_facts,
    ffmpeg_frames,
    require_video,
)

if TYPE_CHECKING:
    from torchcodec.decoders import VideoDecoder


T = TypeVar("T")
NO_CONTACT = "no-contact"
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

    __slots__ = ("_avi", "_count", "_index", "_row", "data", "touch")

    def __init__(self, row: Row, touch: int) -> None:
        self._row, self.touch = row, touch
        self.data = stored_clip(row, touch)
        # The index is read only where the stated length does not find a frame without it: one frame of a clip
        # is the common wish.
        self._avi: Avi | None = None
        self._index: AviIndex | None = None
        stated = clip_length(row, touch)
        try:
            avi = Avi(self.data)
            # As many entries as frames: each entry is a frame, so one is found without reading them all.
            if stated is None or avi.entry_count != stated or avi.frame(0) is None:
                self._index = avi.index()
            self._avi = avi
        except NoIndexError:
            self._count = self._named(lambda: ffmpeg_count(self.data)) if stated is None else stated
        except ValueError as error:
            raise damaged(row, "sensor_video", str(error), touch) from error
        else:
            self._count = avi.entry_count
            if self._index is not None:
                self._count = len(self._index)
                self._require_length(self._count)

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
        pixels: Pixels = self._named(lambda: ffmpeg_frames(self.data, [frame], self._count))[0]
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
        if self._avi is None:
            return self._named(lambda: ffmpeg_frames(self.data, wanted, self._count))
        self._whole_index()  # refuses frames that overlap: few bytes that decode to any amount of pixels
        size = self.size
        pixels = self._named(lambda: room_for(len(wanted), size))
        in_parallel(lambda number: self._decode(wanted[number], pixels[number]), len(wanted), threads)
        return pixels

    def __iter__(self) -> Iterator[dict[str, Any]]:  # type: ignore[override]
        """Yield ``{"data", "pts"}``: a (3, H, W) uint8 tensor (without torch an array), and seconds."""
        to_data: Callable[[Pixels], Any] = np.asarray
        # Consumers of torchvision's reader expect tensors; without torch the arrays do.
        with contextlib.suppress(ImportError):
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
        if self._avi is None:
            return self._named(lambda: ffmpeg_facts(self.data))[0]
        return self._named(lambda: image_size(self.encoded(0)))

    @property
    def fps(self) -> float:
        """Frames per second that the file states; 25 in the published sets."""
        return self._avi.fps if self._avi is not None else self._named(lambda: ffmpeg_facts(self.data))[1]

    @property
    def media_times_s(self) -> NDArray[np.float64]:
        """Time of each frame on the file's own clock, shape (N,), seconds from its first frame."""
        # A repeated frame takes a slot of time; with as many entries as frames, there is none.
        slots = self._index.slots if self._index is not None else None
        return (np.arange(self._count) if slots is None else slots) / self.fps

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
        found = self._avi.frame(number) if self._index is None else None
        return self._whole_index().frame(self.data, number) if found is None else found

    def contact_into(self, out: Pixels, method: str = "contact_end", **thresholds: float) -> None:
        """Decode the frame that shows the contact into an array of its size; see :meth:`contact_index`.

        Parameters
        ----------
        out : ndarray, shape (H, W, 3), uint8
            Where to put it.
        method : str
            As for :meth:`contact_index`.
        **thresholds : float
            As for :meth:`contact_index`.
        """
        self.decode_into(out, self.contact_index(method, **thresholds))

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
            raise InputError(f"no frame at {time_s} s; expected a time within the clip, {span}")
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
            :func:`realtouch.contact.most_changed_frame`; ``"best"``: that of :func:`realtouch.best_frame`.
        min_change, min_area : float
            Thresholds of ``"median"``: grey levels and share of the picture.

        Returns
        -------
        int

        Raises
        ------
        InputError
            There is no such method.
        ItemError
            ``"median"`` finds no frame that shows contact (reason ``"no-contact"``).
        """
        chosen = require_method(method)
        if chosen == "median":
            frame = most_changed_frame(self.frames(), min_change=min_change, min_area=min_area)
            if frame is None:
                raise ItemError(
                    NO_CONTACT,
                    f"touch {self.touch} of {self._row.path!r}, row {self._row.number}, shows no contact: no "
                    f"frame differs from the median by {min_change} levels on {min_area:.2%} of its pixels",
                )
            return frame
        if chosen == "best":
            return best_of(self.frames())[0]
        window = self.contact_window
        if chosen == "contact_start":
            return int(window.start)
        if chosen == "contact_end":
            return int(window.stop) - 1
        return int(window.start) + deepest_frame(self.poses.position_m[window, 2])

    def contact_frame(self, method: str = "contact_end", **thresholds: float) -> Pixels:
        """Decode the frame that shows the contact, (H, W, 3) uint8; see :meth:`contact_index`."""
        return self[self.contact_index(method, **thresholds)]

    def to_torchcodec(self) -> VideoDecoder:
        """Return a ``torchcodec`` decoder of the clip, as `datasets` hands them out.

        Raises
        ------
        MissingExtraError
            torchcodec is not installed.
        IntegrityError
            The clip is neither an AVI nor Matroska; names file, row and touch.
        """
        self._named(lambda: require_video(self.data))
        try:
            from torchcodec.decoders import VideoDecoder
        except ImportError as error:
            feature = "TouchClip.to_torchcodec()"
            raise MissingExtraError(feature, "torchcodec", "torch") from error
        return VideoDecoder(bytes(self.data))

    def _whole_index(self) -> AviIndex:
        if self._index is None:
            assert self._avi is not None
            index = self._named(self._avi.index)
            self._require_length(len(index))
            self._index = index
        return self._index

    def _require_length(self, found: int) -> None:
        stated = clip_length(self._row, self.touch)
        if stated is not None and stated != found:
            problem = f"a clip of {found} frames; expected {stated} by 'video_length_frames'"
            raise damaged(self._row, "sensor_video", problem, self.touch)

    def _decode(self, frame: int, out: Pixels | None = None) -> Pixels:
        try:
            return decode_image(self.encoded(frame), out)
        except ValueError as error:
            raise damaged(self._row, "sensor_video", f"frame {frame}: {error}", self.touch) from error

    def _named(self, work: Callable[[], T]) -> T:
        """Do some work, whose ValueError is damage of this clip."""
        try:
            return work()
        except ValueError as error:
            raise damaged(self._row, "sensor_video", str(error), self.touch) from error

    def __reduce__(self) -> tuple[Any, ...]:
        return (TouchClip, (self._row, self.touch))

    def __repr__(self) -> str:
        return f"TouchClip(touch {self.touch}, {self._count} frames)"

    def _repr_html_(self) -> str:
        """Show frames from first to last in a notebook; those that are damaged are left out."""
        from realtouch.media.sheets import evenly_spaced, round_html

        pictures: list[tuple[str, Pixels | None]] = []
        for frame in evenly_spaced(self._count, _SHOWN_FRAMES):
            try:
                pictures.append((f"frame {frame}", self[frame]))
            except IntegrityError:
                pictures.append((f"frame {frame}", None))
        return round_html(f"Touch {self.touch}", [f"{self._count} frames"], pictures)
