"""Files of pictures: which there are, how many pages they have, and their grey levels."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mnist3d.ink import margin, otsu_threshold, paper_is_dark, require_paper_around
from mnist3d.photograph import even_out, is_clean
from mnist3d.sources.canvas import as_grey
from tactile_toolkit import store
from tactile_toolkit.array_types import UInt8
from tactile_toolkit.bounds import require_unpackable
from tactile_toolkit.errors import InputError, ItemError, ToolkitError, install_line
from tactile_toolkit.touch import require_bounded_jpeg

if TYPE_CHECKING:
    from PIL.Image import Image

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
"""Endings of pictures, in lower case; what is in a file decides how it is read."""

# Each picture of such a file is one of its pages. The further pictures of a JPEG (MPO) are other views.
_PAGED = frozenset({"TIFF", "GIF", "WEBP", "PNG", "AVIF", "HEIF"})
_MOST_PAGES = 1000
# Kind of a picture in TIFF: smaller copies and masks are not pages.
_SUBFILE, _COPY_OR_MASK = 254, 1 | 4
# Memory that reading takes, by mode, as measured; 24 for transparency and for more than 8 bits.
_BYTES_PER_PIXEL = {"1": 4, "L": 4, "P": 11, "RGB": 11}
# White of integers of more than 8 bits: cameras and scanners store 10, 12 or 14 bits in 16.
_WHITES = (255, 1023, 4095, 16_383, 65_535)
# A picture whose grey levels span less shows nothing but paper.
_CONTRAST = 24


def is_picture_name(name: str) -> bool:
    """Return whether a name ends as those of pictures do, in upper or lower case."""
    return name.lower().endswith(ENDINGS)


def pages_of(path: Path) -> tuple[int, ...]:
    """Return the numbers of the pictures in a file that are pages, from 0.

    Raises ItemError ``"unreadable"``.
    """
    with _opened(path) as picture:
        count = getattr(picture, "n_frames", 1) if picture.format in _PAGED else 1
        if count > _MOST_PAGES:
            raise InputError(f"it has {count:,} pages, expected {_MOST_PAGES:,} at most")
        if picture.format != "TIFF" or count == 1:
            return tuple(range(count))
        return tuple(number for number in range(count) if _is_page(picture, number))


def _is_page(picture: Image, number: int) -> bool:
    picture.seek(number)
    kind = picture.tag_v2.get(_SUBFILE, 0)  # type: ignore[attr-defined]
    return not kind & _COPY_OR_MASK


def read_picture(path: Path, ink: str = "auto", threshold: str = "auto", page: int = 0) -> UInt8:
    """Read a picture of a digit in its own size, ink 0 and paper 255.

    Colours become grey, transparency shows paper, and the orientation in EXIF is followed. Photographs and
    scans are evened out (``mnist3d.photograph.even_out``). The grey levels of clean images are stretched
    so that paper is white and ink black; a picture of black on white comes back unchanged, and one without
    contrast (an empty page) is not stretched. With ``"auto"`` the margin of a clean image is paper, so the
    ink is whatever the margin is not, on either side of Otsu's threshold.

    Parameters
    ----------
    path : Path
        File of any type that :data:`ENDINGS` lists.
    ink : {"auto", "dark", "light"}
        Which part is ink.
    threshold : {"auto", "local", "global"}
        Even out all pictures, none, or those that are not clean.
    page : int
        Number of the picture in a file of several, from 0.

    Returns
    -------
    ndarray of uint8, shape (H, W)

    Raises
    ------
    ItemError
        ``"unreadable"``; ``"not-finite"`` or ``"bad-pixels"`` for floating-point pictures; ``"unclear-ink"``
        when less than three quarters of the margin are on one side of the threshold; ``"all-ink"`` or
        ``"cut-off"`` when there is too much ink; and the reasons of ``mnist3d.photograph.even_out``.
    """
    try:
        return _read(_decoded(path, page), ink, threshold, path)
    except ItemError as error:
        if str(path) in error.message:
            raise
        raise ItemError(error.reason, f"{path}: {error.message}") from error


def _read(picture: Image, ink: str, threshold: str, path: Path) -> UInt8:
    grey = _brightness(picture, ink, path)
    colours = np.asarray(picture) if picture.mode == "RGB" else grey
    is_flat = np.ptp(grey) < _CONTRAST
    # Ink and paper of different colours may have the same grey.
    is_coloured = is_flat and np.ptp(colours, axis=(0, 1)).max() >= _CONTRAST
    if threshold == "local" or (threshold == "auto" and (is_coloured or not is_clean(grey))):
        return even_out(colours, ink)
    if is_flat:
        return 255 - grey if ink == "light" else grey
    level = otsu_threshold(grey)
    if ink == "light" or (ink == "auto" and paper_is_dark(grey, level, str(path))):
        grey, level = 255 - grey, 254 - level
    dark = grey <= level
    # Nothing to stretch by, and a division by nothing below.
    if dark.all() or not dark.any():
        return grey
    require_paper_around(dark)
    # Ink of thin strokes is mostly edge, so its median would be too light; single dark pixels are specks.
    darkest, paper = float(np.percentile(grey[dark], 10)), float(np.median(grey[~dark]))
    table = np.clip((np.arange(256) - darkest) * (255 / (paper - darkest)), 0, 255)
    levels: UInt8 = np.rint(table).astype(np.uint8)[grey]
    return levels


@cache
def _formats() -> tuple[str, ...]:
    """Return the formats that can be read here; AVIF and HEIF depend on how Pillow was built."""
    from PIL import features

    known = [name for name in _ENDINGS if name not in ("TGA", "HEIF")]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if not features.check("avif"):
            known.remove("AVIF")
    try:
        from pillow_heif import register_heif_opener
    except ImportError:
        return tuple(known)
    register_heif_opener()
    return (*known, "HEIF")


@contextmanager
def _opened(path: Path) -> Iterator[Image]:
    """Open a picture by its content; what goes wrong is an ItemError."""
    from PIL import Image, UnidentifiedImageError

    ending = path.suffix.lower()
    # Nearly anything can pass for TGA, which has no mark of its own.
    formats = (*_formats(), "TGA") if ending in _ENDINGS["TGA"] else _formats()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # Pillow only warns of pictures up to twice its limit; one of them takes half a gigabyte.
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with store.open_regular(path) as stream, Image.open(stream, formats=formats) as picture:
                yield picture
    # Decoders of broken files raise whatever comes: OSError, SyntaxError, ValueError, struct.error, ...
    except Exception as error:
        next_step = "replace or remove it"
        if ending in _ENDINGS["HEIF"] and isinstance(error, UnidentifiedImageError) and "HEIF" not in formats:
            next_step = f"{install_line('heic')}, or store it as JPEG"
        found = f"{path}: cannot be read as a picture ({_problem(error)}), expected an intact image file"
        raise ItemError("unreadable", found, next=next_step) from error


def _problem(error: Exception) -> str:
    """Return what is wrong in words that do not depend on the versions of libraries."""
    from PIL import Image, UnidentifiedImageError

    if isinstance(error, ToolkitError):
        return error.message
    if isinstance(error, (Image.DecompressionBombWarning, Image.DecompressionBombError)):
        return "it has too many pixels"
    if isinstance(error, UnidentifiedImageError):
        return "its content is of no known type"
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return "its content is damaged or cut off"


def _decoded(path: Path, page: int) -> Image:
    from PIL import ImageOps

    with _opened(path) as picture:
        if page:
            picture.seek(page)
        memory = picture.width * picture.height * _BYTES_PER_PIXEL.get(picture.mode, 24)
        require_unpackable(memory, f"a picture of {picture.width} x {picture.height} pixels")
        if picture.format in ("JPEG", "MPO"):
            try:
                require_bounded_jpeg(path.read_bytes())
            except ValueError as error:
                raise InputError(str(error)) from error
        upright = ImageOps.exif_transpose(picture)
        if upright.mode[:1] in ("F", "I"):
            return upright
        if upright.has_transparency_data:
            return upright.convert("RGBA")
        return upright.convert("L" if upright.mode in ("1", "L") else "RGB")


def _brightness(picture: Image, ink: str, path: Path) -> UInt8:
    if picture.mode == "RGBA":
        return _over_paper(picture, ink)
    if picture.mode in ("L", "RGB"):
        return np.asarray(picture.convert("L"))
    values = np.asarray(picture)
    largest = float(np.fmax.reduce(values, axis=None, initial=0))
    # Floats end at 1 or 255.
    whites = (1, 255) if picture.mode == "F" else _WHITES
    return as_grey(values, next((float(each) for each in whites if largest <= each), whites[-1]), str(path))


def _over_paper(picture: Image, ink: str) -> UInt8:
    """Lay a transparent picture on white paper, or on black if light ink is all there is on it."""
    alpha = np.asarray(picture.getchannel("A"), np.float32) / 255
    light = np.asarray(picture.convert("RGB").convert("L"), np.float32)
    cut_out = ink == "auto" and margin(alpha).mean() < 0.5
    bright_ink = cut_out and (light * alpha).sum() > 127.5 * alpha.sum()
    paper = 0 if ink == "light" or bright_ink else 255
    return np.rint(light * alpha + paper * (1 - alpha)).astype(np.uint8)
