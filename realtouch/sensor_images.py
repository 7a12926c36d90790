"""The images of a round, decoded on access; arrays and threads for many pictures."""

from __future__ import annotations

import operator
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from realtouch.stored_round import StoredRound
from tactile_toolkit import errors, read, wording
from tactile_toolkit.array_types import UInt8
from tactile_toolkit.run import in_threads
from tactile_toolkit.touch import decode_image, image_size

# Long enough that overhead is small, short enough that threads end together.
_LONGEST_RUN = 16
MAX_BATCH_PIXELS = 1 << 31
"""Most pixels that are decoded into one new array (6 GiB): every frame of 256 clips of 90 frames fits."""


def in_parallel(work: Callable[[int], object], count: int, threads: int) -> None:
    """Process items 0 to ``count`` - 1 in threads; the first error ends all of them.

    A thread takes a run of items at a time, as neighbours share pages of the array that they are written to.
    """
    length = max(1, min(_LONGEST_RUN, count // max(1, 4 * threads)))
    runs = (range(start, min(start + length, count)) for start in range(0, count, length))
    deque(in_threads(lambda run: deque(map(work, run), maxlen=0), runs, max(1, threads)), maxlen=0)


def room_for(count: int, size: tuple[int, int], out: UInt8 | None = None) -> UInt8:
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
    found = f"{out.dtype} of shape {out.shape}" if isinstance(out, np.ndarray) else type(out).__name__
    raise errors.InputError(
        f"out is {found}; expected a writable array of uint8 and shape {shape} with C-contiguous images",
        next=f"make one with numpy.empty({shape}, numpy.uint8), or leave `out` out",
    )


class SensorImages(Sequence[UInt8]):
    """The images of one round; each is decoded on every access and not kept.

    ``images[i]`` gives (H, W, 3) uint8; a slice, list or array of ints, or boolean mask gives (n, H, W, 3).
    Safe to share between threads and to pickle.
    """

    __slots__ = ("_blobs", "_count", "_start", "row")

    def __init__(self, row: StoredRound) -> None:
        column = row.group.nested("sensor_image")
        start, stop = column.inside(0, row.index, row.index + 1)
        self.row = row
        self._blobs: read.BytesColumn = column.values
        self._start, self._count = start, stop - start

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: Any) -> UInt8:  # type: ignore[override]
        """Decode one image, or some into one array.

        Raises IntegrityError, which names file, row and touch, if an image is damaged, or differs in size
        from the other requested ones.
        """
        if read.picks_several(index):
            return self.batch(index)
        return self._decode(read.checked_index(operator.index(index), self._count, "touch", "touches"))

    def __iter__(self) -> Iterator[UInt8]:
        return (self._decode(touch) for touch in range(self._count))

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
            As for indexing; or the images exceed :data:`realtouch.sensor_images.MAX_BATCH_PIXELS`.
        """
        touches = read.positions(index, self._count).tolist()
        first, size = [*touches, 0][0], (0, 0)
        if self._count:
            size = self.size(first)
        with self.row.naming("sensor_image", first):
            pixels = room_for(len(touches), size, out)
        self.decode_into(pixels, touches, threads=threads)
        return pixels

    def decode_into(self, out: UInt8, touches: Sequence[int], *, threads: int = 1) -> None:
        """Decode several images into an array of their size, such as ``room_for`` gives."""
        in_parallel(lambda index: self._decode(touches[index], out[index]), len(touches), threads)

    def encoded(self, touch: int) -> memoryview:
        """Return the stored bytes of one image, without a copy; IntegrityError if no bytes are stored."""
        place = read.checked_index(touch, self._count, "touch", "touches")
        blob = self._blobs[self._start + place]
        if blob is None or len(blob) == 0:
            raise self.row.damaged("sensor_image", "no bytes are stored; expected a JPEG", place)
        return blob

    def size(self, touch: int = 0) -> tuple[int, int]:
        """Return height and width of one image from its header."""
        with self.row.naming("sensor_image", touch):
            return image_size(self.encoded(touch))

    def _decode(self, touch: int, out: UInt8 | None = None) -> UInt8:
        with self.row.naming("sensor_image", touch):
            return decode_image(self.encoded(touch), out)

    def __reduce__(self) -> tuple[object, ...]:
        return (SensorImages, (self.row,))

    def __repr__(self) -> str:
        return f"SensorImages({wording.with_count(self._count, 'touches')})"
