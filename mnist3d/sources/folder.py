"""A folder of pictures of digits."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mnist3d.sources import NO_WRITER, DigitCatalog, DigitImage
from mnist3d.sources.canvas import fit
from mnist3d.sources.picture import read_picture
from tactile_toolkit.errors import InputError, ItemError

__all__ = ["FolderSource"]

_SUFFIXES = frozenset(
    {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".gif", ".pgm", ".ppm", ".pbm"}
)
_INKS = ("auto", "dark", "light")
_DIGITS = frozenset("0123456789")
_LABEL = re.compile(r"(?<![a-z])label[_=-]?([0-9])(?![0-9])", re.IGNORECASE)
_WRITER = re.compile(r"(?<![a-z])writer[_=-]?([0-9]{1,18})", re.IGNORECASE)


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

    root: str
    ink: str = "auto"

    @property
    def name(self) -> str:
        """Word that selects this source on the command line."""
        return "folder"

    def catalog(self) -> DigitCatalog:
        """List the folder and return ids, labels and writers.

        Raises
        ------
        InputError
            When the folder is missing, holds no picture, has sub-folders that are not digits, or pictures
            whose label is unknown; or when `ink` is none of its words.
        """
        pictures = self._pictures()
        labels = np.array([picture.label for picture in pictures], np.int64)
        writers = np.array([picture.writer for picture in pictures], np.int64)
        return DigitCatalog(np.arange(len(pictures)), labels, writers)

    def image(self, digit_id: int) -> DigitImage:
        """Read one picture and fit it into 500 x 500 px.

        Raises
        ------
        ItemError
            ``"unknown-id"``, or one of the reasons of :func:`~mnist3d.sources.picture.read_picture`.
        """
        pictures = self._pictures()
        if not 0 <= digit_id < len(pictures):
            reason, last = "unknown-id", len(pictures) - 1
            message = f"{self.root}: no picture {digit_id}, expected 0 to {last}; next: check the id"
            raise ItemError(reason, message)
        picture = pictures[digit_id]
        pixels = fit(read_picture(Path(self.root, picture.name), self.ink))
        return DigitImage(digit_id, picture.label, pixels, picture.writer)

    def fingerprint(self) -> dict[str, object]:
        """Return `ink`, the count, and one SHA-256 of all names, sizes and contents.

        Raises
        ------
        InputError
            See :meth:`catalog`; also when a file cannot be opened.
        """
        pictures = self._pictures()
        total = hashlib.sha256()
        for picture in pictures:
            total.update(_digest(self.root, picture.name))
        return {"name": self.name, "ink": self.ink, "images": len(pictures), "sha256": total.hexdigest()}

    def _pictures(self) -> tuple[_Picture, ...]:
        if self.ink not in _INKS:
            message = f"ink: found {self.ink!r}, expected one of {', '.join(_INKS)}; next: choose one of them"
            raise InputError(message)
        return _listing(self.root, _stamps(self.root))


class _Picture(NamedTuple):
    label: int
    name: str
    writer: int


def _digest(root: str, name: str) -> bytes:
    path = Path(root, name)
    try:
        with path.open("rb") as stream:
            content = hashlib.file_digest(stream, "sha256").digest()
            size = stream.tell()
    except OSError as error:
        message = f"{path}: cannot be opened ({error.strerror}), expected a picture; next: check the file"
        raise InputError(message) from error
    return b"%s\0%d\0%s" % (os.fsencode(name), size, content)


def _stamps(root: str) -> tuple[int, ...]:
    """Return when each folder of pictures last changed, so that a listing is made again when needed."""
    folders = [Path(root), *(Path(root, digit) for digit in sorted(_DIGITS))]
    return tuple(folder.stat().st_mtime_ns if folder.is_dir() else 0 for folder in folders)


@lru_cache(maxsize=4)
def _listing(root: str, stamps: tuple[int, ...]) -> tuple[_Picture, ...]:
    folders, files = _visible(root, "")
    _refuse_others(root, folders)
    labelled = zip(_labels(root, files), files, strict=True)
    found = [_Picture(label, name, _writer(name)) for label, name in labelled]
    for folder in folders:
        inner, names = _visible(root, folder)
        if inner:
            message = f"{root}: found the folder {inner[0]!r}, expected pictures only; next: move it away"
            raise InputError(message)
        found += [_Picture(int(folder), name, _writer(name)) for name in names]
    if not found:
        message = (
            f"{root}: found no picture, expected {root}/<digit>/*.png (or jpg, tif, ...), digits 0 to 9; "
            "next: check the path and sort the pictures into such folders"
        )
        raise InputError(message)
    return tuple(sorted(found, key=lambda picture: (picture.label, _natural(picture.name))))


def _visible(root: str, folder: str) -> tuple[list[str], list[str]]:
    """Names, relative to `root`, of the sub-folders and the pictures in one folder, hidden ones left out."""
    folders, files = [], []
    for entry in _entries(Path(root, folder)):
        name = f"{folder}/{entry.name}" if folder else entry.name
        if entry.name.startswith("."):
            continue
        if entry.is_dir():
            folders.append(name)
        elif Path(name).suffix.lower() in _SUFFIXES:
            files.append(name)
    return sorted(folders), sorted(files)


def _entries(folder: Path) -> Iterator[os.DirEntry[str]]:
    try:
        with os.scandir(folder) as entries:
            yield from entries
    except OSError as error:
        message = (
            f"{folder}: cannot be listed ({error.strerror}), expected a folder of pictures; "
            "next: check the path"
        )
        raise InputError(message) from error


def _refuse_others(root: str, folders: list[str]) -> None:
    others = [name for name in folders if name not in _DIGITS]
    if others:
        message = (
            f"{root}: found the folders {_some(others)}, expected only folders named 0 to 9; "
            "next: rename them or move them away"
        )
        raise InputError(message)


def _labels(root: str, names: list[str]) -> list[int]:
    matches = [_LABEL.search(name) for name in names]
    lost = [name for name, match in zip(names, matches, strict=True) if match is None]
    if lost:
        message = (
            f"{root}: found pictures without a digit in their names: {_some(lost)}, expected names with "
            "label<digit> such as a_label7_b.png; next: rename them or sort them into folders named 0 to 9"
        )
        raise InputError(message)
    return [int(match[1]) for match in matches if match]


def _writer(name: str) -> int:
    match = _WRITER.search(name.rpartition("/")[2])
    return int(match[1]) if match else NO_WRITER


def _natural(name: str) -> tuple[list[str | int], str]:
    pieces = re.split(r"([0-9]+)", name.casefold())
    return [int(piece) if piece.isdecimal() and piece.isascii() else piece for piece in pieces], name


def _some(names: list[str]) -> str:
    shown = ", ".join(repr(name) for name in names[:5])
    return shown if len(names) <= 5 else f"{shown} and {len(names) - 5} more"
