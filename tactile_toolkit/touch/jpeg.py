"""Encoded pictures to pixels and back.

The reference decoder is libjpeg with its exact integer transform: simplejpeg where it is installed, else
Pillow; both give the same pixels bit for bit. The interpreter lock is released while a JPEG is decoded.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.errors import InputError

__all__ = [
    "MAX_BATCH_PIXELS",
    "MAX_IMAGE_BYTES",
    "MAX_IMAGE_PIXELS",
    "Pixels",
    "decode_image",
    "encode_image",
    "image_size",
    "resized",
    "room_for",
]

MAX_IMAGE_PIXELS = 1 << 24
"""Largest image that is decoded (4096 x 4096); a sensor's has 76,800 pixels."""

MAX_IMAGE_BYTES = 1 << 26
"""Largest encoded image that is looked at."""

MAX_BATCH_PIXELS = 1 << 31
"""Most pixels that are decoded into one new array (6 GiB): every frame of 256 clips of 90 frames fits."""

_JPEG_START = b"\xff\xd8\xff"
_OTHER_FORMATS = ("PNG", "WEBP")
Pixels = NDArray[np.uint8]
"""Colours as red, green, blue; 0 to 255."""


def decode_image(data: memoryview | bytes, out: Pixels | None = None) -> Pixels:
    """Decode one image.

    Parameters
    ----------
    data : bytes-like
        A whole JPEG, PNG or WebP.
    out : ndarray, shape (H, W, 3), uint8, optional
        Where to put the pixels; must have the size of the image and be contiguous.

    Returns
    -------
    ndarray, shape (H, W, 3), uint8
        RGB.

    Raises
    ------
    ValueError
        The data is no such image, is cut short or corrupt, exceeds :data:`MAX_IMAGE_PIXELS` or
        :data:`MAX_IMAGE_BYTES`, or has another size than ``out``. Nothing half-decoded is ever returned.
    """
    height, width = image_size(data)
    if out is not None and out.shape != (height, width, 3):
        message = (
            f"an image of {width} x {height} pixels; expected {out.shape[1]} x {out.shape[0]} as before it"
        )
        raise ValueError(message)
    if bytes(data[:3]) != _JPEG_START:
        return _placed(_pillow_pixels(data), out)
    return _JPEG[0](data, out)


def image_size(data: memoryview | bytes) -> tuple[int, int]:
    """Read the height and width of an image from its header, decoding nothing.

    Raises
    ------
    ValueError
        As :func:`decode_image`.
    """
    if len(data) > MAX_IMAGE_BYTES:
        message = f"an image of {len(data):,} bytes; the limit is {MAX_IMAGE_BYTES:,}"
        raise ValueError(message)
    height, width = _jpeg_size(data) if bytes(data[:3]) == _JPEG_START else _pillow_size(data)
    if height * width > MAX_IMAGE_PIXELS:
        message = f"an image of {width} x {height} pixels; the limit is {MAX_IMAGE_PIXELS:,} pixels"
        raise ValueError(message)
    return height, width


def room_for(count: int, size: tuple[int, int], out: Pixels | None = None) -> Pixels:
    """Return an array for several images of one size: a new one, or the one given when it fits.

    Parameters
    ----------
    count : int
        How many images.
    size : tuple of int
        Their height and width, pixels.
    out : ndarray, shape (n, H, W, 3), uint8, optional
        Array of the caller's; n may be larger than ``count``.

    Returns
    -------
    ndarray, shape (n, H, W, 3), uint8

    Raises
    ------
    ValueError
        There is no ``out``, and the images have more than :data:`MAX_BATCH_PIXELS` pixels.
    InputError
        ``out`` cannot take them.
    """
    height, width = size
    if out is not None:
        if count:
            _require_room(out, (count, height, width, 3))
        return out
    if count * height * width > MAX_BATCH_PIXELS:
        message = (
            f"{count:,} images of {width} x {height} pixels at once; the limit is {MAX_BATCH_PIXELS:,} pixels"
        )
        raise ValueError(message)
    return np.empty((count, height, width, 3), np.uint8)


def _require_room(out: object, shape: tuple[int, int, int, int]) -> None:
    """Refuse what would be filled with garbage, or what the decoder cannot write to."""
    found = type(out).__name__
    if isinstance(out, np.ndarray):
        fits = out.dtype == np.uint8 and len(out.shape) == 4
        fits = fits and out.shape[0] >= shape[0] and out.shape[1:] == shape[1:]
        # The images may lie apart; the pixels of each must not.
        if fits and out[0].flags.c_contiguous and out.flags.writeable:
            return
        words = [] if out.flags.c_contiguous else ["not contiguous"]
        words += [] if out.flags.writeable else ["read-only"]
        found = ", ".join([f"{out.dtype} of shape {out.shape}", *words])
    message = (
        f"out is {found}; expected a writable array of uint8 and shape {shape} with C-contiguous images; "
        f"next: make one with numpy.empty({shape}, numpy.uint8), or leave out away"
    )
    raise InputError(message)


def encode_image(pixels: Pixels, kind: Literal["jpeg", "png"] = "jpeg", quality: int = 95) -> bytes:
    """Encode RGB pixels, shape (H, W, 3), uint8; the same pixels give the same bytes.

    Parameters
    ----------
    pixels : ndarray, shape (H, W, 3), uint8
        RGB.
    kind : "jpeg" or "png"
        Format. JPEG keeps the colour resolution whole (4:4:4).
    quality : int
        JPEG quality, 1 to 100.
    """
    from PIL import Image

    stream = io.BytesIO()
    if kind == "png":
        Image.fromarray(pixels).save(stream, "PNG", compress_level=6)
    else:
        Image.fromarray(pixels).save(stream, "JPEG", quality=quality, subsampling=0)
    return stream.getvalue()


def _placed(pixels: Pixels, out: Pixels | None) -> Pixels:
    if out is None:
        return pixels
    out[...] = pixels
    return out


def _first_jpeg_decoder(data: memoryview | bytes, out: Pixels | None) -> Pixels:
    """Choose the decoder on first use, so that importing this module loads none."""
    try:
        import simplejpeg
    except ImportError:
        _JPEG[0] = _decode_with_pillow
    else:
        library = simplejpeg.decode_jpeg

        def decode(data: memoryview | bytes, out: Pixels | None) -> Pixels:
            try:
                pixels: Pixels = library(data, "RGB", buffer=out)
            except ValueError as error:
                raise _undecodable(data, error) from error
            return pixels if out is None else out

        _JPEG[0] = decode
    return _JPEG[0](data, out)


_JPEG: list[Callable[[memoryview | bytes, Pixels | None], Pixels]] = [_first_jpeg_decoder]


def _decode_with_pillow(data: memoryview | bytes, out: Pixels | None) -> Pixels:
    return _placed(_pillow_pixels(data), out)


def _undecodable(data: memoryview | bytes, error: Exception) -> ValueError:
    return ValueError(
        f"an image of {len(data):,} bytes that cannot be decoded ({error}); expected a whole JPEG"
    )


def _jpeg_size(data: memoryview | bytes) -> tuple[int, int]:
    """Walk the segments of a JPEG up to the frame header."""
    place, end = 2, len(data)
    while place + 9 <= end and data[place] == 0xFF:
        marker = data[place + 1]
        if marker == 0xFF:
            place += 1
            continue
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = data[place + 5] << 8 | data[place + 6], data[place + 7] << 8 | data[place + 8]
            if height and width:
                return height, width
            break
        place += 2 + (data[place + 2] << 8 | data[place + 3])
    message = f"a JPEG without a frame header among its {end:,} bytes; expected a whole JPEG"
    raise ValueError(message)


def _pillow_size(data: memoryview | bytes) -> tuple[int, int]:
    with _pillow_image(data) as image:
        return image.height, image.width


def _pillow_pixels(data: memoryview | bytes) -> Pixels:
    with _pillow_image(data) as image:
        try:
            return np.asarray(image.convert("RGB"))
        except Exception as error:  # Pillow raises OSError, SyntaxError, struct.error and more on bad files
            raise _undecodable(data, error) from error


def _pillow_image(data: memoryview | bytes) -> Any:
    from PIL import Image

    try:
        return Image.open(io.BytesIO(data), formats=["JPEG", *_OTHER_FORMATS])
    except Exception as error:  # as above
        start = bytes(data[:8]).hex(" ")
        message = f"{len(data):,} bytes that begin with {start or 'nothing'}; expected a JPEG"
        raise ValueError(message) from error


def resized(pixels: Pixels, width: int, height: int) -> Pixels:
    """Return an image in another size, shape (height, width, 3), uint8.

    Smaller: each pixel is the mean of the area that it covers. Larger: bilinear.
    """
    from PIL import Image

    image = Image.fromarray(pixels)
    smaller = width <= image.width and height <= image.height
    method = Image.Resampling.BOX if smaller else Image.Resampling.BILINEAR
    return np.asarray(image.resize((width, height), method))
