"""Stored images: checks, file names, and encoding where a reader needs JPEG."""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence

import numpy as np
import pyarrow as pa
from PIL import Image

from realtouch.contact import median_in_memory
from tactile_toolkit.array_types import UInt8
from tactile_toolkit.errors import InputError, IntegrityError, ItemError
from tactile_toolkit.touch import MEDIA_TYPE, decode_image, encode_image, image_size, is_jpeg

_JPEG_END = b"\xff\xd9"
_ENDINGS = {b"\xff\xd8": "jpg", b"\x89P": "png"}

_ORIENTATION = 0x0112
_TURNED = range(2, 9)
_APP1 = b"\xff\xe1"  # these bytes never occur within coded pixels


def require_intact(data: bytes | memoryview) -> tuple[int, int]:
    """Return height and width of an image, after a check of its beginning and end.

    The pixels of a JPEG are not decoded, which would take longer than all other work, unless bytes follow the
    mark of its end: cameras send whole buffers, and encoders of clips pad to even lengths. Raises ValueError
    if the image is damaged.
    """
    size = image_size(data)
    if not is_jpeg(data):
        decode_image(data)
    elif bytes(data[-2:]) != _JPEG_END and not bytes(data[-16:]).rstrip(b"\0").endswith(_JPEG_END):
        try:
            decode_image(data)
        except ValueError as error:
            raise ValueError(
                f"an image of {len(data):,} bytes without the mark of its end; expected a whole JPEG"
            ) from error
    return size


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


def upright_size(picture: bytes | ItemError, expected: tuple[int, int] | None) -> tuple[int, int]:
    """Return the size of a picture; ItemError unless it is intact, upright and of the expected size."""
    if isinstance(picture, ItemError):
        raise picture
    try:
        size = require_intact(picture)
    except ValueError as error:
        raise ItemError("image", str(error)) from error
    if _is_turned(picture):
        raise ItemError(
            "image", "its Exif or XMP data ask to turn it, which some readers do; expected an upright image"
        )
    if expected is not None and size != expected:
        (height, width), (common_height, common_width) = size, expected
        raise ItemError(
            "size", f"{width} x {height} pixels; expected {common_width} x {common_height} as most images"
        )
    return size


def _is_turned(image: bytes) -> bool:
    """Return whether Exif or XMP data ask readers to turn the image."""
    if is_jpeg(image) and _APP1 not in image:
        return False  # JPEGs have both in such a segment, and opening an image takes a while
    try:
        with Image.open(io.BytesIO(image), formats=["JPEG", "PNG", "WEBP"]) as opened:
            return opened.getexif().get(_ORIENTATION) in _TURNED
    except (OSError, SyntaxError, ValueError, TypeError, struct.error):
        return False  # such data do not turn the image
