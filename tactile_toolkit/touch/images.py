"""Images of touches: decoding and encoding, and the columns that all sets of touches share.

JPEGs are decoded by libjpeg with its exact integer transform, so every machine gets the same pixels. The
interpreter lock is released while it works.
"""

from __future__ import annotations

import functools
import io
import re
import struct
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import simplejpeg
from PIL import Image, UnidentifiedImageError, features

from tactile_toolkit import read
from tactile_toolkit.errors import install_line
from tactile_toolkit.read import schemas
from tactile_toolkit.value_types import AnyArray, JsonObject, UInt8

MAX_IMAGE_PIXELS = 1 << 24
"""Largest image that is decoded (4096 x 4096); a sensor's has 76,800 pixels."""
MAX_IMAGE_BYTES = 1 << 26
"""Largest encoded image that is read."""
MAX_SCANS = 100
"""Most scans of a JPEG that is decoded. Each scan costs a pass over the picture but only a few bytes of file.
Cameras write 1, progressive files about 10."""

# A file of this size holds a few hundred scans at most: under a second, even for the largest image.
_SMALL_BYTES = 1 << 12
MAX_HEADER_BYTES = 1 << 22
"""Most bytes of a JPEG before its first scan. Pillow keeps an object per segment, and 4 bytes make one."""
ImageFormat = Literal["jpeg", "png"]
IMAGE_SUFFIX: dict[ImageFormat, str] = {"jpeg": "jpg", "png": "png"}
"""File name suffix of each format."""
PICTURE_ENDINGS = {
    "PNG": (".png", ".apng"),
    "JPEG": (".jpg", ".jpeg", ".jpe", ".jfif"),
    "BMP": (".bmp",),
    "TIFF": (".tif", ".tiff"),
    "WEBP": (".webp",),
    "GIF": (".gif",),
    "PPM": (".pgm", ".ppm", ".pbm", ".pnm"),
    "JPEG2000": (".jp2", ".j2k"),
    "TGA": (".tga",),
    "AVIF": (".avif",),
    "HEIF": (".heic", ".heif"),
}
"""Endings of picture files by the name of their format in Pillow, in lower case."""
# Data sets store these as they are. TGA has no signature, so nearly every file would pass for it.
_NOT_CONVERTED = ("PNG", "JPEG", "WEBP", "TGA")
_HEIF_STARTS = (b"ftypheic", b"ftypheix", b"ftypmif1", b"ftypmsf1")
_SCAN_START = re.compile(b"\xff\xda")
_JPEG_START = b"\xff\xd8\xff"
_JPEG_END = b"\xff\xd9"
_APP1 = re.compile(b"\xff\xe1")  # these bytes never occur within coded pixels
_ORIENTATION = 0x0112
_BITS_PER_SAMPLE = 0x0102  # tag of TIFF
# Pillow reduces these to 8 bits a colour without a word. In JPEG 2000, the number is one less than the bits
# (ITU-T T.800, A.5.1); in the others it is that of the first channel (ISO/IEC 23008-12, 6.5.6).
_STATED_BITS = {
    "JPEG2000": re.compile(rb"\xff\x4f\xff\x51.{38}(.)", re.DOTALL),
    "AVIF": re.compile(rb"pixi\0{4}.(.)", re.DOTALL),
    "HEIF": re.compile(rb"pixi\0{4}.(.)", re.DOTALL),
}
_PNG_MODES = ("1", "L", "LA", "P", "RGB", "RGBA")
_GREY_MODES = ("I;16", "I;16B", "I")
_MAX_LEVEL = 255
_TURNED = range(2, 9)
_TURNED_BY_READERS = "its Exif or XMP data ask to turn it, which some readers do; expected an upright image"

# Pillow modes whose values are clipped at 255 on conversion to RGB.
_DEEP_MODES = ("I", "I;16", "I;16B", "I;16L", "I;16N", "F")

MEDIA_TYPE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
"""Arrow type of an image or clip: its bytes and its original file name."""
_MEDIA_FEATURES = {"sensor_video": "Video", "sensor_image": "Image"}
CLASS_NAMES = tuple(str(digit) for digit in range(10))


@functools.cache
def picture_formats() -> tuple[str, ...]:
    """Return the formats of pictures that can be read here; AVIF and HEIF depend on what is installed.

    TGA is not among them, because nearly every file would pass for it.
    """
    known = [name for name in PICTURE_ENDINGS if name not in ("TGA", "HEIF")]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if not features.check("avif"):
            known.remove("AVIF")
    try:  # installed by the extra heic
        from pillow_heif import register_heif_opener
    except ImportError:
        return tuple(known)
    register_heif_opener()
    return (*known, "HEIF")


@dataclass(frozen=True, slots=True)
class EncodedImage:
    """The bytes of an image, or of a file that may be none: what they are before they are decoded."""

    data: bytes | memoryview

    @property
    def is_jpeg(self) -> bool:
        """Whether the data start with the signature of a JPEG."""
        return self.data[:3] == _JPEG_START

    def size(self) -> tuple[int, int]:
        """Read height and width of a JPEG, PNG or WebP from its header, without decoding it.

        Raises ValueError where the data are not such an image or exceed the limits above.
        """
        mode, pictures = "", 1
        data = self.data
        if self.is_jpeg:
            self.require_bounded()
        try:
            if self.is_jpeg:
                height, width, *_ = simplejpeg.decode_jpeg_header(data)
            else:
                image = _open_image(data)
                height, width, mode = image.height, image.width, image.mode
                pictures = getattr(image, "n_frames", 1)
        except Exception as error:
            raise _undecodable(data) from error
        if pictures > 1:
            raise ValueError(f"an image of {pictures:,} pictures, one after the other; expected one")
        if mode in _DEEP_MODES:
            raise ValueError(f"an image of 16 bits a colour ({mode}); expected 8")
        if height * width > MAX_IMAGE_PIXELS:
            raise ValueError(
                f"an image of {width} x {height} pixels; the limit is {MAX_IMAGE_PIXELS:,} pixels"
            )
        return height, width

    def intact_size(self, *, is_upright: bool = False) -> tuple[int, int]:
        """Return height and width of an image, after a check of its beginning and end.

        With ``is_upright``, images that their Exif or XMP data ask readers to turn are refused.

        The pixels of a JPEG are not decoded, which would take longer than all other work, unless bytes follow
        the mark of its end: cameras send whole buffers, and encoders of clips pad to even lengths. Raises
        ValueError for an image that is damaged or refused.
        """
        data = self.data
        size = self.size()
        if not self.is_jpeg:
            decode_image(data)
        elif bytes(data[-2:]) != _JPEG_END and not bytes(data[-16:]).rstrip(b"\0").endswith(_JPEG_END):
            try:
                decode_image(data)
            except ValueError as error:
                raise ValueError(
                    f"an image of {len(data):,} bytes without the mark of its end; expected a whole JPEG"
                ) from error
        # JPEGs have both in such a segment, and opening an image takes a while.
        if is_upright and not (self.is_jpeg and _APP1.search(data) is None):
            _require_upright(data)
        return size

    def storable(self) -> tuple[bytes, str]:
        """Return an image as data sets store it, and its format if that was converted.

        A JPEG, PNG or WebP is returned as it is, and so is data of no known format; the format is empty then.
        The pixels of others (BMP, GIF, PPM, TIFF, JPEG 2000, AVIF, and HEIF with the extra ``heic``) become a
        PNG without loss. Raises ValueError for one of several pictures, of more than 8 bits a colour, of
        colours that PNG does not have, that is not upright, too large or damaged.
        """
        data = bytes(self.data)
        if self.is_jpeg or data.startswith((b"\x89PNG", b"RIFF")):
            return data, ""
        formats = [name for name in picture_formats() if name not in _NOT_CONVERTED]
        if data[4:12] in _HEIF_STARTS and "HEIF" not in formats:
            raise ValueError(f"an image in HEIF; {install_line('heic')}, or store it as PNG")
        try:
            with Image.open(io.BytesIO(data), formats=formats) as image:
                problem = _problem_of_conversion(image, data)
                if not problem:
                    return encode_png(image), str(image.format)
        except UnidentifiedImageError:
            return data, ""
        except Exception as error:
            raise _undecodable(data) from error
        raise ValueError(problem)

    def grey(self) -> AnyArray:
        """Decode a grey PNG of 16 bits, such as a depth map: (H, W), integers; ValueError for others."""
        expected = f"expected a grey PNG of 16 bits and at most {MAX_IMAGE_PIXELS:,} pixels"
        try:
            image = Image.open(io.BytesIO(self.data), formats=["PNG"])
            found = f"{image.width} x {image.height} pixels of mode {image.mode}"
            if image.mode in _GREY_MODES and image.width * image.height <= MAX_IMAGE_PIXELS:
                return np.asarray(image)
        except Exception as error:  # Pillow raises many kinds on damaged files
            raise ValueError(f"an image that cannot be decoded; {expected}") from error
        raise ValueError(f"an image of {found}; {expected}")

    def require_bounded(self) -> None:
        """Raise ValueError where a JPEG has too many scans or too long a header, before it is decoded."""
        # A touch of 64 x 64 pixels takes 1 kB; the search would add a tenth to its time.
        if len(self.data) <= _SMALL_BYTES:
            return
        # This pair of bytes does not occur within coded pixels (ITU-T T.81, B.1.1.5).
        # A regular expression takes half of the time of `bytes.count`.
        starts = [match.start() for match in _SCAN_START.finditer(self.data)]
        scans = len(starts)
        header = (starts or [-1])[0]
        if scans > MAX_SCANS:
            raise ValueError(f"a JPEG of {scans:,} scans; the limit is {MAX_SCANS}")
        if header > MAX_HEADER_BYTES:
            raise ValueError(f"a JPEG whose header takes {header:,} bytes; the limit is {MAX_HEADER_BYTES:,}")

    @staticmethod
    def doubtful(images: pa.Array) -> list[int]:
        """Return the indices of those of some encoded images that :meth:`intact_size` must judge.

        The others are JPEGs with few scans and the mark of their end, and the header of one that it judges: a
        camera writes one header, which takes most of the time.
        """
        offsets = np.frombuffer(images.buffers()[1], np.int32)[images.offset :][: len(images) + 1].astype(
            np.int64
        )
        data = np.frombuffer(images.buffers()[2] or b"", np.uint8)
        starts, ends = offsets[:-1], offsets[1:]
        # As in `require_bounded`, for all at once.
        high, low = _SCAN_START.pattern
        marks = offsets[0] + np.flatnonzero(data[offsets[0] : max(offsets[-1] - 1, 0)] == high)
        marks = marks[data[marks + 1] == low]
        first, last = np.searchsorted(marks, (starts, ends))
        has_few_scans = (last > first) & (last - first <= MAX_SCANS)
        judged = set[bytes]()
        doubtful = []
        for index, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
            header = b""
            if has_few_scans[index] and data[end - 2 : end].tobytes() == _JPEG_END:
                scan = int(marks[first[index]]) + 2
                header = data[start : scan + (int(data[scan]) << 8) + int(data[scan + 1])].tobytes()
            if header not in judged:
                doubtful.append(index)
                if EncodedImage(header).is_jpeg:
                    judged.add(header)
        return doubtful


def _require_upright(data: bytes | memoryview) -> None:
    orientation = None
    # Data that cannot be read do not turn the image.
    with (
        suppress(OSError, SyntaxError, ValueError, TypeError, struct.error),
        Image.open(io.BytesIO(data), formats=["JPEG", "PNG", "WEBP"]) as image,
    ):
        orientation = image.getexif().get(_ORIENTATION)
    if orientation in _TURNED:
        raise ValueError(_TURNED_BY_READERS)


def _problem_of_conversion(image: Image.Image, data: bytes) -> str:
    """Return why a PNG does not hold an image without loss; empty if it does."""
    if getattr(image, "is_animated", False):
        return "an image of several pictures, one after the other; expected one"
    if image.width * image.height > MAX_IMAGE_PIXELS:
        return f"an image of {image.width} x {image.height} pixels; the limit is {MAX_IMAGE_PIXELS:,} pixels"
    bits = np.max(getattr(image, "tag_v2", {}).get(_BITS_PER_SAMPLE, 8))
    stated_bits = _STATED_BITS[image.format].search(data) if image.format in _STATED_BITS else None
    if stated_bits:
        bits = ord(stated_bits[1]) + (image.format == "JPEG2000")
    tiles = getattr(image, "tile", [])
    top_levels: list[Any] = [tile[3][-1] for tile in tiles if tile[0] == "ppm" and tile[3]]
    if image.mode in _DEEP_MODES or bits > 8 or max(top_levels, default=0) > _MAX_LEVEL:
        return f"an image of 16 bits a colour ({image.mode}); expected 8"
    if image.mode not in _PNG_MODES:
        return f"a {image.format} with the colours {image.mode}; expected grey or RGB"
    if image.getexif().get(_ORIENTATION) in _TURNED:
        return _TURNED_BY_READERS
    return ""


def decode_image(data: memoryview | bytes, out: UInt8 | None = None, *, least_px: int = 0) -> UInt8:
    """Decode a JPEG, PNG or WebP to RGB, shape (H, W, 3), uint8; into ``out`` (contiguous) if given.

    With ``least_px``, a JPEG is decoded at 1/2, 1/4 or 1/8 of its size, the smallest with sides of at least
    ``least_px`` pixels, in half of the time: each pixel is the mean of those it replaces. Raises ValueError
    as :meth:`EncodedImage.size` does, and when the data is truncated, corrupt or of another size than
    ``out``. A partly decoded image is never returned.
    """
    encoded = EncodedImage(data)
    if out is not None and encoded.is_jpeg:
        encoded.require_bounded()
        # Errors are named below: reading the header of every image first would be slow.
        with suppress(ValueError):
            if simplejpeg.decode_jpeg(data, "RGB", buffer=out).shape == out.shape:
                return out
    height, width = encoded.size()
    if out is not None and out.shape != (height, width, 3):
        raise ValueError(
            f"an image of {width} x {height} pixels; expected {out.shape[1]} x {out.shape[0]} as before it"
        )
    pixels: UInt8
    try:
        if encoded.is_jpeg:
            pixels = simplejpeg.decode_jpeg(data, "RGB", min_height=least_px, min_width=least_px, buffer=out)
        else:
            pixels = np.array(_open_image(data).convert("RGB"))  # writable, as a JPEG is
    except Exception as error:
        raise _undecodable(data) from error
    if out is None or pixels is out:
        return pixels
    out[...] = pixels
    return out


def _open_image(data: memoryview | bytes) -> Image.Image:
    # Without a list of formats, Pillow would try all its 43 decoders.
    return Image.open(io.BytesIO(data), formats=["PNG", "WEBP"])


def _undecodable(data: memoryview | bytes) -> ValueError:
    # Pillow raises OSError, SyntaxError, struct.error and more on bad files. Their messages differ between
    # releases and may contain the address of an object; this message is stored in data sets.
    start = bytes(data[:8]).hex(" ") or "nothing"
    return ValueError(
        f"an image of {len(data):,} bytes that begin with {start} cannot be decoded; expected a JPEG, "
        f"PNG or WebP, intact and of at most {MAX_IMAGE_PIXELS:,} pixels"
    )


def encode_image(pixels: AnyArray, kind: ImageFormat = "jpeg", quality: int = 95) -> bytes:
    """Encode RGB pixels, (H, W, 3), uint8, or, as PNG, grey ones, (H, W), uint16; always to the same bytes.

    ``quality`` (1 to 100) applies to JPEGs, which keep full colour resolution (4:4:4).
    """
    if kind == "png":
        return encode_png(Image.fromarray(pixels))
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "JPEG", quality=quality, subsampling=0)
    return stream.getvalue()


def encode_png(picture: Image.Image) -> bytes:
    """Encode a picture as PNG, without metadata."""
    stream = io.BytesIO()
    # Pillow's default level, written out so that other releases write the same bytes.
    picture.save(stream, "PNG", compress_level=6)
    return stream.getvalue()


def resized(pixels: UInt8, width: int, height: int) -> UInt8:
    """Return the image resized to (height, width, 3), uint8.

    When it shrinks, each pixel is the mean of the area it covers. When it grows, pixels are interpolated
    bilinearly.
    """
    image = Image.fromarray(pixels)
    smaller = width <= image.width and height <= image.height
    method = Image.Resampling.BOX if smaller else Image.Resampling.BILINEAR
    return np.asarray(image.resize((width, height), method))


def with_features(schema: pa.Schema, label_names: Sequence[str] | None) -> pa.Schema:
    """Add the metadata from which `datasets` reads the features: classes, images, numbers.

    Without ``label_names``, the class is a plain number; an empty list means that there are no classes.
    """
    features: dict[str, JsonObject] = {}
    for field in schema:
        leaf = None
        if field.name in _MEDIA_FEATURES or read.list_depth(field.type)[1] == MEDIA_TYPE:
            leaf = {"_type": _MEDIA_FEATURES.get(field.name, "Image")}
        features[field.name] = schemas.value_feature(field.type, leaf)
    if "label" in features and label_names is not None:
        features["label"] = schemas.label_feature(label_names)
    return schema.with_metadata(schemas.feature_metadata(features))
