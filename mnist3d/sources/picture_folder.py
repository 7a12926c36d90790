"""A folder of pictures of digits, letters, words or other drawings of any mode, depth and polarity."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from mnist3d.ink.grey_levels import fit
from mnist3d.sources import picture_files
from mnist3d.sources.digit_source import DIGITS, NO_WRITER, DigitCatalog, DigitImage, require_known
from tactile_toolkit import store
from tactile_toolkit.errors import InputError, IntegrityError, ItemError
from tactile_toolkit.wording import natural_key, printable

_CHOICES = {"ink": ("auto", "dark", "light"), "threshold": ("auto", "local", "global")}
_LABEL = re.compile(r"(?<![a-z])label[_=-]?([0-9])(?![0-9])", re.IGNORECASE)
# At most 18 digits, so that the number fits into 64 bits.
_WRITER = re.compile(r"(?<![a-z])writer[_=-]?([0-9]{1,18})", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class FolderSource:
    """Pictures in ``ROOT/<class>/``, or in ``ROOT`` with the digit in their names (``..._label7_...``).

    The folders are the classes, also those without pictures yet. If all of them are digits, the classes are
    the ten digits, and each picture must show one digit. Otherwise the pictures may show anything, such as
    letters, words or drawings. They may have any size, mode and polarity; they become dark ink on white
    paper, fitted into 500 x 500 px. Each page of a TIFF, GIF or other file with pages is a picture. Hidden
    files are ignored. Files of other types are left out; :meth:`fingerprint` names them. ``writer12`` in a
    name states who wrote it; otherwise the writer is unknown.

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

        Raises InputError when the folder is missing or holds no picture, has pictures without a class or
        folders within those of the classes, or when `ink` or `threshold` has an unknown value.
        """
        listing = self._listing()
        pictures = listing.pictures
        labels = np.array([picture.label for picture in pictures], np.int64)
        writers = np.array([picture.writer for picture in pictures], np.int64)
        return DigitCatalog(np.arange(len(pictures)), labels, writers, listing.class_names, True)

    def image(self, digit_id: int) -> DigitImage:
        """Read one picture and fit it into 500 x 500 px.

        Raises ItemError ``"unknown-id"``, or one of the reasons of ``read_picture``.
        """
        listing = self._listing()
        require_known(digit_id, len(listing.pictures), self.root)
        picture = listing.pictures[digit_id]
        is_whole = listing.class_names != DIGITS
        path = Path(self.root, picture.name)
        pixels = fit(picture_files.read_picture(path, self.ink, self.threshold, picture.page, whole=is_whole))
        return DigitImage(digit_id, picture.label, pixels, picture.writer, picture.file)

    def fingerprint(self) -> dict[str, object]:
        """Return options, count, classes, files that are left out, and one SHA-256 of names and contents.

        Raises InputError as :meth:`catalog` does, and when a file cannot be opened.
        """
        listing, total = self._listing(), hashlib.sha256()
        for name in dict.fromkeys(picture.name for picture in listing.pictures):
            path = Path(self.root, name)
            try:
                with store.open_regular(path) as stream:
                    data = stream.read()
                    content = hashlib.sha256(data).digest()
                    size = len(data)
            except OSError as error:
                raise InputError(
                    f"{path}: cannot be opened ({error.strerror}), expected a picture", next="check the file"
                ) from error
            total.update(b"%s\0%d\0%s" % (os.fsencode(name), size, content))
        facts: dict[str, object] = {"name": self.name, "ink": self.ink, "images": len(listing.pictures)}
        if self.threshold != "auto":
            facts["threshold"] = self.threshold
        if listing.class_names != DIGITS:
            facts["classes"] = list(listing.class_names)
        if listing.left_out:
            facts["left_out"] = dict(listing.left_out)
        return {**facts, "sha256": total.hexdigest()}

    def _listing(self) -> _Listing:
        for option, words in _CHOICES.items():
            if getattr(self, option) not in words:
                message = f"{option}: found {getattr(self, option)!r}, expected one of {', '.join(words)}"
                raise InputError(message, next="choose one")
        # Listed again if one of the folders has changed.
        return _list_folder(self.root, _stamps(self.root))


class _Picture(NamedTuple):
    label: int
    name: str
    page: int
    writer: int
    file: str


class _Listing(NamedTuple):
    pictures: tuple[_Picture, ...]
    left_out: tuple[tuple[str, str], ...]
    """Names of other files, and why they are left out."""
    class_names: tuple[str, ...]


def _stamps(root: str) -> tuple[int, ...]:
    """Return the times at which a folder and the folders in it were changed."""
    base = Path(root)
    with suppress(OSError):
        inner = sorted(path for path in base.iterdir() if path.is_dir())
        return tuple(folder.stat().st_mtime_ns for folder in (base, *inner))
    return ()


@lru_cache(maxsize=4)
def _list_folder(root: str, stamps: tuple[int, ...]) -> _Listing:
    base = Path(root)
    left_out = list[tuple[str, str]]()
    try:
        visible = _visible(base)
        classes = [path for path in visible if path.is_dir()]
        files = [path for path in visible if not path.is_dir()]
        files += [path for folder in classes for path in _visible(folder)]
    except OSError as error:
        raise InputError(
            f"{root}: cannot be listed ({error.strerror}), expected a folder of pictures",
            next="check the path",
        ) from error
    pages: dict[Path, tuple[int, ...]] = {}
    for path in sorted(files):
        name = path.relative_to(base).as_posix()
        if path.is_dir():
            raise _misplaced(root, name)
        problem = _problem_of(path, base)
        pages[path] = () if problem else _pages(path)
        if not pages[path]:
            left_out.append((printable(name), problem or "not a picture"))
    names = _class_names(root, [folder.name for folder in classes if _is_class(folder, files, pages)])
    pictures = [
        picture for path, numbers in pages.items() for picture in _pictures_of(root, path, numbers, names)
    ]
    if not pictures:
        raise InputError(
            f"{root}: found no picture, expected {root}/<class>/*.png (or jpg, tif, ...), such as {root}/7",
            next="check the path and sort the pictures into a folder for each class",
        )
    order = sorted(
        pictures,
        key=lambda picture: (picture.label, natural_key(picture.name.casefold()), picture.name, picture.page),
    )
    return _Listing(tuple(order), tuple(left_out), names)


def _visible(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if not store.is_hidden(path.name))


def _is_class(folder: Path, files: Sequence[Path], pages: Mapping[Path, tuple[int, ...]]) -> bool:
    """Return whether a folder holds pictures, or nothing yet."""
    inside = [path for path in files if path.parent == folder]
    return not inside or any(pages[path] for path in inside)


def _class_names(root: str, folders: Sequence[str]) -> tuple[str, ...]:
    """Return the classes that folders stand for: the digits, if all of them are digits."""
    if set(folders) <= set(DIGITS):
        return DIGITS
    strange = next((name for name in folders if printable(name) != name or not name.isprintable()), None)
    if strange is not None:
        raise InputError(
            f"{root}: found a folder called {strange!r}, expected the name of a class as plain text",
            next="rename it",
        )
    return tuple(sorted(folders, key=lambda name: (natural_key(name.casefold()), name)))


def _pictures_of(root: str, path: Path, pages: tuple[int, ...], names: tuple[str, ...]) -> Iterator[_Picture]:
    """Yield the pages of a file with its class; InputError if it has no class."""
    name = path.relative_to(root).as_posix()
    label = _LABEL.search(path.name)
    class_name = path.parent.name
    if path.parent == Path(root):
        class_name = ""
        if label is not None and names == DIGITS:
            class_name = label[1]
    if pages and class_name not in names:
        raise _misplaced(root, name)
    writer = _WRITER.search(path.name)
    for page in pages:
        file = f"{name}#{page + 1}" if len(pages) > 1 else name
        number = int(writer[1]) if writer else NO_WRITER
        yield _Picture(names.index(class_name), name, page, number, printable(file))


def _misplaced(root: str, name: str) -> InputError:
    return InputError(
        f"{root}: found {name!r}, expected pictures in a folder for each class, such as {root}/7, or "
        "with label<digit> in their names such as a_label7_b.png",
        next="sort it into the folder of its class, or move it away",
    )


def _problem_of(path: Path, base: Path) -> str:
    """Return why a file must not be opened, or ""; a file that cannot be opened is named when it is read."""
    try:
        with suppress(OSError):
            store.open_regular(path, below=base).close()
    except IntegrityError:
        return "a link out of the folder" if path.is_file() else "not a regular file"
    return ""


def _pages(path: Path) -> tuple[int, ...]:
    """Return the pages of a picture; one for an unreadable picture, none for files of other types."""
    try:
        return picture_files.pages_of(path)
    except ItemError:
        return (0,) if picture_files.is_picture_name(path.name) else ()
