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
from mnist3d.sources import NO_WRITER, DigitCatalog, DigitImage, require_known
from mnist3d.sources.canvas import as_grey, fit
from tactile_toolkit.bounds import require_unpackable
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.store.names import is_hidden
from tactile_toolkit.touch.jpeg import require_bounded_jpeg
from tactile_toolkit.wording import natural_key

if TYPE_CHECKING:
    from PIL.Image import Image


_SUFFIXES = frozenset(
    {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".gif", ".pgm", ".ppm", ".pbm"}
)
_FORMATS = ("PNG", "JPEG", "BMP", "TIFF", "WEBP", "GIF", "PPM")
# Memory that reading takes, by mode, as measured; 24 for transparency and for more than 8 bits.
_BYTES_PER_PIXEL = {"1": 4, "L": 4, "P": 11, "RGB": 11}
_INKS = ("auto", "dark", "light")
_DIGITS = frozenset("0123456789")
_LABEL = re.compile(r"(?<![a-z])label[_=-]?([0-9])(?![0-9])", re.IGNORECASE)
# At most 18 figures: the number fits 64 bits.
_WRITER = re.compile(r"(?<![a-z])writer[_=-]?([0-9]{1,18})", re.IGNORECASE)
# A picture whose grey levels span less shows nothing but paper.
_CONTRAST = 24


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
        require_known(digit_id, len(pictures), self.root)
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
                f"ink: found {self.ink!r}, expected one of {', '.join(_INKS)}", next="choose one"
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
    base, found = Path(root), []
    try:
        inner = [path for digit in base.glob("[0-9]") for path in digit.iterdir()]
        visible = sorted(path for path in (*base.iterdir(), *inner) if not is_hidden(path.name))
    except OSError as error:
        raise InputError(
            f"{root}: cannot be listed ({error.strerror}), expected a folder of pictures",
            next="check the path",
        ) from error
    for path in visible:
        name, is_sorted = path.relative_to(base).as_posix(), path.parent != base
        label, writer = _LABEL.search(path.name), _WRITER.search(path.name)
        is_picture = path.suffix.lower() in _SUFFIXES and not path.is_dir()
        is_unsorted = is_picture and not is_sorted and label is None
        if is_unsorted or (path.is_dir() and (is_sorted or path.name not in _DIGITS)):
            raise InputError(
                f"{root}: found {name!r}, expected pictures in folders named 0 to 9, or with label<digit> in "
                "their names such as a_label7_b.png",
                next="rename it, sort it into such a folder or move it away",
            )
        if is_picture:
            digit = path.parent.name if is_sorted or label is None else label[1]
            found.append(_Picture(int(digit), name, int(writer[1]) if writer else NO_WRITER))
    if not found:
        raise InputError(
            f"{root}: found no picture, expected {root}/<digit>/*.png (or jpg, tif, ...), digits 0 to 9",
            next="check the path and sort the pictures into such folders",
        )
    return tuple(sorted(found, key=lambda each: (each.label, natural_key(each.name.casefold()), each.name)))


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
        if upright.mode[:1] in ("F", "I"):
            return upright
        if upright.has_transparency_data:
            return upright.convert("RGBA")
        return upright.convert("L" if upright.mode in ("1", "L") else "RGB")
    # Decoders of broken files raise whatever comes: OSError, SyntaxError, ValueError, struct.error, ...
    except Exception as error:
        raise ItemError(
            "unreadable",
            f"{path}: cannot be read as a picture ({type(error).__name__}: {error}), expected an intact "
            "image file",
            next="replace or remove it",
        ) from error


def _brightness(picture: Image, ink: str, path: Path) -> NDArray[np.uint8]:
    if picture.mode == "RGBA":
        return _over_paper(picture, ink)
    if picture.mode in ("L", "RGB"):
        return np.asarray(picture.convert("L"))
    # More than 8 bits: 16-bit files use their whole range, floats end at 1 or 255.
    values = np.asarray(picture)
    largest = float(np.fmax.reduce(values, axis=None, initial=0))
    few, many = (1.0, 255.0) if picture.mode == "F" else (255.0, 65535.0)
    is_short = picture.mode in ("F", "I") and largest <= few
    return as_grey(values, few if is_short else many, str(path))


def _over_paper(picture: Image, ink: str) -> NDArray[np.uint8]:
    """Lay a transparent picture on white paper, or on black if light ink is all there is on it."""
    alpha = np.asarray(picture.getchannel("A"), np.float32) / 255
    light = np.asarray(picture.convert("RGB").convert("L"), np.float32)
    cut_out = ink == "auto" and margin(alpha).mean() < 0.5
    bright_ink = cut_out and (light * alpha).sum() > 127.5 * alpha.sum()
    paper = 0 if ink == "light" or bright_ink else 255
    return np.rint(light * alpha + paper * (1 - alpha)).astype(np.uint8)
