"""Stored images: columns with file names, and encoding where a reader needs JPEG."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa

from realtouch.contact import median_in_memory
from tactile_toolkit.array_types import UInt8
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.touch import MEDIA_TYPE, decode_image, encode_image, image_size, is_jpeg

_ENDINGS = {b"\xff\xd8": "jpg", b"\x89P": "png"}


def media_array(contents: Sequence[bytes | memoryview], names: Sequence[str]) -> pa.Array:
    """Return encoded images or clips, and the names of their files, as they are stored."""
    parts = [pa.array(contents, pa.binary()), pa.array(names, pa.string())]
    return pa.StructArray.from_arrays(parts, fields=list(MEDIA_TYPE))


def numbered_media(contents: Sequence[bytes | memoryview], suffix: str) -> pa.Array:
    """Return the encoded images or clips of the touches of a round; their files are ``TOUCH.suffix``."""
    return media_array(contents, [f"{touch:03d}.{suffix}" for touch in range(len(contents))])


def image_column(images: Sequence[bytes | memoryview], names: Sequence[str]) -> pa.Array:
    """Return images as a column with file names, whose endings follow from their first bytes."""
    endings = (_ENDINGS.get(bytes(each[:2]), "webp") for each in images)
    paths = [f"{name}.{ending}" for name, ending in zip(names, endings, strict=True)]
    return media_array(images, paths)


def as_jpeg(image: bytes | memoryview) -> bytes:
    """Return an image for readers that only know JPEG: unchanged, or encoded again."""
    return bytes(image) if is_jpeg(image) else encode_image(decode_image(image))


def decoded(image: bytes | memoryview, name: str, out: UInt8 | None = None) -> UInt8:
    """Return the pixels of an image; IntegrityError if it is damaged between its header and its end."""
    try:
        return decode_image(image, out)
    except ValueError as error:
        raise IntegrityError(
            f"{name!r}: {error}",
            next="run `realtouch verify` on the source, and leave the round out first (`realtouch select`)",
        ) from error


def background_of(images: Sequence[bytes | memoryview], names: Sequence[str]) -> bytes:
    """Return the median of some images as JPEG: the gel at rest; InputError if they differ in size.

    Raises IntegrityError, with the name, for one that cannot be decoded.
    """
    sizes = {image_size(image) for image in images}
    if len(sizes) > 1:
        found = ", ".join(f"{width} x {height}" for height, width in sorted(sizes))
        raise InputError(
            f"images of {found} pixels have no common background; expected one size",
            next="make them alike with `realtouch resize`",
        )
    pixels = [decoded(image, name) for image, name in zip(images, names, strict=True)]
    return encode_image(median_in_memory(np.stack(pixels)))
