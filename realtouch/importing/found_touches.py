"""Touches to import: where their images are and what is said of them; files of the source; formats."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache, partial
from itertools import groupby
from operator import attrgetter
from typing import IO, Any

from realtouch.import_columns import ImportColumns
from realtouch.stored_images import require_intact
from tactile_toolkit import run, store
from tactile_toolkit.array_types import AnyArray, Float64
from tactile_toolkit.column_tables import TYPED_ENDINGS, ColumnTable
from tactile_toolkit.errors import InputError, IntegrityError, ItemError
from tactile_toolkit.kind import lazy
from tactile_toolkit.text_tables import table_lines
from tactile_toolkit.touch import MAX_IMAGE_BYTES
from tactile_toolkit.wording import did_you_mean

IMAGE_ENDINGS = ("jpg", "jpeg", "png", "webp")

# Images that are requested from a store at a time; latency dominates, as images are small.
_FAR_READERS = 16

_HERE = re.compile(r"^(?:\./+)+")

_SIZES_SEEN = 32
_MOST_LINES = 1 << 21  # of a table of touches
_NOTHING: Mapping[str, AnyArray] = {}  # one for all touches: there may be many
_DIGITS = re.compile(r"([0-9]{1,18})")


@dataclass(frozen=True, slots=True)
class FoundTouch:
    """A touch to import: where its pictures are, its fields, and why it cannot be used, if it cannot.

    Attributes
    ----------
    name : str
        What messages call it; a path below the source, or a name that the format has for it.
    home, path : str
        Address of the source, and the file below it that holds the pictures.
    start, size : int
        Where the picture begins in the file, and its bytes; of a recording, the number of its first picture,
        and about how many bytes all of its pictures take.
    values : mapping
        What is said of the touch, by the names of the source.
    problem : ItemError or None
        Why it cannot be used.
    number : int
        Its number among all touches of the source.
    part : str
        What of a file with several sequences of pictures is meant; for the reader of the format alone.
    frames : int
        Pictures of a clip; 0 for a single image.
    per_frame : mapping
        What is said of each picture of a clip: arrays with an entry a picture.
    time_s : ndarray of float64, shape (frames,), or None
        Time of each picture of a clip, seconds; rises. Of an image of a recording, empty where ``values`` has
        its time as ``time_s``.
    contact : tuple of int or None
        First and last picture of a clip that show contact, if that is known.
    """

    name: str
    home: str
    path: str
    start: int
    size: int
    values: Mapping[str, object] = field(repr=False)
    problem: ItemError | None = None
    number: int = 0
    part: str = ""
    frames: int = 0
    per_frame: Mapping[str, AnyArray] = field(default_factory=lambda: _NOTHING, repr=False)
    time_s: Float64 | None = field(default=None, repr=False)
    contact: tuple[int, int] | None = None

    @property
    def file(self) -> tuple[str, str]:
        """Folder and path of the file that holds the image."""
        return self.home, self.path

    def checked(self, number: int) -> FoundTouch:
        """Return the touch with its number among all, and with a problem if what is said of it is not text.

        JSON may hold one half of a surrogate pair without the other, which cannot be stored.
        """
        problem, values = self.problem, self.values
        texts = {name: value for name, value in values.items() if isinstance(value, str)}
        if not "".join(texts.values()).isascii():  # text by text only then: this runs for each image
            for name in [name for name, value in texts.items() if not _is_unicode(value)]:
                problem = problem or ItemError("json", f"its field {name!r} holds text that is not Unicode")
                values = {}
        if problem is None and not self.frames and self.size > MAX_IMAGE_BYTES:
            problem = ItemError("image", f"{self.size:,} bytes; the limit is {MAX_IMAGE_BYTES:,}")
        # Not `dataclasses.replace`, which takes three times as long: this runs for each image.
        where = self.name, self.home, self.path, self.start, self.size
        clip = self.part, self.frames, self.per_frame, self.time_s, self.contact
        return FoundTouch(*where, values, problem, number, *clip)


def _is_unicode(text: str) -> bool:
    return text.encode(errors="ignore").decode() == text


def found_file(
    home: store.DataFolder,
    name: str,
    values: Mapping[str, object],
    sizes: Callable[[str], Mapping[str, int]],
    problem: ItemError | None = None,
    known: set[str] | None = None,
) -> FoundTouch:
    """Return the touch whose image is a file; a missing file is its problem."""
    size = 0
    try:
        size = store.size_inside(home, name, sizes, known)
    except ItemError as error:
        problem = error
    return FoundTouch(name, home.address(), name, 0, size, values, problem)


def visible_files(home: store.DataFolder, endings: str | tuple[str, ...]) -> list[str]:
    """Return the names of visible files directly in a folder that end so; case does not matter."""
    return [name for name in home.sizes() if name.lower().endswith(endings) and not store.is_hidden(name)]


ReadContents = Callable[[Iterable[FoundTouch]], Iterator[bytes | ItemError]]
"""Yields the bytes of the image of each item, in order, or why it cannot be read."""


def common_size(
    items: Sequence[FoundTouch], read: ReadContents, is_one_a_file: bool = False
) -> tuple[int, int] | None:
    """Return the most frequent height and width of images; None if no image can be read.

    Only the first picture of a file is looked at if the format has one size in each. All are looked at only
    where some, spread over all, differ: to read each twice takes long.
    """
    usable = [item for item in items if item.problem is None]
    counts = Counter[object]()
    if is_one_a_file:
        for item in usable:
            counts[item.file, item.part] += max(1, item.frames)
        firsts = {(item.file, item.part): item for item in reversed(usable)}
        usable = [replace(item, frames=0) for item in reversed(firsts.values())]
    sizes = _sizes(usable[:: max(1, len(usable) // _SIZES_SEEN)], read, counts)
    if len(sizes) != 1:
        sizes = _sizes(usable, read, counts)
    return next((size for size, _ in sizes.most_common(1)), None)


def _sizes(
    items: Sequence[FoundTouch], read: ReadContents, counts: Mapping[object, int]
) -> Counter[tuple[int, int]]:
    """Count the sizes of images, each as often as its file; those that are not intact do not count."""
    sizes = Counter[tuple[int, int]]()
    for content, item in zip(read(items), items, strict=True):
        if isinstance(content, bytes):
            with suppress(ValueError):
                sizes[require_intact(content)] += counts.get((item.file, item.part), 1)
    return sizes


def contents_of(items: Iterable[FoundTouch]) -> Iterator[bytes | ItemError]:
    """Yield the bytes of each image, in order, or why it cannot be read.

    A tar is opened once for all that follow each other in it.
    """
    groups = [tuple(group) for _, group in groupby(items, key=attrgetter("file"))]
    read = partial(_contents, cache(lambda home: (store.open_folder(home), set())))
    threads = 1
    if any(store.is_remote(group[0].home) for group in groups[:1]):
        threads = _FAR_READERS
    for found in run.in_threads(read, groups, threads):
        yield from found


def _contents(
    open_folder: Callable[[str], tuple[store.DataFolder, set[str]]], items: Sequence[FoundTouch]
) -> list[bytes | ItemError]:
    found: list[Any] = []
    try:
        folder, known = open_folder(items[0].home)
        with store.open_inside(folder, items[0].path, known) as stream:
            place = 0
            for item in items:
                if item.start != place:
                    stream.seek(item.start)
                found.append(stream.read(item.size))
                place = item.start + len(found[-1])
    except ItemError as error:
        found += [error] * (len(items) - len(found))
    except (OSError, InputError):  # what they say differs between systems
        found += [ItemError("image", "the file cannot be read")] * (len(items) - len(found))
    return found


def path_of(text: str) -> str:
    """Return a path of a table or tar with slashes; programs on Windows write backslashes."""
    path = text.strip().replace("\\", "/")
    return _HERE.sub("", path) if path.startswith(".") else path


def source_of(place: str) -> tuple[store.DataFolder, str]:
    """Return the folder of a file that the user named, and its name there; it may be a link itself."""
    if not store.is_remote(place):
        place = os.path.realpath(place)
    return store.split_uri(place)


def open_source(folder: store.DataFolder, name: str) -> IO[bytes]:
    """Open a table or archive of a source; InputError, which names it, if it cannot be read."""
    try:
        return store.open_inside(folder, name)
    except ItemError as error:
        raise InputError(f"{folder.address(name)!r} cannot be read: {error.what}") from error


def column_table(folder: store.DataFolder, name: str) -> ColumnTable:
    """Return a table that is read in passes; IntegrityError if it is another one in a later pass."""
    place, version = folder.address(name), folder.version(name)

    def opened() -> IO[bytes]:
        if folder.version(name) != version:
            problem = "was replaced or changed while it was read"
            raise IntegrityError(f"{place!r} {problem}", next="run the same command again")
        return open_source(folder, name)

    return ColumnTable(place, opened)


def natural_order(path: str) -> list[tuple[int, str]]:
    """Return a key by which ``demo_2`` stands before ``demo_10``."""
    return [(int(each), "") if each.isdecimal() else (-1, each) for each in _DIGITS.split(path)]


def read_table(folder: store.DataFolder, name: str) -> tuple[list[str], list[dict[str, Any]]]:
    """Return the columns and lines of a table; those of text are text. InputError if it cannot be read."""
    if name.lower().endswith(TYPED_ENDINGS):
        table = column_table(folder, name)
        lines = table.lines(_MOST_LINES)
        return table.names, lines
    with open_source(folder, name) as stream:
        content = stream.read()
    return table_lines(content, folder.address(name))


def require_columns(known: Sequence[str], wanted: Iterable[str], where: str) -> None:
    """Raise InputError for missing or duplicate columns."""
    for name in wanted:
        count = known.count(name)
        if count != 1:
            found = f"{count} columns {name!r}; expected one"
            if not count:
                found = f"no column {name!r}{did_you_mean(name, known)}"
            raise InputError(
                f"{where!r} has {found}; found {', '.join(known) or 'none'}",
                next="name the column with --map, such as --map image=COLUMN for the pictures",
            )


@dataclass(frozen=True)
class ImportFormat:
    """How a format is read.

    ``find`` takes a folder, the columns and the path of a table, and yields touches, or recordings to cut.
    ``contents`` yields the pictures of touches, encoded: as many for each touch as it has. ``cut`` is how
    recordings become touches by default. ``is_one_a_file`` says that pictures of a file have one size.
    ``describe`` states how pictures are converted; empty if they are taken as they are. With ``rotvec`` the
    format has rotation vectors in poses of six numbers.
    """

    find: Callable[[store.DataFolder, ImportColumns, str | None], Iterator[Any]]
    contents: ReadContents = contents_of
    cut: str = "frames"
    is_one_a_file: bool = False
    describe: Callable[[Sequence[FoundTouch]], str] = lambda _touches: ""
    rotvec: bool = False


def _recordings(layout: str, cut: str = "frames", *, rotvec: bool = False) -> ImportFormat:
    """Return a format of recordings, each file of which has pictures of one size."""
    module = f"realtouch.exchange.{layout}_import"
    reader, describe = lazy(f"{module}:encoded_frames"), lazy(f"{module}:describe_conversion")
    return ImportFormat(lazy(f"{module}:find_{layout}"), reader, cut, True, describe, rotvec)


def _touches(layout: str) -> ImportFormat:
    """Return a format whose reader yields touches."""
    return ImportFormat(lazy(f"realtouch.exchange.{layout}_import:find_{layout}"))


IMPORTS: dict[str, ImportFormat] = {
    "folder": _touches("folder"),
    "video": _recordings("video", "whole"),
    "flat": replace(_touches("flat"), contents=lazy("realtouch.exchange.flat_import:stored_images")),
    "webdataset": _touches("webdataset"),
    "lerobot": _recordings("lerobot"),
    "oxt": _recordings("oxt", rotvec=True),
    "replay": _recordings("replay"),
    "hdf5": _recordings("hdf5"),
    "fota": _touches("fota"),
    "sparsh": _touches("sparsh"),
    "anytouch": _touches("anytouch"),
}
"""Formats that are read; each is recognised by its content (:mod:`realtouch.importing.recognised`)."""
