"""The images of a round, decoded when they are asked for; work shared by threads; sheets of pictures."""

from __future__ import annotations

import html
import operator
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from realtouch.damage import damaged, naming
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.pictures.sheets import TILE_STYLE, Sheet, Tile, figure_html, sheet
from tactile_toolkit.read.columns import BytesColumn
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.sequence import checked_index, positions
from tactile_toolkit.run.threads import in_threads
from tactile_toolkit.touch.jpeg import Pixels, decode_image, image_size, resized, room_for

# Long enough that taking a run costs nothing, short enough that threads end together.
_LONGEST_RUN = 16


class SensorImages(Sequence[Pixels]):
    """The images of one round; each is decoded when it is asked for, none is kept.

    ``images[i]`` gives (H, W, 3) uint8; a slice, list or array of ints, or boolean mask gives (n, H, W, 3).
    Safe to share between threads and to pickle.
    """

    __slots__ = ("_blobs", "_count", "_row", "_start")

    def __init__(self, row: Row) -> None:
        column = row.group.nested("sensor_image")
        start, stop = column.inside(0, row.index, row.index + 1)
        self._row = row
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
        with naming(self._row, "sensor_image", first):
            pixels = room_for(len(touches), size, out)
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
            raise damaged(self._row, "sensor_image", "no bytes are stored; expected a JPEG", place)
        return blob

    def size(self, touch: int = 0) -> tuple[int, int]:
        """Return height and width of one image from its header."""
        with naming(self._row, "sensor_image", touch):
            return image_size(self.encoded(touch))

    def _decode(self, touch: int, out: Pixels | None = None) -> Pixels:
        with naming(self._row, "sensor_image", touch):
            return decode_image(self.encoded(touch), out)

    def __reduce__(self) -> tuple[Any, ...]:
        return (SensorImages, (self._row,))

    def __repr__(self) -> str:
        return f"SensorImages({self._count} touches)"


def in_parallel(work: Callable[[int], object], count: int, threads: int) -> None:
    """Do ``count`` pieces of work, numbered from 0, in some threads; the first error ends all of them.

    Each takes a run of pieces at a time: neighbours share pages of the array that they are written to.
    """
    length = max(1, min(_LONGEST_RUN, count // max(1, 4 * threads)))
    runs = (range(start, min(start + length, count)) for start in range(0, count, length))
    deque(in_threads(lambda run: deque(map(work, run), maxlen=0), runs, max(1, threads)), maxlen=0)


MOST_TILES = 32
"""Touches that a notebook shows of a round."""

_TILE_WIDTH = 120
_GAP = 4


def evenly_spaced(count: int, most: int) -> list[int]:
    """Choose up to ``most`` of ``count`` indices, first and last among them."""
    indices: list[int] = np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int)).tolist()
    return indices


def fitted(image: Pixels, width: int) -> Pixels:
    """Return an image, (H, W, 3), at another width in pixels, its proportions kept."""
    return resized(image, width, max(1, round(width * image.shape[0] / image.shape[1])))


def contact_sheet(images: Sequence[Pixels], columns: int = 8, tile_width: int = _TILE_WIDTH) -> Pixels:
    """Lay RGB images, (H, W, 3), out in rows of ``columns``, each ``tile_width`` pixels wide.

    All get the proportions of the first.
    """
    height = fitted(images[0], tile_width).shape[0]
    tiles = [Tile(resized(image, tile_width, height)) for image in images]
    return sheet(tiles, Sheet(min(columns, len(images)), gap_px=_GAP, margin_px=_GAP))


def round_html(title: str, words: Sequence[str], pictures: Sequence[tuple[str, Callable[[], Pixels]]]) -> str:
    """Return a notebook's view of a round: a caption, which counts damaged pictures, and the others."""
    tiles = []
    for caption, read in pictures:
        with suppress(IntegrityError):
            tiles.append(touch_html(read(), caption))
    if len(tiles) < len(pictures):
        missing = f"{len(pictures) - len(tiles)} of {len(pictures)} pictures cannot be shown"
        words = [*words, missing]
    grid = f'<div style="display:flex;flex-wrap:wrap;gap:{_GAP}px">{"".join(tiles)}</div>'
    return f"<div><b>{html.escape(title)}</b>: {', '.join(words)}{grid}</div>"


def touch_html(picture: Pixels, caption: str) -> str:
    """Return a notebook's view of a touch: its picture and what it is."""
    return figure_html(fitted(picture, _TILE_WIDTH), caption, TILE_STYLE)
