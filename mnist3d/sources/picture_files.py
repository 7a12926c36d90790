"""Files of pictures: known formats, pages, and their ink as grey levels."""

from __future__ import annotations

import functools
import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from mnist3d.ink.grey_levels import (
    MAX_DRAWN,
    MAX_INK,
    as_grey,
    ink_of_colours,
    is_graphic,
    loses_colours,
    margin,
    otsu_threshold,
    paper_is_dark,
    require_paper_around,
    unlike_paper,
)
from tactile_toolkit import cache, store, touch
from tactile_toolkit.columns import known_formats
from tactile_toolkit.errors import (
    InputError,
    ItemError,
    MissingExtraError,
    ToolkitError,
    needs_extra,
)
from tactile_toolkit.value_types import Bool, UInt8

ENDINGS = (*(ending for endings in touch.PICTURE_ENDINGS.values() for ending in endings), ".svg")
"""Endings of pictures, in lower case; the content of a file decides how it is read."""

# Formats whose files can have pages. Further pictures of a JPEG (MPO) are other views, not pages.
_PAGED = frozenset({"TIFF", "GIF", "WEBP", "PNG", "AVIF", "HEIF"})
_MAX_PAGES = 1000
# Formats in which a page is made from those before it.
_BUILT_UP = frozenset({"GIF", "WEBP", "PNG", "AVIF"})
# The last file that was opened at a later page, by path, time and size: its next page needs no earlier ones.
_KEPT: dict[tuple[str, int, int], Image.Image] = {}

# TIFF tag for the kind of a picture, and the bits of smaller copies and masks, which are not pages.
_SUBFILE = 254
_COPY_OR_MASK = 1 | 4

# Memory for reading, by mode, as measured; 24 for transparency and for more than 8 bits.
_BYTES_PER_PIXEL = {"1": 4, "L": 4, "P": 11, "RGB": 11}

# Memory of the decoded picture alone, as Pillow holds it.
_BYTES_HELD = {"1": 2, "L": 1, "I;16": 2}

_DRAWN_PX = 2000
"""Longer side in which vector drawings are drawn; the largest sheet of a solid has half of it."""

_REDUCED_PX = 4000
"""Longer side to which pictures are reduced that would not fit into memory; solids need an eighth of it."""

# Possible levels of white in integers: cameras and scanners store 10, 12 or 14 bits in 16.
_WHITES: tuple[int, ...] = (255, 1023, 4095, 16_383, 65_535)

# A picture with a smaller range of grey levels shows paper only.
_CONTRAST = 24

# Transparent pictures whose visible part is lighter than this share of white lie on black paper.
_MOSTLY_LIGHT = 0.5
_HALF_OPAQUE = 127.5


def is_picture_name(name: str) -> bool:
    """Return whether a name has the ending of a picture, in upper or lower case."""
    return name.lower().endswith(ENDINGS)


def read_picture(
    path: Path,
    ink: str = "auto",
    threshold: str = "auto",
    page: int = 0,
    *,
    whole: bool = False,
    notes: list[str] | None = None,
) -> UInt8:
    """Read a picture in its own size, with ink 0 and paper 255; see :func:`picture_levels`.

    Parameters
    ----------
    path : Path
        File of any type that :data:`ENDINGS` lists.
    ink, threshold, whole, notes
        As for :func:`picture_levels`.
    page : int
        Number of the page, from 0.

    Returns
    -------
    ndarray of uint8, shape (H, W)

    Raises
    ------
    ItemError
        ``"unreadable"``, and those of :func:`picture_levels`.
    """
    try:
        picture = decode_page(path, page)
        return picture_levels(picture, ink, threshold, str(path), whole=whole, notes=notes)
    except ItemError as error:
        if str(path) in error.message:
            raise
        raise ItemError(error.reason, f"{path}: {error.message}") from error


def picture_levels(
    picture: Image.Image,
    ink: str,
    threshold: str,
    picture_name: str,
    *,
    whole: bool = False,
    notes: list[str] | None = None,
) -> UInt8:
    """Return the ink of a picture as grey levels from 0 (ink) to 255 (paper), in its own size.

    Transparency shows paper. The light of photographs and scans is evened out
    (:mod:`mnist3d.ink.photographs`). The grey levels of clean images are stretched so that paper is white and
    ink black, unless there is no contrast (an empty page). With ``"auto"`` the margin of a clean image is
    paper, on either side of Otsu's threshold. Colours that grey levels lose are ink, too
    (:mod:`mnist3d.ink.grey_levels`).

    Parameters
    ----------
    picture : PIL.Image.Image
        Upright, in mode L, RGB, RGBA, or one of more than 8 bits (F, I).
    ink : {"auto", "dark", "light"}
        Which part is ink.
    threshold : {"auto", "local", "global"}
        Even out only pictures that are not clean, all pictures, or none.
    picture_name : str
        Name of the picture for messages.
    whole : bool
        The picture is a drawing of any parts, not one digit: photographs keep all their ink.
    notes : list of str, optional
        As for ``mnist3d.ink.photographs.even_out``.

    Returns
    -------
    ndarray of uint8, shape (H, W)

    Raises
    ------
    ItemError
        ``"not-finite"`` or ``"bad-pixels"`` for floating-point pictures; ``"unclear-ink"`` when less than
        three quarters of the margin are on one side of the threshold; ``"all-ink"`` or ``"cut-off"`` when
        there is too much ink; and those of ``mnist3d.ink.photographs.even_out``.
    """
    from mnist3d.ink import photographs  # scipy, which takes half a second to import; only pictures need it

    flat = _over_paper(picture, ink) if picture.mode == "RGBA" else picture
    grey = _brightness(flat, picture_name)
    colours = np.asarray(flat) if flat.mode == "RGB" else grey
    is_flat = np.ptp(grey) < _CONTRAST
    # Ink and paper of different colours may have the same grey.
    is_coloured = is_flat and np.ptp(colours, axis=(0, 1)).max() >= _CONTRAST
    is_clean = _is_cut_out(picture) or photographs.is_clean(grey) or (whole and is_graphic(colours))
    most_ink = MAX_DRAWN if whole else MAX_INK
    if threshold == "local" or (threshold == "auto" and not is_clean):
        return photographs.even_out(colours, ink, whole=whole, notes=notes)
    level = otsu_threshold(grey)
    if ink == "light" or (ink == "auto" and not is_flat and paper_is_dark(grey, level, picture_name)):
        grey, level = 255 - grey, 254 - level
    dark = grey <= level
    if colours.ndim == 3 and ink != "light":
        difference = unlike_paper(colours)
        if is_coloured or loses_colours(difference, dark & ~np.bool_(is_flat)):
            grey = ink_of_colours(difference)
            require_paper_around(grey < 128, most_ink)
            return grey
    # Without both ink and paper there is no contrast to stretch.
    if is_flat or dark.all() or not dark.any():
        return grey
    require_paper_around(dark, most_ink)
    return _stretched(grey, dark)


def pages_of(path: Path) -> tuple[int, ...]:
    """Return the numbers, from 0, of the pictures in a file that are pages.

    Raises ItemError ``"unreadable"``.
    """
    with _named_errors(path):
        facts = path.stat()
    return _pages_of(path, facts.st_mtime_ns, facts.st_size)


@functools.lru_cache(16)
def _pages_of(path: Path, _time_ns: int, _size: int) -> tuple[int, ...]:
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


def _readable_formats(path: Path) -> tuple[str, ...]:
    """Return the formats that a file may have."""
    formats = touch.picture_formats()
    return (*formats, "TGA") if path.suffix.lower() in touch.PICTURE_ENDINGS["TGA"] else formats


@contextmanager
def _opened(path: Path, page: int = 0) -> Iterator[Image.Image]:
    """Open a picture, at a page, by its content; all errors become ItemError ``"unreadable"``."""
    with _named_errors(path):
        facts = path.stat()
        key = (str(path), facts.st_mtime_ns, facts.st_size)
        kept = _KEPT.pop(key, None) if page else None
        if kept is not None and kept.tell() <= page:
            kept.seek(page)
            yield kept
            _KEPT[key] = kept
            return
        with store.open_regular(path) as stream:
            known = known_formats.KnownFormat.of(stream)
            if known is not None and known.key == "svg":
                yield _drawn_svg(stream)
                return
            with Image.open(stream, formats=_readable_formats(path)) as picture:
                if not page or picture.format not in _BUILT_UP:
                    picture.seek(page)
                    yield picture
                    return
            stream.seek(0)
            cache.require_unpackable(facts.st_size, str(path))
            content = io.BytesIO(stream.read())
        picture = Image.open(content, formats=_readable_formats(path))
        picture.seek(page)
        yield picture
        _KEPT.clear()
        _KEPT[key] = picture


@contextmanager
def _named_errors(path: Path) -> Iterator[None]:
    ending = path.suffix.lower()
    try:
        with warnings.catch_warnings():
            # Pillow warns of pictures up to twice its limit; those are reduced, the others are refused.
            warnings.simplefilter("ignore")
            yield
    # Decoders raise many types for broken files: OSError, SyntaxError, ValueError, struct.error, ...
    except Exception as error:
        next_step = "replace it by an intact copy, or leave it out"
        if isinstance(error, Image.DecompressionBombError):
            next_step = "store it with fewer pixels; 20 million are more than enough"
        if isinstance(error, MissingExtraError):
            next_step = f"{error.step}, or save it as PNG"
        if (
            ending in touch.PICTURE_ENDINGS["HEIF"]
            and isinstance(error, UnidentifiedImageError)
            and "HEIF" not in touch.picture_formats()
        ):
            missing = MissingExtraError("HEIF", "pillow-heif", "heic")
            next_step = f"{missing.step}, or store it as JPEG"
        message = f"{path}: cannot be read as a picture ({_problem(error)}), expected an intact image file"
        known = known_formats.KnownFormat.of_file(path) if isinstance(error, UnidentifiedImageError) else None
        if known is not None:
            message = f"{path}: is {known.name}; expected a picture"
            next_step = known.step
        raise ItemError("unreadable", message, next=next_step) from error


def _drawn_svg(stream: IO[bytes]) -> Image.Image:
    """Draw an SVG, without the files that it names; paper is transparent.

    Raises MissingExtraError without the packages of the extra ``svg``, ValueError for a damaged drawing, and
    InputError for one of too many bytes.
    """
    with needs_extra("SVG, a vector drawing,", "pyvips", "svg"):
        import pyvips
    cache.require_unpackable(stream.seek(0, io.SEEK_END), "the drawing")
    stream.seek(0)
    content = stream.read()
    try:
        # librsvg opens no file, and bounds depth, entities and elements.
        size = pyvips.Image.svgload_buffer(content)
        scale = _DRAWN_PX / max(size.width, size.height)
        pixels = pyvips.Image.svgload_buffer(content, scale=scale).numpy()
    except pyvips.Error as error:
        raise ValueError from error
    return Image.fromarray(pixels)


def _problem(error: Exception) -> str:
    """Describe an error in words that do not depend on the versions of libraries."""
    if isinstance(error, ToolkitError):
        return error.what if isinstance(error, MissingExtraError) else error.message
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
    with _opened(path, page) as picture:
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
    with _opened(path, page) as picture:
        return picture.size


def _require_bounded(picture: Image.Image, path: Path) -> None:
    """Raise InputError for a picture that takes too much memory even if it is reduced."""
    if picture.format not in ("JPEG", "MPO"):
        return
    try:
        touch.EncodedImage(path.read_bytes()).require_bounded()
    except ValueError as error:
        raise InputError(str(error)) from error


def _reduced(picture: Image.Image) -> Image.Image:
    """Return a picture that fits into memory: itself, or one with the mean of each square of pixels."""
    width, height = picture.size
    what = f"a picture of {width} x {height} pixels"
    try:
        cache.require_unpackable(width * height * _BYTES_PER_PIXEL.get(picture.mode, 24), what)
    except InputError:
        # JPEG is decoded at 1/2, 1/4 or 1/8 of its size.
        picture.draft(None, (_REDUCED_PX // 2, _REDUCED_PX // 2))
        width, height = picture.size
        cache.require_unpackable(width * height * _BYTES_HELD.get(picture.mode, 4), what)
        factor = -(-max(width, height) // _REDUCED_PX)
        if picture.mode == "1":
            picture = picture.convert("L")
        elif picture.mode == "P":
            picture = picture.convert("RGB")
        return picture.reduce(factor)
    return picture


def _stretched(grey: UInt8, dark: Bool) -> UInt8:
    """Stretch grey levels so that dark ink becomes 0 and the rest, paper, 255."""
    # Ink of thin strokes is mostly edge, so its median would be too light; single dark pixels are specks.
    darkest = float(np.percentile(grey[dark], 10))
    paper = float(np.median(grey[~dark]))
    table = np.clip((np.arange(256) - darkest) * (255 / (paper - darkest)), 0, 255)
    levels: UInt8 = np.rint(table).astype(np.uint8)[grey]
    return levels


def _brightness(picture: Image.Image, picture_name: str) -> UInt8:
    if picture.mode in ("L", "RGB"):
        return np.asarray(picture.convert("L"))
    values = np.asarray(picture)
    whites = (1, 255) if picture.mode == "F" else _WHITES
    largest = float(np.fmax.reduce(values, axis=None, initial=0))
    return as_grey(
        values, next((float(white) for white in whites if largest <= white), whites[-1]), picture_name
    )


def _is_cut_out(picture: Image.Image) -> bool:
    """Return whether the margin of a picture is transparent, which shows that it is paper."""
    return picture.mode == "RGBA" and margin(np.asarray(picture.getchannel("A"))).mean() < _HALF_OPAQUE


def _over_paper(picture: Image.Image, ink: str) -> Image.Image:
    """Lay a transparent picture on white paper, or on black if it has light ink only."""
    alpha = np.asarray(picture.getchannel("A"), np.float32)[..., None] / 255
    colours = np.asarray(picture.convert("RGB"), np.float32)
    light = np.asarray(picture.convert("RGB").convert("L"), np.float32)[..., None]
    cut_out = ink == "auto" and _is_cut_out(picture)
    paper = 255
    if ink == "light" or (cut_out and (light * alpha).sum() > _MOSTLY_LIGHT * 255 * alpha.sum()):
        paper = 0
    return Image.fromarray(np.rint(colours * alpha + paper * (1 - alpha)).astype(np.uint8))
