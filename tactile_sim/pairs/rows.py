"""Rows of a training set: one picture each, and how depth is stored as one."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.store.parquet import ParquetStyle
from tactile_toolkit.touch.jpeg import MAX_IMAGE_PIXELS
from tactile_toolkit.touch.schema import MEDIA_TYPE, with_features

__all__ = [
    "DEPTH_LEVELS",
    "PairRow",
    "decode_depth",
    "depth_levels",
    "encode_depth",
    "pair_table",
    "pairs_style",
]

DEPTH_LEVELS = 65535
"""Levels from deepest in the gel to no contact: 0.03 micrometres each."""


@dataclass(frozen=True, slots=True, eq=False)
class PairRow:
    """One depth image or one real touch, encoded."""

    id: str
    label: int
    object_id: int
    contact: bool
    image: bytes


def depth_levels(image: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Return a depth image, 0 to 1, as 16-bit levels; one of zeros, a level surface, as no contact."""
    # A level surface and a bare plate give the same image; the paper's 'non-contact 0' is the plate.
    if not image.any():
        return np.full(image.shape, DEPTH_LEVELS, np.uint16)
    return np.rint(image.astype(np.float64) * DEPTH_LEVELS).astype(np.uint16)


def encode_depth(levels: NDArray[np.uint16]) -> bytes:
    """Encode 16-bit levels, shape (H, W), as a grey PNG."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(levels).save(stream, "PNG", compress_level=6)
    return stream.getvalue()


def decode_depth(data: bytes) -> NDArray[np.float32]:
    """Decode a PNG of :func:`encode_depth` to a depth image, 0 to 1; ValueError for other pictures."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
            if image.width * image.height > MAX_IMAGE_PIXELS:
                problem = f"{image.width} x {image.height} pixels; the limit is {MAX_IMAGE_PIXELS:,} pixels"
                raise ValueError(problem)
            mode, levels = image.mode, np.asarray(image)
    except Exception as error:  # Pillow raises OSError, SyntaxError, struct.error and more on bad files
        message = f"a depth image of {len(data):,} bytes that cannot be decoded ({error})"
        raise ValueError(message) from error
    if levels.ndim != 2 or levels.dtype.kind not in "ui" or mode not in ("I;16", "I"):
        message = f"a picture of mode {mode}; expected a grey PNG of 16 bits"
        raise ValueError(message)
    return (levels / np.float32(DEPTH_LEVELS)).astype(np.float32)


def pair_table(rows: Sequence[PairRow], class_names: tuple[str, ...], suffix: str) -> Any:
    """Pack rows into an Arrow table; ``suffix`` names the format of the pictures."""
    import pyarrow as pa

    types = [
        ("id", pa.string()),
        ("label", pa.int64()),
        ("object_id", pa.int64()),
        ("contact", pa.bool_()),
        ("sensor_image", MEDIA_TYPE),
    ]
    schema = with_features(pa.schema(types), class_names)
    images = [{"bytes": row.image, "path": f"{row.id}.{suffix}"} for row in rows]
    columns = [[getattr(row, name) for row in rows] for name, _ in types[:-1]]
    arrays = [pa.array(values, each.type) for values, each in zip([*columns, images], schema, strict=True)]
    return pa.Table.from_arrays(arrays, schema=schema)


def pairs_style() -> ParquetStyle:
    """Return the layout of shards: pictures do not compress again."""
    return ParquetStyle(100, compression_level=3, encodings=(("sensor_image.bytes", "PLAIN"),))
