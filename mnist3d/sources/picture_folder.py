"""A folder of pictures of digits of any mode, depth and polarity."""

from __future__ import annotations

import hashlib
import os
import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

import mnist3d.ink
from mnist3d.sources.digit_source import NO_WRITER, DigitCatalog, DigitImage, require_known
from mnist3d.sources.picture_files import is_picture_name, pages_of
from mnist3d.sources.picture_levels import read_picture
from tactile_toolkit import store
from tactile_toolkit.errors import InputError, IntegrityError, ItemError
from tactile_toolkit.parsed_text import natural_key
from tactile_toolkit.shown_text import printable

_CHOICES = {"ink": ("auto", "dark", "light"), "threshold": ("auto", "local", "global")}
_DIGITS = frozenset("0123456789")
_LABEL = re.compile(r"(?<![a-z])label[_=-]?([0-9])(?![0-9])", re.IGNORECASE)
# At most 18 digits, so that the number fits into 64 bits.
_WRITER = re.compile(r"(?<![a-z])writer[_=-]?([0-9]{1,18})", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class FolderSource:
    """Pictures in ``ROOT/<label>/``, or in ``ROOT`` with the label in their names (``..._label7_...``).

    Pictures may have any size, mode and polarity; they become dark ink on white paper, fitted into
    500 x 500 px. Each page of a TIFF, GIF or other file with pages is a digit. Hidden files are ignored.
    Files of other types are left out; :meth:`fingerprint` names them. ``writer12`` in a name states who wrote
    the digit; otherwise the writer is unknown.

    Parameters
    ----------
    root : str
        The folder.
    ink : str
        ``"dark"`` or ``"light"``, or ``"auto"`` to decide for each picture.
    threshold : str
        ``"local"`` evens out the light of each picture and finds its page, ``"global"`` applies one
        threshold, and ``"auto"`` takes ``"local"`` for pictures without clean paper.

    Notes
    -----
    Ids count from 0 through the pictures sorted by label, then by name with numbers in natural order
    (``2.png`` before ``10.png``), then by page. Adding or removing a picture changes the ids of those after
    it: do not change the folder during a run.
    """

    name: ClassVar[str] = "folder"
    """Word that selects this source on the command line."""

    root: str
    ink: str = "auto"
    threshold: str = "auto"

    def catalog(self) -> DigitCatalog:
        """List the folder and return ids, labels and writers.

        Raises InputError when the folder is missing or holds no picture, has sub-folders that are not digits
        or pictures without a label, or when `ink` or `threshold` has an unknown value.
        """
        pictures = self._listing().pictures
        labels = np.array([picture.label for picture in pictures], np.int64)
        writers = np.array([picture.writer for picture in pictures], np.int64)
        return DigitCatalog(np.arange(len(pictures)), labels, writers)

    def image(self, digit_id: int) -> DigitImage:
        """Read one picture and fit it into 500 x 500 px.

        Raises ItemError ``"unknown-id"``, or one of the reasons of ``read_picture``.
        """
        pictures = self._listing().pictures
        require_known(digit_id, len(pictures), self.root)
        picture = pictures[digit_id]
        pixels = mnist3d.ink.fit(
            read_picture(Path(self.root, picture.name), self.ink, self.threshold, picture.page)
        )
        return DigitImage(digit_id, picture.label, pixels, picture.writer)

    def fingerprint(self) -> dict[str, object]:
        """Return options, count, files that are left out, and one SHA-256 of names, sizes and contents.

        Raises InputError as :meth:`catalog` does, and when a file cannot be opened.
        """
        listing, total = self._listing(), hashlib.sha256()
        for name in dict.fromkeys(picture.name for picture in listing.pictures):
            path = Path(self.root, name)
            try:
                with store.open_regular(path) as stream:
                    data = stream.read()
                    content, size = hashlib.sha256(data).digest(), len(data)
            except OSError as error:
                raise InputError(
                    f"{path}: cannot be opened ({error.strerror}), expected a picture", next="check the file"
                ) from error
            total.update(b"%s\0%d\0%s" % (os.fsencode(name), size, content))
        found: dict[str, object] = {"name": self.name, "ink": self.ink, "images": len(listing.pictures)}
        if self.threshold != "auto":
            found["threshold"] = self.threshold
        if listing.left_out:
            found["left_out"] = dict(listing.left_out)
        return {**found, "sha256": total.hexdigest()}

    def _listing(self) -> _Listing:
        for option, words in _CHOICES.items():
            if getattr(self, option) not in words:
                found = f"{option}: found {getattr(self, option)!r}, expected one of {', '.join(words)}"
                raise InputError(found, next="choose one")
        # Listed again if one of the folders has changed.
        folders = [Path(self.root), *(Path(self.root, digit) for digit in sorted(_DIGITS))]
        stamps = tuple(folder.stat().st_mtime_ns if folder.is_dir() else 0 for folder in folders)
        return _list_folder(self.root, stamps)


class _Picture(NamedTuple):
    label: int
    name: str
    page: int
    writer: int


class _Listing(NamedTuple):
    pictures: tuple[_Picture, ...]
    left_out: tuple[tuple[str, str], ...]
    """Names of other files, and why they are left out."""


@lru_cache(maxsize=4)
def _list_folder(root: str, stamps: tuple[int, ...]) -> _Listing:
    base, found, left_out = Path(root), list[_Picture](), list[tuple[str, str]]()
    try:
        inner = [path for digit in base.glob("[0-9]") for path in digit.iterdir()]
        visible = sorted(path for path in (*base.iterdir(), *inner) if not store.is_hidden(path.name))
    except OSError as error:
        raise InputError(
            f"{root}: cannot be listed ({error.strerror}), expected a folder of pictures",
            next="check the path",
        ) from error
    for path in visible:
        name, is_sorted = path.relative_to(base).as_posix(), path.parent != base
        label, writer = _LABEL.search(path.name), _WRITER.search(path.name)
        if problem := _problem_of(path, base):
            left_out.append((printable(name), problem))
            continue
        pages = () if path.is_dir() else _pages(path)
        is_unsorted = pages and not is_sorted and label is None
        if is_unsorted or (path.is_dir() and (is_sorted or path.name not in _DIGITS)):
            raise InputError(
                f"{root}: found {name!r}, expected pictures in folders named 0 to 9, or with label<digit> in "
                "their names such as a_label7_b.png",
                next="rename it, sort it into such a folder or move it away",
            )
        if not pages and not path.is_dir():
            left_out.append((printable(name), "not a picture"))
        digit = path.parent.name if is_sorted or label is None else label[1]
        found += [_Picture(int(digit), name, page, int(writer[1]) if writer else NO_WRITER) for page in pages]
    if not found:
        raise InputError(
            f"{root}: found no picture, expected {root}/<digit>/*.png (or jpg, tif, ...), digits 0 to 9",
            next="check the path and sort the pictures into such folders",
        )
    order = sorted(
        found, key=lambda each: (each.label, natural_key(each.name.casefold()), each.name, each.page)
    )
    return _Listing(tuple(order), tuple(left_out))


def _problem_of(path: Path, base: Path) -> str:
    """Return why a file must not be opened, or ""; a file that cannot be opened is named when it is read."""
    if path.is_dir():
        return ""
    try:
        store.open_regular(path, below=base).close()
    except IntegrityError:
        return "a link out of the folder" if path.is_file() else "not a regular file"
    except OSError:
        return ""
    return ""


def _pages(path: Path) -> tuple[int, ...]:
    """Return the pages of a picture; one for an unreadable picture, none for files of other types."""
    try:
        return pages_of(path)
    except ItemError:
        return (0,) if is_picture_name(path.name) else ()
