"""The images of a round, decoded one at a time and only when asked for."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Lock
from typing import Any, TypeVar

import numpy as np

from realtouch.integrity.damage import damaged
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.nested import BytesColumn, nested_column
from tactile_toolkit.touch.jpeg import Pixels, decode_image, image_size, room_for

__all__ = ["SensorImages", "in_parallel", "positions_of"]

T = TypeVar("T")

_LONGEST_RUN = 16


class SensorImages(Sequence[Pixels]):
    """The images of one round; each is decoded when it is asked for, none is kept.

    ``images[i]`` gives (H, W, 3) uint8; a slice, list or array of ints, or boolean mask gives (n, H, W, 3).
    Safe to share between threads and to pickle.

    Parameters
    ----------
    row : Row
        The round.
    name : str
        Its column of images.
    """

    __slots__ = ("_blobs", "_count", "_name", "_row", "_start")

    def __init__(self, row: Row, name: str = "sensor_image") -> None:
        column = nested_column(row.group, name)
        start, stop = column.inside(0, row.index, row.index + 1)
        self._row, self._name = row, name
        self._blobs: BytesColumn = column.values
        self._start, self._count = start, stop - start

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: Any) -> Pixels:  # type: ignore[override]
        """Decode one image, or some into one array.

        Raises
        ------
        IntegrityError
            An image is damaged, or differs in size from the others asked for; names file, row and touch.
        """
        if isinstance(index, (slice, list, tuple, np.ndarray)):
            return self.batch(index)
        return self._decode(self._position(operator.index(index)))

    def __iter__(self) -> Iterator[Pixels]:
        return (self._decode(touch) for touch in range(self._count))

    def batch(self, index: Any = slice(None), *, threads: int = 1, out: Pixels | None = None) -> Pixels:
        """Decode several images into one array.

        Parameters
        ----------
        index : slice, sequence of int, or boolean mask
            Which touches; all by default.
        threads : int
            How many to decode at a time.
        out : ndarray, shape (n, H, W, 3), uint8, optional
            Where to put them, to spare the memory of a new array per batch; each image C-contiguous.

        Returns
        -------
        ndarray, shape (n, H, W, 3), uint8

        Raises
        ------
        InputError
            ``out`` is no such array.
        IntegrityError
            As for indexing; or the images exceed :data:`tactile_toolkit.touch.jpeg.MAX_BATCH_PIXELS`.
        """
        touches = positions_of(index, self._count)
        pixels = self.room(touches, out)
        self.decode_into(pixels, touches, threads=threads)
        return pixels

    def room(self, touches: Sequence[int], out: Pixels | None = None) -> Pixels:
        """Return an array for some images, shape (n, H, W, 3), uint8: a new one, or ``out`` if it fits.

        Raises
        ------
        InputError
            ``out`` is no array for images of that number and size.
        IntegrityError
            The first image is damaged, or all of them exceed the limits.
        """
        first = touches[0] if len(touches) else 0
        size = self.size(first) if self._count else (0, 0)
        return self._named(first, lambda: room_for(len(touches), size, out))

    def decode_into(self, out: Pixels, touches: Sequence[int], *, threads: int = 1) -> None:
        """Decode several images into an array that :meth:`room` has found to fit."""
        in_parallel(lambda place: self._decode(touches[place], out[place]), len(touches), threads)

    def encoded(self, touch: int) -> memoryview:
        """Return the stored bytes of one image, without a copy.

        Raises
        ------
        IntegrityError
            When none are stored.
        """
        position = self._position(touch)
        blob = self._blobs[self._start + position]
        if blob is None or len(blob) == 0:
            raise damaged(self._row, self._name, "no bytes are stored; expected a JPEG", position)
        return blob

    def size(self, touch: int = 0) -> tuple[int, int]:
        """Return height and width of one image from its header."""
        return self._named(touch, lambda: image_size(self.encoded(touch)))

    def _decode(self, touch: int, out: Pixels | None = None) -> Pixels:
        return self._named(touch, lambda: decode_image(self.encoded(touch), out))

    def _named(self, touch: int, work: Callable[[], T]) -> T:
        try:
            return work()
        except ValueError as error:
            raise damaged(self._row, self._name, str(error), touch) from error

    def _position(self, touch: int) -> int:
        if not -self._count <= touch < self._count:
            message = f"touch {touch} is out of range for {self._count} touches"
            raise IndexError(message)
        return touch + self._count if touch < 0 else touch

    def __reduce__(self) -> tuple[Any, ...]:
        return (SensorImages, (self._row, self._name))

    def __repr__(self) -> str:
        return f"SensorImages({self._count} touches)"


def in_parallel(work: Callable[[int], object], count: int, threads: int) -> None:
    """Do ``count`` pieces of work, numbered from 0, in some threads, the calling one among them.

    Each takes a run of pieces at a time: neighbours share pages of the array that they are written to, and a
    thread that is held up leaves the rest to the others. The first error ends all of them.
    """
    threads = min(threads, count)
    if threads <= 1:
        for piece in range(count):
            work(piece)
        return
    runs, one_at_a_time = iter(_runs(count, threads)), Lock()

    def taken() -> range:
        with one_at_a_time:
            return next(runs, range(0))

    def share() -> None:
        try:
            while run := taken():
                for piece in run:
                    work(piece)
        except BaseException:
            while taken():
                pass
            raise

    with ThreadPoolExecutor(threads - 1) as pool:
        others = [pool.submit(share) for _ in range(threads - 1)]
        share()
        for other in others:
            other.result()


def _runs(count: int, threads: int) -> list[range]:
    length = max(1, min(_LONGEST_RUN, count // (4 * threads)))
    return [range(start, min(start + length, count)) for start in range(0, count, length)]


def positions_of(index: Any, count: int) -> Sequence[int]:
    """Turn a slice, ints or a boolean mask into places below ``count``.

    Raises
    ------
    IndexError
        A place out of range, or a mask of another length.
    TypeError
        Anything else.
    """
    if isinstance(index, slice):
        return range(*index.indices(count))
    places = np.asarray(index)
    if places.dtype == bool:
        if places.shape != (count,):
            message = f"a boolean mask of shape {places.shape} for {count} items"
            raise IndexError(message)
        return np.flatnonzero(places).tolist()
    if places.ndim != 1 or (places.size and places.dtype.kind not in "iu"):
        message = f"items are chosen by a slice, ints or booleans, not {places.dtype} of shape {places.shape}"
        raise TypeError(message)
    if places.size and not -count <= places.min() <= places.max() < count:
        message = f"index {places.min()} to {places.max()} is out of range for {count} items"
        raise IndexError(message)
    return [int(place) % count for place in places]
