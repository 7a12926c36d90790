"""Images, depth maps and clips of a round, decoded on access.

Depth maps are images of 16 bits in whole micrometres. A map states how far each point of the gel is pressed
in: 0 where nothing touches it, at most 65,535 um. A second map states the expected error of each pixel.

Clips are AVIs of MJPEG frames: sequences of JPEGs, which libjpeg decodes. Frames are found by the headers of
the file and decoded one by one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import DTypeLike

from realtouch import contact
from realtouch.touches import schema, stored_round
from realtouch.touches.poses import Poses
from realtouch.video import avi
from tactile_toolkit import errors, pictures, read, wording
from tactile_toolkit.run import in_threads
from tactile_toolkit.touch import (
    MEDIA_TYPE,
    EncodedImage,
    decode_image,
    encode_image,
)
from tactile_toolkit.value_types import AnyArray, Float32, Float64, Floating, UInt8

if TYPE_CHECKING:
    from torchcodec.decoders import VideoDecoder


T = TypeVar("T")
S = TypeVar("S")

# Long enough that overhead is small, short enough that threads end together.
_LONGEST_RUN = 16
MAX_BATCH_PIXELS = 1 << 31
"""Most pixels that are decoded into one new array (6 GiB): 256 clips of 90 frames of 320 x 240 pixels fit."""
DEPTH, DEPTH_ERROR = "depth_um", "depth_error_um"
"""Columns of the maps of a round of images, with an entry for each touch."""
SUFFIX = "png"
_PER_M, _MOST = 1e6, 65_535
_SHOWN_FRAMES = 8
_ENDINGS = {b"\xff\xd8": "jpg", b"\x89P": "png"}


def in_parallel(process: Callable[[int], object], count: int, threads: int) -> None:
    """Process items 0 to ``count`` - 1 in threads; the first error ends all of them.

    A thread takes a run of items at a time, as neighbours share pages of the array that they are written to.
    """
    length = max(1, min(_LONGEST_RUN, count // max(1, 4 * threads)))
    runs = (range(start, min(start + length, count)) for start in range(0, count, length))
    deque(in_threads(lambda run: deque(map(process, run), maxlen=0), runs, max(1, threads)), maxlen=0)


def images_array(count: int, size: tuple[int, int], out: UInt8 | None = None) -> UInt8:
    """Return an array for images of one size, shape (n, H, W, 3), uint8: new, or ``out`` if it fits.

    ``size`` is (height, width), pixels; in ``out``, n may be larger than ``count``. Raises InputError when
    ``out`` cannot take the images, ValueError when a new array would exceed :data:`MAX_BATCH_PIXELS`.
    """
    height, width = size
    if out is None:
        if count * height * width > MAX_BATCH_PIXELS:
            raise ValueError(
                f"{wording.with_count(count, 'images')} of {width} x {height} pixels at once; the limit is "
                f"{MAX_BATCH_PIXELS:,} pixels"
            )
        return np.empty((count, height, width, 3), np.uint8)
    if not count:
        return out
    fits = isinstance(out, np.ndarray) and out.dtype == np.uint8 and out.ndim == 4 and len(out) >= count
    # Images need not be adjacent; the pixels of each must be contiguous.
    if fits and out.shape[1:] == (height, width, 3) and out[0].flags.c_contiguous and out.flags.writeable:
        return out
    shape = (count, height, width, 3)
    description = f"{out.dtype} of shape {out.shape}" if isinstance(out, np.ndarray) else type(out).__name__
    raise errors.InputError(
        f"out is {description}; expected a writable array of uint8 and shape {shape} with "
        "C-contiguous images",
        next=f"make one with numpy.empty({shape}, numpy.uint8), or leave `out` out",
    )


class _StoredMedia(read.LazySequence[T, S]):
    """The images, maps or clips of one round; each is decoded or opened on every access and not kept."""

    __slots__ = ("_column", "_count", "_start", "name", "row")
    thing = "touch"
    things = "touches"

    def __init__(self, row: stored_round.StoredRound, name: str) -> None:
        self.row = row
        self.name = name
        self._column = row.column_of(name)
        self._start, stop = self._column.inside(0, row.index, row.index + 1)
        self._count = stop - self._start

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[T]:
        return map(self._item, range(self._count))

    def __reduce__(self) -> tuple[object, ...]:
        return (type(self), (self.row, self.name))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({wording.with_count(self._count, self.things)})"


class SensorImages(_StoredMedia[UInt8, UInt8]):
    """The images of one round; each is decoded on every access and not kept.

    ``images[i]`` gives (H, W, 3) uint8; a slice, list or array of ints, or boolean mask gives (n, H, W, 3).
    Damaged images raise IntegrityError, which names file, row and touch, as do images that differ in size
    from the others requested. Safe to share between threads and to pickle.
    """

    __slots__ = ()

    def __init__(self, row: stored_round.StoredRound, name: str = "sensor_image") -> None:
        super().__init__(row, name)

    def batch(self, index: object = slice(None), *, threads: int = 1, out: UInt8 | None = None) -> UInt8:
        """Decode several images into one array.

        Parameters
        ----------
        index : slice, sequence of int, or boolean mask
            Which touches; all by default.
        threads : int
            Number of images to decode at a time.
        out : ndarray, shape (n, H, W, 3), uint8, optional
            Array to write to, which saves a new array for each batch; each image must be C-contiguous.

        Returns
        -------
        ndarray, shape (n, H, W, 3), uint8

        Raises
        ------
        InputError
            ``out`` is not such an array.
        IntegrityError
            As for indexing; or the images exceed :data:`realtouch.touches.media.MAX_BATCH_PIXELS`.
        """
        touches = self.checked_indices(index)
        first = [*touches, 0][0]
        size = self.size(first) if self._count else (0, 0)
        with self.row.naming("sensor_image", first):
            pixels = images_array(len(touches), size, out)
        self.decode_into(pixels, touches, threads=threads)
        return pixels

    def decode_into(self, out: UInt8, touches: Sequence[int], *, threads: int = 1) -> None:
        """Decode several images into an array of their size, such as ``images_array`` gives."""
        in_parallel(lambda index: self._item(touches[index], out[index]), len(touches), threads)

    def encoded(self, touch: int) -> memoryview:
        """Return the stored bytes of one image, without a copy; IntegrityError if no bytes are stored."""
        number = self.checked_index(touch)
        blob: memoryview | None = self._column.values[self._start + number]
        if blob is None or len(blob) == 0:
            raise self.row.damaged("sensor_image", "no bytes are stored; expected an image", number)
        return blob

    def stored(self) -> pa.Array:
        """Return the stored bytes of all images, without copies; raises as :meth:`encoded`."""
        names = [field.name for field in MEDIA_TYPE]
        images = self.row.extra_entries(self.name).flatten()[names.index("bytes")]
        for touch in np.flatnonzero(pc.fill_null(pc.binary_length(images), 0).to_numpy() == 0).tolist():
            self.encoded(touch)
        return images

    def size(self, touch: int = 0) -> tuple[int, int]:
        """Return height and width of one image from its header."""
        with self.row.naming("sensor_image", touch):
            return EncodedImage(self.encoded(touch)).size()

    def _several(self, index: Any) -> UInt8:
        return self.batch(index)

    def _item(self, index: int, out: UInt8 | None = None) -> UInt8:
        with self.row.naming("sensor_image", index):
            return decode_image(self.encoded(index), out)


def encode_map(depth_m: Floating) -> bytes:
    """Encode a depth map, (H, W), metres, as PNG; negative values become 0.

    Raises InputError for values that are not finite, or exceed 65.535 mm.
    """
    if not np.isfinite(depth_m).all() or depth_m.max(initial=0) * _PER_M > _MOST:
        raise errors.InputError(
            f"depth of {np.max(depth_m):g} m; expected finite numbers of at most {_MOST / _PER_M} m"
        )
    counts = np.rint(np.maximum(depth_m, 0) * _PER_M).astype(np.uint16)
    return encode_image(counts, "png")


def decode_map(data: memoryview | bytes) -> Float32:
    """Decode a depth map, shape (H, W), float32, metres; ValueError for any other file."""
    return EncodedImage(data).grey().astype(np.float32) / np.float32(_PER_M)


class DepthMaps(_StoredMedia[Float32, Float32]):
    """The maps of one round; each is decoded on every access and not kept.

    ``maps[i]`` gives (H, W), float32, metres; a slice, list or array of ints, or boolean mask (n, H, W).
    IntegrityError if a map is damaged, or the requested ones differ in size.
    """

    __slots__ = ()

    def __init__(self, row: stored_round.StoredRound, name: str) -> None:
        row.entries_of(name)  # refuses a round with more or less than T maps
        super().__init__(row, name)

    def _item(self, index: int) -> Float32:
        with self.row.naming(self.name, index):
            return decode_map(self._column.values[self._start + index] or b"")

    def _several(self, index: Any) -> Float32:
        maps = [self._item(touch) for touch in self.checked_indices(index)]
        if not maps:
            return np.zeros((0, *(self._item(0).shape if self._count else (0, 0))), np.float32)
        with self.row.naming(self.name):
            return np.stack(maps)


class TouchClip(read.LazySequence[UInt8, UInt8]):
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
    thing = "frame"
    things = "frames"

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

    def _several(self, index: Any) -> UInt8:
        return self.frames(index)

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
            A frame is damaged, or they exceed :data:`realtouch.touches.media.MAX_BATCH_PIXELS`.
        """
        frames = self.checked_indices(index)
        with self.row.naming("sensor_video", self.touch):
            pixels = images_array(len(frames), self.size)
        in_parallel(lambda index: self._item(frames[index], pixels[index]), len(frames), threads)
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
            return EncodedImage(data).size()

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
        number = self.checked_index(frame)
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
        self._item(frame, out)

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
            return contact.best_of(self.frames())[0]
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

    def _item(self, index: int, out: UInt8 | None = None) -> UInt8:
        try:
            return decode_image(self._avi.frame(index), out)
        except ValueError as error:
            raise self.row.damaged("sensor_video", f"frame {index}: {error}", self.touch) from error

    def __reduce__(self) -> tuple[object, ...]:
        return (TouchClip, (self.row, self.touch))

    def __repr__(self) -> str:
        return f"TouchClip(touch {self.touch}, {wording.with_count(len(self), 'frames')})"

    def _repr_html_(self) -> str:
        """Show frames from first to last in a notebook; those that are damaged are left out."""
        frames = evenly_spaced(len(self), _SHOWN_FRAMES)
        images = [(f"frame {frame}", partial(self.__getitem__, frame)) for frame in frames]
        return pictures.Drawn.grid_html(
            f"Touch {self.touch}", [wording.with_count(len(self), "frames")], images
        )


class SensorClips(_StoredMedia[TouchClip, list[TouchClip]]):
    """The clips of one round; each is opened on access, and raises as :class:`TouchClip`."""

    __slots__ = ()

    def __init__(self, row: stored_round.StoredRound, name: str = "sensor_video") -> None:
        row.entries_of(name)
        super().__init__(row, name)

    def _item(self, index: int) -> TouchClip:
        return TouchClip(self.row, index)

    def _several(self, index: Any) -> list[TouchClip]:
        return [TouchClip(self.row, touch) for touch in self.checked_indices(index)]

    def array_for(self, count: int, out: UInt8 | None = None) -> UInt8:
        """Return an array for ``count`` frames of the first clip's size: a new one, or ``out`` if it fits.

        Raises InputError when ``out`` cannot take them, IntegrityError when they exceed
        :data:`realtouch.touches.media.MAX_BATCH_PIXELS`.
        """
        size = self[0].size if self._count else (0, 0)
        with self.row.naming("sensor_video"):
            return images_array(count, size, out)


def contact_windows(row: stored_round.StoredRound, touch: int | None = None) -> list[slice]:
    """Return the frames of contact of every clip of a round, or of ``touch``.

    See :func:`realtouch.contact.contact_window`. Opens clips only where the times of frames are not stored.
    Raises IntegrityError when times are missing or impossible.
    """
    times = row.stamps_s(touch)
    if times is None:
        touches: Sequence[int] = [touch] if touch is not None else range(row.touch_total())
        times = [TouchClip(row, number).media_times_s for number in touches]
    ends = (time_s.tolist() for time_s in row.times_of_touches(touch))
    return [contact.contact_window(*times_of_touch) for times_of_touch in zip(times, *ends, strict=True)]


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
    return [window.start + int(np.argmin(poses.position_m[window, 2])) for poses, window in pressed]


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

    in_parallel(decode, len(encoded), threads)


def evenly_spaced(count: int, most: int) -> list[int]:
    """Choose up to ``most`` of ``count`` indices, first and last among them."""
    indices: list[int] = np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int)).tolist()
    return indices


def media_array(contents: pa.Array | Sequence[bytes | memoryview], names: Sequence[str]) -> pa.Array:
    """Return encoded images or clips, and the names of their files, as they are stored."""
    stored = contents if isinstance(contents, pa.Array) else pa.array(contents, pa.binary())
    parts = [stored, pa.array(names, pa.string())]
    return pa.StructArray.from_arrays(parts, fields=list(MEDIA_TYPE))


def numbered_media(contents: pa.Array | Sequence[bytes | memoryview], suffix: str) -> pa.Array:
    """Return the encoded images or clips of the touches of a round; their files are ``TOUCH.suffix``."""
    return media_array(contents, [f"{touch:03d}.{suffix}" for touch in range(len(contents))])


def image_column(images: pa.Array, names: Sequence[str]) -> pa.Array:
    """Return images as a column with file names, whose endings follow from their first bytes."""
    endings = (_ENDINGS.get(start, "webp") for start in pc.binary_slice(images, 0, 2).to_pylist())
    paths = [f"{name}.{ending}" for name, ending in zip(names, endings, strict=True)]
    return media_array(images, paths)


def as_jpeg(image: bytes | memoryview) -> bytes:
    """Return an image for readers that only know JPEG: unchanged, or encoded again."""
    return bytes(image) if EncodedImage(image).is_jpeg else encode_image(decode_image(image))


def decoded(image: bytes | memoryview, name: str, out: UInt8 | None = None) -> UInt8:
    """Return the pixels of an image; IntegrityError if it is damaged between its header and its end."""
    try:
        return decode_image(image, out)
    except ValueError as error:
        raise errors.IntegrityError(
            f"{name!r}: {error}",
            next="run `tactile verify` on the source, and leave the round out (`tactile select`)",
        ) from error
