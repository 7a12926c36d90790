"""Files of pictures: known formats, the pages of a file, and reading a page."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from PIL import Image, ImageOps, UnidentifiedImageError, features

from tactile_toolkit import store, touch
from tactile_toolkit.cache import require_unpackable
from tactile_toolkit.errors import InputError, ItemError, ToolkitError, install_line

_ENDINGS = {
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

ENDINGS = tuple(ending for endings in _ENDINGS.values() for ending in endings)
"""Endings of pictures, in lower case; the content of a file decides how it is read."""

# Formats whose files can have pages. Further pictures of a JPEG (MPO) are other views, not pages.
_PAGED = frozenset({"TIFF", "GIF", "WEBP", "PNG", "AVIF", "HEIF"})
_MAX_PAGES = 1000
# TIFF tag for the kind of a picture, and the bits of smaller copies and masks, which are not pages.
_SUBFILE, _COPY_OR_MASK = 254, 1 | 4
# Memory for reading, by mode, as measured; 24 for transparency and for more than 8 bits.
_BYTES_PER_PIXEL = {"1": 4, "L": 4, "P": 11, "RGB": 11}
# Memory of the decoded picture alone, as Pillow holds it.
_BYTES_HELD = {"1": 2, "L": 1, "I;16": 2}
_REDUCED_PX = 4000
"""Longer side to which pictures are reduced that would not fit into memory; solids need an eighth of it."""


def is_picture_name(name: str) -> bool:
    """Return whether a name has the ending of a picture, in upper or lower case."""
    return name.lower().endswith(ENDINGS)


def pages_of(path: Path) -> tuple[int, ...]:
    """Return the numbers, from 0, of the pictures in a file that are pages.

    Raises ItemError ``"unreadable"``.
    """
    with _opened(path) as picture:
        count = getattr(picture, "n_frames", 1) if picture.format in _PAGED else 1
        if count > _MAX_PAGES:
            raise InputError(f"it has {count:,} pages, expected {_MAX_PAGES:,} at most")
        if picture.format != "TIFF" or count == 1:
            return tuple(range(count))
        return tuple(number for number in range(count) if _is_page(picture, number))


def _is_page(picture: Image.Image, number: int) -> bool:
    picture.seek(number)
    kind = picture.tag_v2.get(_SUBFILE, 0)  # type: ignore[attr-defined]
    return not kind & _COPY_OR_MASK


@cache
def _formats() -> tuple[str, ...]:
    """Return the formats that can be read here; AVIF and HEIF depend on how Pillow was built."""
    known = [name for name in _ENDINGS if name not in ("TGA", "HEIF")]
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


@contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    """Open a picture by its content; all errors become ItemError ``"unreadable"``."""
    ending = path.suffix.lower()
    # TGA has no signature, so nearly every file can pass for it.
    formats = (*_formats(), "TGA") if ending in _ENDINGS["TGA"] else _formats()
    try:
        with warnings.catch_warnings():
            # Pillow warns of pictures up to twice its limit; those are reduced, the others are refused.
            warnings.simplefilter("ignore")
            with store.open_regular(path) as stream, Image.open(stream, formats=formats) as picture:
                yield picture
    # Decoders raise many types for broken files: OSError, SyntaxError, ValueError, struct.error, ...
    except Exception as error:
        next_step = "replace it by an intact copy, or leave it out"
        if isinstance(error, Image.DecompressionBombError):
            next_step = "store it with fewer pixels; 20 million are more than enough"
        if ending in _ENDINGS["HEIF"] and isinstance(error, UnidentifiedImageError) and "HEIF" not in formats:
            next_step = f"{install_line('heic')}, or store it as JPEG"
        found = f"{path}: cannot be read as a picture ({_problem(error)}), expected an intact image file"
        raise ItemError("unreadable", found, next=next_step) from error


def _problem(error: Exception) -> str:
    """Describe an error in words that do not depend on the versions of libraries."""
    if isinstance(error, ToolkitError):
        return error.message
    if isinstance(error, Image.DecompressionBombError):
        return "it has too many pixels"
    if isinstance(error, UnidentifiedImageError):
        return "its content is of no known type"
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return "its content is damaged or cut off"


def decode_page(path: Path, page: int) -> Image.Image:
    """Read a page of a file upright, in mode L, RGB, RGBA, or one of more than 8 bits (F, I).

    A picture that would not fit into the memory that is allowed (:mod:`tactile_toolkit.cache`) is reduced to
    a longer side of 2,000 to 4,000 pixels while it is read. Raises ItemError ``"unreadable"``.
    """
    with _opened(path) as picture:
        if page:
            picture.seek(page)
        _require_bounded(picture, path)
        return upright_levels(_reduced(picture))


def upright_levels(picture: Image.Image) -> Image.Image:
    """Return a picture upright, in mode L, RGB, RGBA, or one of more than 8 bits (F, I)."""
    upright = ImageOps.exif_transpose(picture)
    if upright.mode[:1] in ("F", "I"):
        return upright
    if upright.has_transparency_data:
        return upright.convert("RGBA")
    return upright.convert("L" if upright.mode in ("1", "L") else "RGB")


def size_of_page(path: Path, page: int) -> tuple[int, int]:
    """Return width and height of a page as it is stored, pixels; raises ItemError ``"unreadable"``."""
    with _opened(path) as picture:
        if page:
            picture.seek(page)
        return picture.size


def _require_bounded(picture: Image.Image, path: Path) -> None:
    """Raise InputError for a picture that takes too much memory even if it is reduced."""
    if picture.format not in ("JPEG", "MPO"):
        return
    try:
        touch.require_bounded_jpeg(path.read_bytes())
    except ValueError as error:
        raise InputError(str(error)) from error


def _reduced(picture: Image.Image) -> Image.Image:
    """Return a picture that fits into memory: itself, or one with the mean of each square of pixels."""
    width, height = picture.size
    what = f"a picture of {width} x {height} pixels"
    try:
        require_unpackable(width * height * _BYTES_PER_PIXEL.get(picture.mode, 24), what)
    except InputError:
        # JPEG is decoded at 1/2, 1/4 or 1/8 of its size.
        picture.draft(None, (_REDUCED_PX // 2, _REDUCED_PX // 2))
        width, height = picture.size
        require_unpackable(width * height * _BYTES_HELD.get(picture.mode, 4), what)
        factor = -(-max(width, height) // _REDUCED_PX)
        if picture.mode == "1":
            picture = picture.convert("L")
        elif picture.mode == "P":
            picture = picture.convert("RGB")
        return picture.reduce(factor)
    return picture
