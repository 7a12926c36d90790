"""Images of others and what is said of them: a folder with a table, or the tars of a WebDataset."""

from __future__ import annotations

import csv
import io
import json
import tarfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import groupby
from pathlib import Path
from typing import Any

from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.store.names import problem_of_name
from tactile_toolkit.wording import did_you_mean

__all__ = ["LONGEST_SHOWN", "ImportColumns", "Item", "Reason", "items_of_table", "items_of_tars"]

LONGEST_SHOWN = 80
"""Letters of a value that a message repeats."""

_IMAGES = ("jpg", "jpeg", "png", "webp")
_MOST_JSON_BYTES = 1 << 20


class Reason(StrEnum):
    """Why an image is left out; stable words for tables and manifests."""

    missing = "missing"
    name = "name"
    duplicate = "duplicate"
    columns = "columns"
    json = "json"
    image = "image"
    size = "size"
    label = "label"
    object = "object"
    round = "round"
    position = "position"
    pose = "pose"


@dataclass(frozen=True, slots=True)
class ImportColumns:
    """Which columns of a table, or fields of JSON files, hold what; None: nothing does.

    Attributes
    ----------
    image : str or None
        Path of the image below the folder; of WebDataset, its ending, the first image of a sample if None.
    label : str
        Class: a whole number, or a name.
    round : str or None
        Which touches belong together; without it each is a round of its own.
    object_id : str or None
        Whole number of the touched object.
    position : tuple of str
        x and y of the intended position, metres, cell frame; or one field that holds both.
    pose : tuple of str
        Position and quaternion (x, y, z, w) of the gel, metres, cell frame: seven, or one field with all.
    split : str or None
        Split of each touch.
    """

    image: str | None = "file"
    label: str = "label"
    round: str | None = None
    object_id: str | None = None
    position: tuple[str, ...] = ()
    pose: tuple[str, ...] = ()
    split: str | None = None

    def __post_init__(self) -> None:
        for what, names, count in (("position", self.position, 2), ("pose", self.pose, 7)):
            if len(names) not in (0, 1, count):
                message = (
                    f"{len(names)} {what} columns ({', '.join(names)}); expected {count}, or one that holds "
                    f"a list of {count}"
                )
                raise InputError(message)

    def names(self) -> list[str]:
        """Return the columns that must be there."""
        plain = (self.label, self.round, self.object_id, self.split, *self.position, *self.pose)
        return list(dict.fromkeys(name for name in plain if name is not None))


@dataclass(frozen=True, slots=True)
class Item:
    """A touch to import: where its image lies, what is said of it, and why it cannot be used, if so."""

    number: int
    name: str
    path: str
    start: int
    size: int
    values: Mapping[str, Any] = field(repr=False)
    problem: tuple[Reason, str] | None = None

    def read(self) -> bytes:
        """Return the bytes of the image."""
        with Path(self.path).open("rb") as stream:
            stream.seek(self.start)
            return stream.read(self.size)


def items_of_table(home: Path, columns: ImportColumns, table: str | None) -> Iterator[Item]:
    """Yield a touch for each line of the table; of a file that cannot be found, why."""
    if columns.image is None:
        message = "no column names the images; next: add --image-column NAME"
        raise InputError(message)
    path = _table_path(home, table)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        message = f"{str(path)!r} cannot be read as UTF-8 text ({error}); expected a table with commas"
        raise InputError(message) from error
    lines = csv.DictReader(io.StringIO(text, newline=""), strict=True)
    seen: dict[str, int] = {}
    try:
        _require_columns(list(lines.fieldnames or ()), [columns.image, *columns.names()], str(path))
        for number, values in enumerate(lines):
            name = str(values[columns.image] or "")
            yield _file_item(home, number, name, values, seen)
    except csv.Error as error:
        # Of a line that was not read it counts none; a quote that never ends reaches over all that follow.
        message = f"{str(path)!r}, line {lines.line_num + 1}: {error}; expected a table with commas"
        raise InputError(message) from error


def _table_path(home: Path, table: str | None) -> Path:
    if table is not None:
        path = home / table
        if not path.is_file():
            message = f"there is no table {table!r} in {str(home)!r}"
            raise InputError(message)
        return path
    found = sorted(home.glob("*.csv")) if home.is_dir() else []
    if len(found) != 1:
        names = ", ".join(path.name for path in found) or "none"
        message = f"{str(home)!r} should hold one CSV file; found {names}; next: name it with --table"
        raise InputError(message)
    return found[0]


def _file_item(home: Path, number: int, name: str, values: Mapping[str, Any], seen: dict[str, int]) -> Item:
    path, size = home / name, 0
    problem: tuple[Reason, str] | None = None
    words = problem_of_name(name)
    if words:
        problem = (Reason.name, f"the name {words}; expected a path below the folder")
    elif not _is_below(path, home):
        problem = (Reason.name, "a link leads out of the folder; expected a path below it")
    elif not path.is_file():
        problem = (Reason.missing, "there is no such file")
    elif seen.setdefault(name, number) != number:
        problem = (Reason.duplicate, f"the same file as in row {seen[name]} of the table")
    else:
        size = path.stat().st_size
    if None in values:
        problem = problem or (Reason.columns, "the line has more values than the table has columns")
    return Item(number, name, str(path), 0, size, dict(values), problem)


def _is_below(path: Path, home: Path) -> bool:
    """Tell whether a path stays in a folder, links followed; one in a circle does not."""
    try:
        return path.resolve().is_relative_to(home.resolve())
    except (OSError, RuntimeError):
        return False


def _require_columns(known: Sequence[str], wanted: Iterable[str], where: str) -> None:
    for name in wanted:
        if name not in known:
            message = (
                f"{where!r} has no column {name!r}{did_you_mean(name, known)}; found "
                f"{', '.join(known) or 'none'}; next: name the columns with the options of `realtouch import`"
            )
            raise InputError(message)
        if known.count(name) > 1:
            message = (
                f"{where!r} has {known.count(name)} columns {name!r}; expected one; next: name them apart"
            )
            raise InputError(message)


def items_of_tars(home: Path, columns: ImportColumns, table: str | None) -> Iterator[Item]:
    """Yield a touch for each sample of the tars, by their headers and JSON files alone."""
    if table is not None:
        message = "--table is about folders of images; a WebDataset has JSON files"
        raise InputError(message)
    paths = sorted(home.glob("*.tar")) if home.is_dir() else [home]
    if not paths:
        message = f"{str(home)!r} holds no tars (*.tar); compressed ones are unpacked first"
        raise InputError(message)
    number, seen, known = 0, set[str](), dict[str, None]()
    for path in paths:
        for key, members in groupby(_members(path), key=lambda each: each[0]):
            item = _sample(path, number, key, list(members), columns)
            if key in seen:
                item = replace(
                    item, problem=(Reason.duplicate, f"the key {key!r} stands in an earlier sample")
                )
            seen.add(key)
            known |= dict.fromkeys(item.values)
            number += 1
            yield item
    if number:
        _require_columns(list(known), columns.names(), str(home))


def _members(path: Path) -> Iterator[tuple[str, str, int, int, bytes]]:
    """Yield key, ending, place and size of each file of a tar, and the content where it is small text."""
    try:
        size = path.stat().st_size
        with path.open("rb") as stream, tarfile.open(fileobj=stream, mode="r:") as tar:
            for member in tar:
                if not member.isfile():
                    continue
                start = member.offset_data
                if start + member.size > size:
                    problem = f"it ends in {member.name!r}"
                    raise EOFError(problem)
                directory, _, base = member.name.rpartition("/")
                stem, _, ending = base.partition(".")
                key = f"{directory}/{stem}" if directory else stem
                content = b""
                if ending.lower() not in _IMAGES and member.size <= _MOST_JSON_BYTES:
                    stream.seek(start)
                    content = stream.read(member.size)
                yield key, ending.lower(), start, member.size, content
            stream.seek(max(0, size - tarfile.BLOCKSIZE))
            if stream.read().strip(b"\0"):
                problem = "the mark of its end is missing"
                raise EOFError(problem)
    except (tarfile.TarError, EOFError, OSError) as error:
        message = f"{str(path)!r} is no whole tar ({error}); nothing was written; next: fetch it again"
        raise IntegrityError(message) from error


def _sample(
    path: Path,
    number: int,
    key: str,
    members: Sequence[tuple[str, str, int, int, bytes]],
    columns: ImportColumns,
) -> Item:
    """Put the files of one key together."""
    values: dict[str, Any] = {}
    problem: tuple[Reason, str] | None = None
    images = []
    for _, ending, start, size, content in members:
        if ending in _IMAGES:
            if columns.image in (None, "file", ending):
                images.append((start, size))
        elif ending == "json":
            try:
                values |= dict(json.loads(content))
            except (ValueError, TypeError, RecursionError) as error:
                problem = (Reason.json, f"its JSON file cannot be read ({error}); expected an object")
        elif size <= _MOST_JSON_BYTES:
            values.setdefault(ending, content.decode(errors="replace").strip())
    if not images:
        problem = (Reason.missing, f"no image; expected one of {', '.join(_IMAGES)}")
    start, size = images[0] if images else (0, 0)
    if problem_of_name(key):
        problem = (Reason.name, f"the key {problem_of_name(key)}")
    return Item(number, key, str(path), start, size, values, problem)
