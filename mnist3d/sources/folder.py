"""A folder of pictures of digits, whatever their mode, depth and polarity."""

from __future__ import annotations

import hashlib
import os
import re
import warnings
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mnist3d.ink import margin, otsu_threshold, paper_is_dark
from mnist3d.sources import NO_WRITER, DigitCatalog, DigitImage
from mnist3d.sources.canvas import as_grey, fit
from tactile_toolkit.bounds import require_unpackable
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.touch.jpeg import require_bounded_jpeg

if TYPE_CHECKING:
    from PIL.Image import Image


_SUFFIXES = frozenset(
    {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".gif", ".pgm", ".ppm", ".pbm"}
)
_FORMATS = ("PNG", "JPEG", "BMP", "TIFF", "WEBP", "GIF", "PPM")
_BYTES_PER_PIXEL = {"1": 4, "L": 4, "P": 11, "RGB": 11}
"""Memory that reading takes, by mode, as measured; 24 for transparency and for more than 8 bits."""
_INKS = ("auto", "dark", "light")
_DIGITS = frozenset("0123456789")
_LABEL = re.compile(r"(?<![a-z])label[_=-]?([0-9])(?![0-9])", re.IGNORECASE)
# At most 18 figures: the number fits 64 bits.
_WRITER = re.compile(r"(?<![a-z])writer[_=-]?([0-9]{1,18})", re.IGNORECASE)
_CONTRAST = 24
"""A picture whose grey levels span less shows nothing but paper."""


@dataclass(frozen=True, slots=True)
class FolderSource:
    """Pictures in ``ROOT/<label>/``, or in ``ROOT`` with the label in their names (``..._label7_...``).

    Pictures may have any size, mode and polarity; they are turned to dark ink on white paper and fitted into
    500 x 500 px. Hidden files and files of other types are left out. A name that contains ``writer12`` says
    who wrote the digit; otherwise the writer is unknown.

    Parameters
    ----------
    root : str
        The folder.
    ink : str
        ``"dark"`` or ``"light"``, or ``"auto"`` to find out for each picture from its margin.

    Notes
    -----
    Ids count from 0 through the pictures sorted by label, then by name with numbers in their natural order
    (``2.png`` before ``10.png``). So adding or removing a picture changes the ids of those after it: leave
    the folder alone during a run.
    """

    name: ClassVar[str] = "folder"
    """Word that selects this source on the command line."""

    root: str
    ink: str = "auto"

    def catalog(self) -> DigitCatalog:
        """List the folder and return ids, labels and writers.

        Raises InputError when the folder is missing, holds no picture, has sub-folders that are not digits,
        or pictures whose label is unknown; or when `ink` is not one of its words.
        """
        pictures = self._pictures()
        labels = np.array([picture.label for picture in pictures], np.int64)
        writers = np.array([picture.writer for picture in pictures], np.int64)
        return DigitCatalog(np.arange(len(pictures)), labels, writers)

    def image(self, digit_id: int) -> DigitImage:
        """Read one picture and fit it into 500 x 500 px.

        Raises ItemError ``"unknown-id"``, or one of the reasons of :func:`read_picture`.
        """
        pictures = self._pictures()
        if not 0 <= digit_id < len(pictures):
            reason, last = "unknown-id", len(pictures) - 1
            raise ItemError(
                reason, f"{self.root}: no picture {digit_id}, expected 0 to {last}; next: check the id"
            )
        picture = pictures[digit_id]
        pixels = fit(read_picture(Path(self.root, picture.name), self.ink))
        return DigitImage(digit_id, picture.label, pixels, picture.writer)

    def fingerprint(self) -> dict[str, object]:
        """Return `ink`, the count, and one SHA-256 of all names, sizes and contents.

        Raises InputError see :meth:`catalog`; also when a file cannot be opened.
        """
        pictures = self._pictures()
        total = hashlib.sha256()
        for picture in pictures:
            path = Path(self.root, picture.name)
            try:
                with path.open("rb") as stream:
                    content = hashlib.file_digest(stream, "sha256").digest()
                    size = stream.tell()
            except OSError as error:
                raise InputError(
                    f"{path}: cannot be opened ({error.strerror}), expected a picture", next="check the file"
                ) from error
            total.update(b"%s\0%d\0%s" % (os.fsencode(picture.name), size, content))
        return {"name": self.name, "ink": self.ink, "images": len(pictures), "sha256": total.hexdigest()}

    def _pictures(self) -> tuple[_Picture, ...]:
        if self.ink not in _INKS:
            raise InputError(
                f"ink: found {self.ink!r}, expected one of {', '.join(_INKS)}", next="choose one of them"
            )
        # Listed again when one of the folders has changed since.
        folders = [Path(self.root), *(Path(self.root, digit) for digit in sorted(_DIGITS))]
        stamps = tuple(folder.stat().st_mtime_ns if folder.is_dir() else 0 for folder in folders)
        return _listing(self.root, stamps)


class _Picture(NamedTuple):
    label: int
    name: str
    writer: int


@lru_cache(maxsize=4)
def _listing(root: str, stamps: tuple[int, ...]) -> tuple[_Picture, ...]:
    folders, files = _visible(root, "")
    others = [name for name in folders if name not in _DIGITS]
    if others:
        raise InputError(
            f"{root}: found the folders {_some(others)}, expected only folders named 0 to 9; "
            "next: rename them or move them away"
        )
    matches = {name: _LABEL.search(name) for name in files}
    unlabelled = [name for name, match in matches.items() if match is None]
    if unlabelled:
        raise InputError(
            f"{root}: found pictures without a digit in their names: {_some(unlabelled)}, expected names "
            "with label<digit> such as a_label7_b.png",
            next="rename them or sort them into folders named 0 to 9",
        )
    found = [_Picture(int(match[1]), name, _writer(name)) for name, match in matches.items() if match]
    for folder in folders:
        inner, names = _visible(root, folder)
        if inner:
            raise InputError(
                f"{root}: found the folder {inner[0]!r}, expected pictures only", next="move it away"
            )
        found += [_Picture(int(folder), name, _writer(name)) for name in names]
    if not found:
        raise InputError(
            f"{root}: found no picture, expected {root}/<digit>/*.png (or jpg, tif, ...), digits 0 to 9; "
            "next: check the path and sort the pictures into such folders"
        )
    return tuple(sorted(found, key=lambda picture: (picture.label, _natural(picture.name))))


def _visible(root: str, folder: str) -> tuple[list[str], list[str]]:
    """Names, relative to `root`, of the sub-folders and the pictures in one folder, hidden ones left out."""
    path = Path(root, folder)
    folders, files = [], []
    try:
        with os.scandir(path) as entries:
            for entry in entries:
                name = f"{folder}/{entry.name}" if folder else entry.name
                if entry.name.startswith("."):
                    continue
                if entry.is_dir():
                    folders.append(name)
                elif Path(name).suffix.lower() in _SUFFIXES:
                    files.append(name)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be listed ({error.strerror}), expected a folder of pictures; "
            "next: check the path"
        ) from error
    return sorted(folders), sorted(files)


def _writer(name: str) -> int:
    match = _WRITER.search(name.rpartition("/")[2])
    return int(match[1]) if match else NO_WRITER


def _natural(name: str) -> tuple[list[str | int], str]:
    pieces = re.split(r"([0-9]+)", name.casefold())
    return [int(piece) if piece.isdecimal() and piece.isascii() else piece for piece in pieces], name


def _some(names: list[str]) -> str:
    shown = ", ".join(repr(name) for name in names[:5])
    return shown if len(names) <= 5 else f"{shown} and {len(names) - 5} more"


def read_picture(path: Path, ink: str = "auto") -> NDArray[np.uint8]:
    """Read a picture of a digit in its own size, ink 0 and paper 255.

    Colours become grey, transparency shows paper, the orientation in EXIF is followed, and of an animation
    the first frame counts. Grey levels are then stretched so that paper is white and ink black; a picture of
    black on white comes back unchanged, and one without contrast (an empty page) is not stretched. With
    ``"auto"`` the margin of the picture is paper, so the ink is whatever the margin is not, on either side of
    Otsu's threshold.

    Raises ItemError ``"unreadable"``; ``"unclear-ink"`` when less than three quarters of the margin are on
    one side of the threshold; ``"not-finite"`` or ``"bad-pixels"`` for floating-point pictures.
    """
    grey = _brightness(_decoded(path), ink, path)
    if np.ptp(grey) < _CONTRAST:
        return 255 - grey if ink == "light" else grey
    threshold = otsu_threshold(grey)
    if ink == "light" or (ink == "auto" and paper_is_dark(grey, threshold, str(path))):
        grey, threshold = 255 - grey, 254 - threshold
    dark = grey <= threshold
    # Nothing to stretch by, and a division by nothing below.
    if dark.all() or not dark.any():
        return grey
    # Ink of thin strokes is mostly edge, so its median would be too light; single dark pixels are specks.
    darkest, paper = float(np.percentile(grey[dark], 10)), float(np.median(grey[~dark]))
    table = np.clip((np.arange(256) - darkest) * (255 / (paper - darkest)), 0, 255)
    levels: NDArray[np.uint8] = np.rint(table).astype(np.uint8)[grey]
    return levels


def _decoded(path: Path) -> Image:
    from PIL import Image, ImageOps

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # Pillow only warns of pictures up to twice its limit; one of them takes half a gigabyte.
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(path, formats=_FORMATS) as picture:
                memory = picture.width * picture.height * _BYTES_PER_PIXEL.get(picture.mode, 24)
                require_unpackable(memory, f"a picture of {picture.width} x {picture.height} pixels")
                if picture.format in ("JPEG", "MPO"):
                    require_bounded_jpeg(path.read_bytes())
                upright = ImageOps.exif_transpose(picture)
        if upright.mode in ("F", "I") or upright.mode.startswith("I;16"):
            return upright
        if upright.has_transparency_data:
            return upright.convert("RGBA")
        return upright.convert("L" if upright.mode in ("1", "L") else "RGB")
    # Decoders of broken files raise whatever comes: OSError, SyntaxError, ValueError, struct.error, ...
    except Exception as error:
        reason = "unreadable"
        raise ItemError(
            reason,
            f"{path}: cannot be read as a picture ({type(error).__name__}: {error}), expected an intact "
            "image file; next: replace or remove it",
        ) from error


def _brightness(picture: Image, ink: str, path: Path) -> NDArray[np.uint8]:
    if picture.mode == "RGBA":
        return _over_paper(picture, ink)
    if picture.mode in ("L", "RGB"):
        return np.asarray(picture.convert("L"))
    # More than 8 bits: 16-bit files use their whole range, floats end at 1 or 255.
    values = np.asarray(picture)
    largest = float(np.fmax.reduce(values, axis=None, initial=0))
    if picture.mode == "F":
        white = 1.0 if largest <= 1 else 255.0
    else:
        white = 65535.0 if picture.mode != "I" or largest > 255 else 255.0
    return as_grey(values, white, str(path))


def _over_paper(picture: Image, ink: str) -> NDArray[np.uint8]:
    """Lay a transparent picture on white paper, or on black if light ink is all there is on it."""
    alpha = np.asarray(picture.getchannel("A"), np.float32) / 255
    light = np.asarray(picture.convert("RGB").convert("L"), np.float32)
    cut_out = ink == "auto" and margin(alpha).mean() < 0.5
    bright_ink = cut_out and (light * alpha).sum() > 127.5 * alpha.sum()
    paper = 0 if ink == "light" or bright_ink else 255
    return np.rint(light * alpha + paper * (1 - alpha)).astype(np.uint8)
