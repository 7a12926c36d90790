"""Rows of a training set: one picture each, and how depth is stored as one."""

from __future__ import annotations

import io
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from tactile_toolkit.rows import column, plain_schema, row
from tactile_toolkit.touch.jpeg import MAX_IMAGE_PIXELS
from tactile_toolkit.touch.schema import MEDIA_TYPE, with_features

SPLITS = ("depth", "real")

DEPTH_LEVELS = 65535
"""Levels from deepest in the gel to no contact: 0.03 micrometres each."""


_PICTURE = "depth: grey, 16 bits, 0 deepest in the gel, 65535 no contact; real: colours"


@row
class PairRow:
    """One depth image or one real touch, encoded."""

    id: str = column(pa.string(), "", "object and number, or round and touch")
    label: int = column(pa.int64(), "", "class of the touched object")
    object_id: int = column(pa.int64(), "", "`id` of its mesh")
    contact: bool = column(pa.bool_(), "", "whether the gel met the object")
    image: Mapping[str, Any] = column(MEDIA_TYPE, "H x W", _PICTURE, name="sensor_image")


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
        raise ValueError(f"a depth image of {len(data):,} bytes that cannot be decoded ({error})") from error
    if levels.ndim != 2 or levels.dtype.kind not in "ui" or mode not in ("I;16", "I"):
        raise ValueError(f"a picture of mode {mode}; expected a grey PNG of 16 bits")
    return (levels / np.float32(DEPTH_LEVELS)).astype(np.float32)


@cache
def pair_schema(class_names: tuple[str, ...]) -> pa.Schema:
    """Return the Arrow schema of a shard."""
    return with_features(plain_schema(PairRow), class_names)
