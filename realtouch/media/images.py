"""The images of a round, decoded one at a time and only when asked for; and work shared by threads."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Lock
from typing import Any

import numpy as np

from realtouch.damage import damaged
from tactile_toolkit.read.columns import BytesColumn
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.sequence import checked_index, positions
from tactile_toolkit.touch.jpeg import Pixels, decode_image, image_size, room_for

# Long enough that taking a run costs nothing, short enough that threads end together.
_LONGEST_RUN = 16


class SensorImages(Sequence[Pixels]):
    """The images of one round; each is decoded when it is asked for, none is kept.

    ``images[i]`` gives (H, W, 3) uint8; a slice, list or array of ints, or boolean mask gives (n, H, W, 3).
    Safe to share between threads and to pickle.
    """

    __slots__ = ("_blobs", "_count", "_name", "_row", "_start")

    def __init__(self, row: Row, name: str = "sensor_image") -> None:
        column = row.group.nested(name)
        start, stop = column.inside(0, row.index, row.index + 1)
        self._row, self._name = row, name
        self._blobs: BytesColumn = column.values
        self._start, self._count = start, stop - start

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: Any) -> Pixels:  # type: ignore[override]
        """Decode one image, or some into one array.

        Raises IntegrityError when an image is damaged, or differs in size from the others asked for; it names
        file, row and touch.
        """
        if isinstance(index, (slice, list, tuple, np.ndarray)):
            return self.batch(index)
        return self._decode(checked_index(operator.index(index), self._count, "touch", "touches"))

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
            ``out`` is not such an array.
        IntegrityError
            As for indexing; or the images exceed :data:`tactile_toolkit.touch.jpeg.MAX_BATCH_PIXELS`.
        """
        touches = positions(index, self._count).tolist()
        first = touches[0] if len(touches) else 0
        size = self.size(first) if self._count else (0, 0)
        try:
            pixels = room_for(len(touches), size, out)
        except ValueError as error:
            raise damaged(self._row, self._name, str(error), first) from error
        self.decode_into(pixels, touches, threads=threads)
        return pixels

    def decode_into(self, out: Pixels, touches: Sequence[int], *, threads: int = 1) -> None:
        """Decode several images into an array of their size, such as ``room_for`` gives."""
        in_parallel(lambda index: self._decode(touches[index], out[index]), len(touches), threads)

    def encoded(self, touch: int) -> memoryview:
        """Return the stored bytes of one image, without a copy; raises IntegrityError when there are none."""
        place = checked_index(touch, self._count, "touch", "touches")
        blob = self._blobs[self._start + place]
        if blob is None or len(blob) == 0:
            raise damaged(self._row, self._name, "no bytes are stored; expected a JPEG", place)
        return blob

    def size(self, touch: int = 0) -> tuple[int, int]:
        """Return height and width of one image from its header."""
        try:
            return image_size(self.encoded(touch))
        except ValueError as error:
            raise damaged(self._row, self._name, str(error), touch) from error

    def _decode(self, touch: int, out: Pixels | None = None) -> Pixels:
        try:
            return decode_image(self.encoded(touch), out)
        except ValueError as error:
            raise damaged(self._row, self._name, str(error), touch) from error

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
    length = max(1, min(_LONGEST_RUN, count // (4 * threads)))
    runs = iter(range(start, min(start + length, count)) for start in range(0, count, length))
    one_at_a_time = Lock()

    def next_run() -> range:
        with one_at_a_time:
            return next(runs, range(0))

    def share() -> None:
        try:
            while run := next_run():
                for piece in run:
                    work(piece)
        # The others would continue with pieces that nobody wants any more.
        except BaseException:
            while next_run():
                pass
            raise

    # Decoders leave the interpreter's lock; what they write is one array, so that nothing is handed back.
    with ThreadPoolExecutor(threads - 1) as pool:
        others = [pool.submit(share) for _ in range(threads - 1)]
        share()
        for other in others:
            other.result()
