"""Encoded pictures to pixels and back.

JPEGs are decoded by libjpeg with its exact integer transform, so that every machine sees the same pixels. The
interpreter lock is released meanwhile.
"""

from __future__ import annotations

import io
from contextlib import suppress
from typing import Any, Literal

import numpy as np
import simplejpeg

from tactile_toolkit.array_types import UInt8

MAX_IMAGE_PIXELS = 1 << 24
"""Largest image that is decoded (4096 x 4096); a sensor's has 76,800 pixels."""

MAX_IMAGE_BYTES = 1 << 26
"""Largest encoded image that is looked at."""

MAX_SCANS = 100
"""Most scans of a JPEG that is decoded: each goes over the picture again, and a few bytes make one; cameras
write 1, progressive files about 10."""

# So much holds a few hundred scans at most, of which the largest image takes less than a second.
_SMALL_BYTES = 1 << 12

MAX_HEADER_BYTES = 1 << 22
"""Most bytes of a JPEG before its first scan: four make a segment, and Pillow keeps an object for each."""


ImageFormat = Literal["jpeg", "png"]
IMAGE_SUFFIX: dict[ImageFormat, str] = {"jpeg": "jpg", "png": "png"}
"""How the names of stored images end."""

_JPEG_START = b"\xff\xd8\xff"
# Modes of Pillow whose values it cuts at 255 when it makes colours of them.
_DEEP = ("I", "I;16", "I;16B", "I;16L", "I;16N", "F")


def is_jpeg(data: memoryview | bytes) -> bool:
    """Return whether data begins as a JPEG does."""
    return data[:3] == _JPEG_START


def image_size(data: memoryview | bytes) -> tuple[int, int]:
    """Read height and width of a JPEG, PNG or WebP from its header, decoding nothing.

    Raises ValueError when the data is not such an image, or exceeds the limits above.
    """
    mode, pictures = "", 1
    if is_jpeg(data):
        require_bounded_jpeg(data)
    try:
        if is_jpeg(data):
            height, width, *_ = simplejpeg.decode_jpeg_header(data)
        else:
            image = _opened(data)
            height, width, mode = image.height, image.width, image.mode
            pictures = getattr(image, "n_frames", 1)
    except Exception as error:
        raise _undecodable(data) from error
    if pictures > 1:
        raise ValueError(f"an image of {pictures:,} pictures, one after the other; expected one")
    if mode in _DEEP:
        raise ValueError(f"an image of 16 bits ({mode}), most of which 8 would lose; expected 8")
    if height * width > MAX_IMAGE_PIXELS:
        raise ValueError(f"an image of {width} x {height} pixels; the limit is {MAX_IMAGE_PIXELS:,} pixels")
    return height, width


def require_bounded_jpeg(data: memoryview | bytes) -> None:
    """Raise ValueError where a JPEG has too many scans or too long a header, before it is decoded."""
    if len(data) <= _SMALL_BYTES:  # a touch of 64 x 64 pixels takes 1 kB, and the look a tenth of its time
        return
    # In coded pixels this pair of bytes does not occur (ITU-T T.81, B.1.1.5).
    stored = bytes(data)
    scans, header = stored.count(b"\xff\xda"), stored.find(b"\xff\xda")
    if scans > MAX_SCANS:
        raise ValueError(f"a JPEG of {scans:,} scans; the limit is {MAX_SCANS}")
    if header > MAX_HEADER_BYTES:
        raise ValueError(f"a JPEG whose header takes {header:,} bytes; the limit is {MAX_HEADER_BYTES:,}")


def decode_image(data: memoryview | bytes, out: UInt8 | None = None) -> UInt8:
    """Decode a whole JPEG, PNG or WebP to RGB, shape (H, W, 3), uint8; into ``out``, contiguous, if given.

    Raises ValueError as :func:`image_size`, and when the data is cut short or corrupt, or has another size
    than ``out``. Nothing half-decoded is ever returned.
    """
    if out is not None and is_jpeg(data):
        require_bounded_jpeg(data)
        # What is wrong is named below: to look into the header of each image first takes a while.
        with suppress(ValueError):
            if simplejpeg.decode_jpeg(data, "RGB", buffer=out).shape == out.shape:
                return out
    height, width = image_size(data)
    if out is not None and out.shape != (height, width, 3):
        raise ValueError(
            f"an image of {width} x {height} pixels; expected {out.shape[1]} x {out.shape[0]} as before it"
        )
    pixels: UInt8
    try:
        if is_jpeg(data):
            pixels = simplejpeg.decode_jpeg(data, "RGB", buffer=out)
        else:
            pixels = np.asarray(_opened(data).convert("RGB"))
    except Exception as error:
        raise _undecodable(data) from error
    if out is None or pixels is out:
        return pixels
    out[...] = pixels
    return out


def _opened(data: memoryview | bytes) -> Any:
    from PIL import Image

    # Pillow would try its 43 decoders on whatever these bytes are.
    return Image.open(io.BytesIO(data), formats=["PNG", "WEBP"])


def _undecodable(data: memoryview | bytes) -> ValueError:
    # Pillow raises OSError, SyntaxError, struct.error and more on bad files. What they say differs between
    # releases, and may hold the address of an object; what is said here is stored.
    start = bytes(data[:8]).hex(" ") or "nothing"
    return ValueError(
        f"an image of {len(data):,} bytes that begin with {start} cannot be decoded; expected a JPEG, "
        f"PNG or WebP, intact and of at most {MAX_IMAGE_PIXELS:,} pixels"
    )


def encode_image(pixels: UInt8, kind: ImageFormat = "jpeg", quality: int = 95) -> bytes:
    """Encode RGB pixels, shape (H, W, 3), uint8; the same pixels give the same bytes.

    ``quality`` is that of a JPEG, 1 to 100, which keeps the colour resolution whole (4:4:4).
    """
    from PIL import Image

    stream = io.BytesIO()
    if kind == "png":
        # Pillow's own level, said here so that another release writes the same bytes.
        Image.fromarray(pixels).save(stream, "PNG", compress_level=6)
    else:
        Image.fromarray(pixels).save(stream, "JPEG", quality=quality, subsampling=0)
    return stream.getvalue()


def resized(pixels: UInt8, width: int, height: int) -> UInt8:
    """Return an image in another size, shape (height, width, 3), uint8.

    Smaller: each pixel is the mean of the area that it covers. Larger: bilinear.
    """
    from PIL import Image

    image = Image.fromarray(pixels)
    smaller = width <= image.width and height <= image.height
    method = Image.Resampling.BOX if smaller else Image.Resampling.BILINEAR
    return np.asarray(image.resize((width, height), method))
