"""Depth maps, stored as images of 16 bits in whole micrometres.

A map states how far each point of the gel is pressed in: 0 where nothing touches it, at most 65,535 um. A
second map states the expected error of each pixel.
"""

from __future__ import annotations

import io
import operator
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from PIL import Image

from realtouch.stored_round import StoredRound
from tactile_toolkit import errors, read, wording
from tactile_toolkit.array_types import Float32, Floating
from tactile_toolkit.touch import MAX_IMAGE_PIXELS

DEPTH, DEPTH_ERROR = "depth_um", "depth_error_um"
"""Columns of the maps of a round of images, with an entry for each touch."""

SUFFIX = "png"

_PER_M, _MOST = 1e6, 65_535
_MODES = ("I;16", "I;16B")


def encode_map(depth_m: Floating) -> bytes:
    """Encode a depth map, (H, W), metres, as PNG; negative values become 0.

    Raises InputError for values that are not finite, or exceed 65.535 mm.
    """
    if not np.isfinite(depth_m).all() or depth_m.max(initial=0) * _PER_M > _MOST:
        raise errors.InputError(
            f"depth of {np.max(depth_m):g} m; expected finite numbers of at most {_MOST / _PER_M} m"
        )
    counts = np.rint(np.maximum(depth_m, 0) * _PER_M).astype(np.uint16)
    stream = io.BytesIO()
    # A fixed level, as for images: the default may change with a release.
    Image.fromarray(counts).save(stream, "PNG", compress_level=6)
    return stream.getvalue()


def decode_map(data: memoryview | bytes) -> Float32:
    """Decode a depth map, shape (H, W), float32, metres; ValueError for any other file."""
    try:
        image = Image.open(io.BytesIO(data), formats=["PNG"])
        is_depth = image.mode in _MODES and image.width * image.height <= MAX_IMAGE_PIXELS
        counts = np.asarray(image) if is_depth else None
    except Exception as error:  # Pillow raises many kinds on damaged files
        raise ValueError("a depth map that cannot be decoded; expected a PNG of 16 bits") from error
    if counts is None:
        raise ValueError(
            f"{image.width} x {image.height} pixels ({image.mode}); expected a grey PNG of 16 bits and "
            f"at most {MAX_IMAGE_PIXELS:,} pixels"
        )
    return counts.astype(np.float32) / np.float32(_PER_M)


class DepthMaps(Sequence[Float32]):
    """The maps of one round; each is decoded on every access and not kept.

    ``maps[i]`` gives (H, W), float32, metres; a slice, list or array of ints, or boolean mask (n, H, W).
    """

    __slots__ = ("_blobs", "_column", "_count", "_start", "row")

    def __init__(self, row: StoredRound, column: str) -> None:
        found, start, stop = row.entries_of(column)  # refuses a round with more or less than T maps
        self.row = row
        self._column, self._start, self._count = column, start, stop - start
        self._blobs: read.BytesColumn = found.values

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: Any) -> Float32:  # type: ignore[override]
        """Decode one map, or several of the same size; IntegrityError if one is damaged."""
        if read.picks_several(index):
            return np.stack([self._decode(touch) for touch in read.positions(index, self._count).tolist()])
        return self._decode(read.checked_index(operator.index(index), self._count, "touch", "touches"))

    def __iter__(self) -> Iterator[Float32]:
        return map(self._decode, range(self._count))

    def _decode(self, touch: int) -> Float32:
        with self.row.naming(self._column, touch):
            return decode_map(self._blobs[self._start + touch] or b"")

    def __reduce__(self) -> tuple[object, ...]:
        return (DepthMaps, (self.row, self._column))

    def __repr__(self) -> str:
        return f"DepthMaps({wording.with_count(self._count, 'touches')})"
