"""Files of a source: their names, tables and pictures; nothing outside its folder is read."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from itertools import chain, groupby, islice, repeat
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa

from realtouch.importing import import_options, source_touches
from tactile_toolkit import errors, run, store, touch, wording
from tactile_toolkit.columns import column_types, tables
from tactile_toolkit.value_types import JsonDict

IMAGE_ENDINGS = tuple(ending for endings in touch.PICTURE_ENDINGS.values() for ending in endings)
"""Endings of pictures, in lower case; those of formats that cannot be read are left out and listed."""

FILE_OF_TABLE = "file as in row {} of the table"
"""Text for :func:`duplicates_of` where a table names a file twice."""

NUMBERED = "label"
"""The field of our own exports that numbers the classes."""

# Images that are requested from a store at a time: images are small, so latency dominates.
_REMOTE_READERS = 16
_AT_ONCE = 16  # pictures of a file that are read together
_CURRENT_FOLDER = re.compile(r"^(?:\./+)+")

ReadContents = Callable[[Iterable[source_touches.PictureLocation]], Iterator[bytes | errors.ItemError]]
"""Yields the bytes of the pictures at each location, in order, or why one cannot be read."""

ReadNumbers = Callable[
    [store.DataFolder, source_touches.PictureLocation, Sequence[int]], Iterator[bytes | errors.ItemError]
]
"""Yields the pictures with some numbers from the file, and the part of it, of a location."""


@dataclass(frozen=True, slots=True)
class Ledger:
    """What becomes of all that a source holds beside touches.

    Attributes
    ----------
    used : set of str
        Addresses of files and folders that were read; everything in such a folder counts as read.
    left_out : dict of str to None
        Data that are not imported, each with its shape or the reason, in order.
    notes : dict of str to None
        Decisions that the import states, in order.
    """

    used: set[str] = field(default_factory=set)
    left_out: dict[str, None] = field(default_factory=dict)
    notes: dict[str, None] = field(default_factory=dict)
    _listed: dict[str, Mapping[str, int | None]] = field(default_factory=dict)

    def use(self, folder: store.DataFolder, path: str) -> None:
        """Note that a file, or all of a folder, was read."""
        self.used.add(folder.address(path))

    def entries(self, home: store.DataFolder, folder: str = "") -> Mapping[str, int | None]:
        """List a sub-folder once, as :meth:`store.DataFolder.entries` does."""
        address = f"{home.root}/{folder}"  # this runs for each image, so only `home.entries` checks the path
        if address not in self._listed:
            self._listed[address] = home.entries(folder)
        return self._listed[address]

    def unread(self, home: store.DataFolder, folder: str = "") -> Iterator[str]:
        """Yield the visible files and links of a folder that were not read."""
        folder_address = home.address(folder)
        for name, size in self.entries(home, folder).items():
            path = f"{folder}/{name}".lstrip("/")
            address = f"{folder_address}/{name}"
            if store.is_hidden(path) or address in self.used:
                continue
            if size is None and not (home.is_local and Path(address).is_symlink()):
                yield from self.unread(home, path)
            else:
                yield path


def path_of(text: str) -> str:
    """Return a path in a table or tar with slashes; programs on Windows write backslashes."""
    path = text.strip().replace("\\", "/")
    return _CURRENT_FOLDER.sub("", path) if path.startswith(".") else path


def source_of(path_or_address: str) -> tuple[store.DataFolder, str]:
    """Return the folder of a file that the user named, and its name there; the file may be a link."""
    path = store.local_path(path_or_address)
    return store.split_uri(path_or_address if path is None else os.path.realpath(path))


def address_of(path_or_address: str) -> str:
    """Return the address of a file that the user named; the target of a link."""
    home, name = source_of(path_or_address)
    return home.address(name)


def visible_files(home: store.DataFolder, endings: str | tuple[str, ...]) -> list[str]:
    """Return the names of visible files in a folder that have one of the endings; case does not matter."""
    return [name for name in home.sizes() if name.lower().endswith(endings) and not store.is_hidden(name)]


def files_to_read(
    home: store.DataFolder, expected: str, find: Callable[[store.DataFolder], list[str]]
) -> tuple[store.DataFolder, list[str]]:
    """Return a folder and the files of a format in it, as ``find`` lists them; or the file that was named.

    Raises InputError, which says what is ``expected``, if there is no such file.
    """
    names = find(home)
    # Asked last: for a folder in a store, this is another listing.
    if not names and (home.info("") or {}).get("type") == "file":
        home, name = source_of(home.address())
        return home, [name]
    if not names:
        raise errors.InputError(f"{home.address()!r} holds no {expected}", next="check the path")
    return home, names


class SourceTable(NamedTuple):
    """A table of touches, a row for each."""

    columns: Mapping[str, pa.Array]
    rows: int

    def texts(self, name: str) -> list[str]:
        """Return a column as text; empty where there is no value."""
        texts: list[str] = column_types.texts_of(self.columns[name]).fill_null("").to_pylist()
        return texts

    def values(self, row: int) -> JsonDict:
        """Return the values of a row by column."""
        return {name: column[row].as_py() for name, column in self.columns.items()}


@store.without_collecting()
def read_table(
    table: tables.Table, columns: import_options.ImportColumns, names: Iterable[str | None] = ()
) -> SourceTable:
    """Read a whole table; InputError if it cannot be read.

    In text tables, the columns of labels, rounds, objects and splits stay text, and so do those in ``names``.
    Other columns get types, and lists of numbers in brackets become vectors.
    """
    known = columns.found_in(table.names)
    texts = {NUMBERED, known.label, known.round, known.object_id, known.split, *names}
    numbers = {*(known.position or ()), *(known.pose or ()), known.time}
    read = table.whole({*filter(None, texts)}, {*filter(None, numbers)})
    return SourceTable(read, len(next(iter(read.values()), ())))


def require_columns(known: Collection[str], required: Iterable[str], source: str) -> None:
    """Raise InputError for a missing column."""
    for name in required:
        if name not in known:
            raise errors.InputError(
                f"{source!r} has no column {name!r}{wording.did_you_mean(name, known)}; "
                f"found {', '.join(known) or 'none'}",
                next="name the column with --map, such as --map image=COLUMN for the pictures",
            )


def chosen_pictures(
    known: Collection[str],
    name: str,
    source: str,
    what: str,
    others: Iterable[str] = (),
    advice: str = "",
) -> str:
    """Return the name of the pictures to import: the given name, or else the only known one.

    Raises InputError if there is no such name or if there are several. The message says ``what`` the names
    are, and lists the ``others`` and gives the ``advice`` if none is known.
    """
    chosen = [choice for choice in known if name in ("", choice)]
    if len(chosen) == 1:
        return chosen[0]
    if not known:
        raise errors.InputError(
            f"{source!r} has no {what}, but {', '.join(others) or 'nothing'}; expected pictures of a sensor",
            next=f"{advice or 'give a source with pictures'}",
        )
    expected = f"{name!r}{wording.did_you_mean(name, known)}" if name else "one"
    raise errors.InputError(
        f"{source!r} has the {what} {', '.join(known)}; expected {expected}",
        next="choose one with --map image=NAME",
    )


def duplicates_of(names: Sequence[str], template: str) -> dict[int, errors.ItemError]:
    """Return a problem for each name that occurs again; ``template`` is formatted with its first number."""
    first: dict[str, int] = {}
    return {
        number: errors.ItemError("duplicate", f"the same {template.format(first[name])}")
        for number, name in enumerate(names)
        if first.setdefault(name, number) != number
    }


def problems_of_names(paths: Iterable[str]) -> dict[int, errors.ItemError]:
    """Return a problem for each path that is not that of a file of a source."""
    return {
        number: errors.ItemError("name", f"the name {problem}; expected a path below the folder")
        for number, problem in enumerate(map(store.problem_of_name, paths))
        if problem
    }


def image_files(
    home: store.DataFolder,
    ledger: Ledger,
    paths: Sequence[str],
    fields: Mapping[str, pa.Array],
    problems: Mapping[int, errors.ItemError] | None = None,
) -> source_touches.SourceTouches:
    """Return a touch for each path of an image; the touch of a missing file has a problem.

    Folders are listed once. An image is opened and checked when it is imported.
    """
    sizes = [0] * len(paths)
    unnamed = problems_of_names(paths)
    wrong = {**(problems or {}), **unnamed}
    for number, path in enumerate(paths):
        parent, _, base = path.rpartition("/")
        if number in unnamed:
            continue
        try:
            size = ledger.entries(home, parent).get(base, -1)
        except errors.InputError:  # the folder cannot be listed
            size = 0
        if size == -1:
            wrong[number] = errors.ItemError("missing", "the file does not exist")
        else:
            sizes[number] = size or 0  # a folder has no size; reading it gives the problem
    # A name that is not Unicode has a problem already; this makes it printable.
    shown = [path.encode(errors="backslashreplace").decode() for path in paths]
    return source_touches.SourceTouches.of(shown, home.address(), shown, fields, problems=wrong, size=sizes)


def pictures_by_file(
    read: ReadNumbers, locations: Iterable[source_touches.PictureLocation]
) -> Iterator[bytes | errors.ItemError]:
    """Yield the pictures at each location in order; consecutive ones of one file are read together.

    If ``read`` raises an ItemError, it is yielded for each remaining picture of the file.
    """
    opened = cache(store.open_folder)
    for (home, *_), group in groupby(
        locations, key=lambda picture: (picture.home, picture.path, picture.part, picture.frames > 0)
    ):
        of_file = list(group)
        numbers = [picture.start + offset for picture in of_file for offset in range(max(1, picture.frames))]
        some = list[bytes | errors.ItemError]()
        left = len(numbers)
        try:
            pictures = read(opened(home), of_file[0], numbers)
            for _ in range(0, len(numbers), _AT_ONCE):
                some = []
                some.extend(islice(pictures, _AT_ONCE))  # keeps those before an error
                left -= len(some)
                yield from some
        except errors.ItemError as error:
            yield from some
            yield from repeat(error, left - len(some))


def contents_of(locations: Iterable[source_touches.PictureLocation]) -> Iterator[bytes | errors.ItemError]:
    """Yield the bytes of each image, in order, or why it cannot be read.

    A tar is opened once for consecutive images in it.
    """
    groups = (tuple(group) for _, group in groupby(locations, key=itemgetter(0, 1)))
    first = next(groups, None)
    if first is None:
        return
    threads = 1 if store.open_folder(first[0].home).is_local else _REMOTE_READERS
    read = partial(_contents, cache(lambda home: (store.open_folder(home), set())))
    for pictures in run.in_threads(read, chain([first], groups), threads):
        yield from pictures


def _contents(
    open_folder: Callable[[str], tuple[store.DataFolder, set[str]]],
    locations: Sequence[source_touches.PictureLocation],
) -> list[bytes | errors.ItemError]:
    contents: list[bytes | errors.ItemError] = []
    try:
        folder, known = open_folder(locations[0].home)
        if len(locations) == 1 and not locations[0].start:
            return [folder.read_inside(locations[0].path, locations[0].size, known)]
        with folder.open_inside(locations[0].path, known) as stream:
            at = 0
            for picture in locations:
                if picture.start != at:
                    stream.seek(picture.start)
                content = stream.read(picture.size)
                contents.append(content)
                at = picture.start + len(content)
    except errors.ItemError as error:
        contents += [error] * (len(locations) - len(contents))
    except (OSError, errors.InputError):  # their messages differ between systems
        contents += [errors.ItemError("image", "the file cannot be read")] * (len(locations) - len(contents))
    return contents
