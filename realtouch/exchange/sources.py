"""Images of others and what is said of them: a folder with a table, or the tars of a WebDataset."""

from __future__ import annotations

import csv
import io
import json
import re
import tarfile
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import Any

from realtouch.exchange.flat import POSE_COLUMNS, POSITION_COLUMNS
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.run.threads import in_threads
from tactile_toolkit.store.address import is_remote
from tactile_toolkit.store.folder import DataFolder, file_at
from tactile_toolkit.store.names import problem_of_name
from tactile_toolkit.touch.jpeg import MAX_IMAGE_BYTES
from tactile_toolkit.touch.tars import files_of_tar
from tactile_toolkit.wording import did_you_mean

__all__ = [
    "LONGEST_SHOWN",
    "ImportColumns",
    "Item",
    "Reason",
    "contents_of",
    "items_of_table",
    "items_of_tars",
]

LONGEST_SHOWN = 80
"""Letters of a value that a message repeats."""

_IMAGES = ("jpg", "jpeg", "png", "webp")
_MOST_JSON_BYTES = 1 << 20
_MOST_COLUMNS = 1_000
_MOST_UNUSABLE = 100_000
"""Lines of a table that name no image: of a few bytes each, they would take gigabytes to list."""
_FAR_READERS = 16
"""Images of a store that are asked for at a time: each answer takes long, and they are small."""

_HERE = re.compile(r"^(?:\./+)+")


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
    """Which columns of a table, or fields of JSON files, hold what.

    What is not named is read from the columns that :func:`realtouch.export` and :func:`realtouch.frames`
    write, where the source has them: ``label_name`` or ``label``, ``round_id``, ``object_id``, ``split``,
    ``pos_in_cell_x_m`` and ``_y_m``, ``gel_x_m`` to ``gel_qw``. An empty text or tuple stands for no column.

    Attributes
    ----------
    image : str or None
        Path of the image below the folder; of WebDataset, its ending, the first image of a sample if None.
    label : str or None
        Class: a number, or a name.
    round : str or None
        Which touches belong together; without it each is a round of its own.
    object_id : str or None
        Whole number of the touched object.
    position : tuple of str or None
        x and y of the intended position, metres, cell frame; or one field that holds both.
    pose : tuple of str or None
        Position and quaternion (x, y, z, w) of the gel, metres, cell frame: seven, or one field with all.
    split : str or None
        Split of each touch.
    """

    image: str | None = "file"
    label: str | None = None
    round: str | None = None
    object_id: str | None = None
    position: tuple[str, ...] | None = None
    pose: tuple[str, ...] | None = None
    split: str | None = None

    def __post_init__(self) -> None:
        for what, chosen, count in (("position", self.position, 2), ("pose", self.pose, 7)):
            names = chosen or ()
            if len(names) not in (0, 1, count):
                message = (
                    f"{len(names)} {what} columns ({', '.join(names)}); expected {count}, or one that holds "
                    f"a list of {count}"
                )
                raise InputError(message)

    def found_in(self, known: Collection[str]) -> ImportColumns:
        """Return these columns and, where none was named, those of our own exports among the known ones."""

        def ours(chosen: Any, *names: str) -> Any:
            found = (names if names[1:] else names[0]) if {*names} <= {*known} else None
            return found if chosen is None else chosen

        return replace(
            self,
            label=ours(self.label, "label_name") or "label",
            round=ours(self.round, "round_id"),
            object_id=ours(self.object_id, "object_id"),
            position=ours(self.position, *POSITION_COLUMNS),
            pose=ours(self.pose, *POSE_COLUMNS),
            split=ours(self.split, "split"),
        )

    def names(self) -> list[str]:
        """Return the columns that must be there."""
        plain = (self.label, self.round, self.object_id, self.split)
        names = (*plain, *(self.position or ()), *(self.pose or ()))
        return list(dict.fromkeys(filter(None, names)))


@dataclass(frozen=True, slots=True)
class Item:
    """A touch to import: where its image is, its fields, and why it cannot be used, if so.

    ``fields`` names all fields of the source that have a value.
    """

    number: int
    name: str
    path: str
    start: int
    size: int
    values: Mapping[str, Any] = field(repr=False)
    problem: tuple[Reason, str] | None = None
    fields: tuple[str, ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        if self.problem is None and self.size > MAX_IMAGE_BYTES:
            problem = (Reason.image, f"{self.size:,} bytes; the limit is {MAX_IMAGE_BYTES:,}")
            object.__setattr__(self, "problem", problem)


def contents_of(items: Iterable[Item]) -> Iterator[bytes | Exception]:
    """Yield the bytes of each image without a problem, in order, or why it cannot be read.

    A tar is opened once for all that follow each other in it.
    """
    usable = (item for item in items if item.problem is None)
    groups = [tuple(group) for _, group in groupby(usable, key=lambda item: item.path)]
    threads = _FAR_READERS if groups and is_remote(groups[0][0].path) else 1
    for found in in_threads(_contents, groups, threads):
        yield from found


def _contents(items: Sequence[Item]) -> list[bytes | Exception]:
    folder, name = file_at(items[0].path)
    found: list[bytes | Exception] = []
    try:
        with folder.open(name) as stream:
            for item in items:
                stream.seek(item.start)
                found.append(stream.read(item.size))
    except (OSError, InputError) as error:
        return [*found, *[error] * (len(items) - len(found))]
    return found


def items_of_table(home: DataFolder, columns: ImportColumns, table: str | None) -> Iterator[Item]:
    """Yield a touch for each line of the table; of a file that cannot be found, why."""
    if columns.image is None:
        message = "no column names the images; next: add --image-column NAME"
        raise InputError(message)
    found = _table_name(home, table)
    path = home.address(found)
    try:
        text = home.read_bytes(found).decode("utf-8-sig")
    except (IntegrityError, UnicodeDecodeError) as error:
        message = f"{path!r} cannot be read as UTF-8 text ({error}); expected a table with commas"
        raise InputError(message) from error
    lines = csv.DictReader(io.StringIO(text, newline=""), strict=True)
    seen: dict[str, int] = {}
    sizes = cache(home.sizes)  # of a store, one look at each folder
    try:
        names = list(lines.fieldnames or ())
        if len(names) > _MOST_COLUMNS:
            message = f"{path!r} has {len(names):,} columns; expected at most {_MOST_COLUMNS:,}"
            raise InputError(message)
        _require_columns(names, [columns.image, *columns.found_in(names).names()], path)
        unusable = 0
        for number, values in enumerate(lines):
            name = _HERE.sub("", str(values[columns.image] or ""))
            item = _file_item(home, sizes, number, name, values, seen)
            unusable += item.problem is not None
            if item.problem is not None and unusable > max(_MOST_UNUSABLE, number // 2):
                message = (
                    f"{path!r}: {unusable:,} of the first {number + 1:,} lines cannot be used, the last as "
                    f"{item.problem[1]}; expected a line for each image; next: check --image-column"
                )
                raise InputError(message)
            yield item
    except csv.Error as error:
        # Of a line that was not read it counts none; a quote that never ends reaches over all that follow.
        message = f"{path!r}, line {lines.line_num + 1}: {error}; expected a table with commas"
        raise InputError(message) from error


def _table_name(home: DataFolder, table: str | None) -> str:
    if table is not None:
        if problem_of_name(table) or not home.exists(table):
            message = f"there is no table {table!r} in {home.address()!r}"
            raise InputError(message)
        return table
    found = [name for name in home.sizes() if name.endswith(".csv") and not name.startswith(".")]
    if len(found) != 1:
        message = (
            f"{home.address()!r} should be a folder with one CSV file; found {', '.join(found) or 'none'}; "
            "next: name it with --table"
        )
        raise InputError(message)
    return found[0]


def _file_item(
    home: DataFolder,
    sizes: Callable[[str], Mapping[str, int]],
    number: int,
    name: str,
    values: Mapping[str, Any],
    seen: dict[str, int],
) -> Item:
    problem: tuple[Reason, str] | None = None
    size: int | None = None
    words = problem_of_name(name)
    if words:
        problem = (Reason.name, f"the name {words}; expected a path below the folder")
    elif home.is_local and not _is_below(Path(home.address(name)), Path(home.address())):
        problem = (Reason.name, "a link leads out of the folder; expected a path below it")
    else:
        size = _size_bytes(home, sizes, name)
        if size is None:
            problem = (Reason.missing, "there is no such file")
        elif seen.setdefault(name, number) != number:
            problem = (Reason.duplicate, f"the same file as in row {seen[name]} of the table")
    if None in values:
        problem = problem or (Reason.columns, "the line has more values than the table has columns")
    return Item(number, name, f"{home.address()}/{name}", 0, size or 0, dict(values), problem)


def _size_bytes(home: DataFolder, sizes: Callable[[str], Mapping[str, int]], name: str) -> int | None:
    """Return the size of a file; None where there is none."""
    if home.is_local:
        path = Path(home.address(name))
        return path.stat().st_size if path.is_file() else None
    folder, _, base = name.rpartition("/")
    return sizes(folder).get(base)


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


def items_of_tars(home: DataFolder, columns: ImportColumns, table: str | None) -> Iterator[Item]:
    """Yield a touch for each sample of the tars, by their headers and JSON files alone."""
    if table is not None:
        message = "--table is about folders of images; a WebDataset has JSON files"
        raise InputError(message)
    number, seen, known = 0, set[str](), dict[str, None]()
    for folder, name in _tars(home):
        for key, members in groupby(_members(folder, name), key=lambda each: each[0]):
            item = _sample(folder.address(name), number, key, list(members), columns)
            if key in seen:
                item = replace(
                    item, problem=(Reason.duplicate, f"the key {key!r} stands in an earlier sample")
                )
            seen.add(key)
            known |= dict.fromkeys(item.values)
            number += 1
            yield item
    if number:
        _require_columns(list(known), columns.found_in(known).names(), home.address())


def _tars(home: DataFolder) -> list[tuple[DataFolder, str]]:
    """Return the tars of a folder, or the one that was named itself, each with its folder."""
    names = [name for name in home.sizes() if name.endswith(".tar") and not name.startswith(".")]
    if names:
        return [(home, name) for name in names]
    place = home.address()
    if Path(place).is_file() if home.is_local else place.endswith(".tar"):
        return [file_at(place)]
    message = f"{place!r} holds no tars (*.tar); compressed ones are unpacked first"
    raise InputError(message)


def _members(folder: DataFolder, name: str) -> Iterator[tuple[str, str, int, int, bytes]]:
    """Yield key, ending, place and size of each file of a tar, and the content where it is small text."""
    try:
        with folder.open(name) as stream:
            for member in files_of_tar(stream, folder.size_bytes(name)):
                start = member.offset_data
                directory, _, base = _HERE.sub("", member.name).rpartition("/")
                stem, _, ending = base.partition(".")
                key = f"{directory}/{stem}" if directory else stem
                content = b""
                if not _is_image(ending) and member.size <= _MOST_JSON_BYTES:
                    stream.seek(start)
                    content = stream.read(member.size)
                yield key, ending.lower(), start, member.size, content
    except (tarfile.TarError, OSError) as error:
        message = (
            f"{folder.address(name)!r} is not an intact tar ({error}); nothing was written; next: fetch it "
            "again"
        )
        raise IntegrityError(message) from error


def _is_image(ending: str) -> bool:
    """Tell images by their endings, of which there may be several: ``rgb.jpg``."""
    return ending.lower().rpartition(".")[2] in _IMAGES


def _sample(
    path: str,
    number: int,
    key: str,
    members: Sequence[tuple[str, str, int, int, bytes]],
    columns: ImportColumns,
) -> Item:
    """Put the files of one key together."""
    values: dict[str, Any] = {}
    problem: tuple[Reason, str] | None = None
    images = []
    wanted = None if columns.image in (None, "file") else str(columns.image).lower()
    for _, ending, start, size, content in members:
        if _is_image(ending):
            if wanted in (None, ending):
                images.append((start, size))
        elif ending == "json" and size > _MOST_JSON_BYTES:
            problem = (Reason.json, f"its JSON file has {size:,} bytes; the limit is {_MOST_JSON_BYTES:,}")
        elif ending == "json":
            try:
                values |= dict(json.loads(content))
            except (ValueError, TypeError, RecursionError) as error:
                problem = (Reason.json, f"its JSON file cannot be read ({error}); expected an object")
        elif size <= _MOST_JSON_BYTES:
            values.setdefault(ending, content.decode(errors="replace").strip())
    if not images:
        problem = (Reason.missing, f"no image; expected one of {wanted or ', '.join(_IMAGES)}")
    start, size = images[0] if images else (0, 0)
    if problem_of_name(key):
        problem = (Reason.name, f"the key {problem_of_name(key)}")
    return Item(number, key, path, start, size, values, problem)
