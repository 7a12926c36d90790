"""What formats of others give to be imported: for each touch where its image is, and what is said of it."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path
from typing import Any

from realtouch.spec import ImportColumns
from tactile_toolkit.errors import InputError, IntegrityError, ItemError
from tactile_toolkit.run.threads import in_threads
from tactile_toolkit.store.folder import DataFolder, split_uri
from tactile_toolkit.store.names import is_remote, problem_of_name
from tactile_toolkit.touch.jpeg import MAX_IMAGE_BYTES
from tactile_toolkit.wording import did_you_mean

NUMBERED = "label"
"""The field of our own exports that numbers the classes."""

IMAGE_ENDINGS = ("jpg", "jpeg", "png", "webp")
HERE = re.compile(r"^(?:\./+)+")
"""What a path may begin with to no effect."""

_FAR_READERS = 16
"""Images of a store that are asked for at a time: each answer takes long, and they are small."""


@dataclass(frozen=True, slots=True)
class Item:
    """A touch to import: where its image is, its fields, and why it cannot be used, if so.

    ``fields`` names all fields of the source that have a value.
    """

    name: str
    path: str
    start: int
    size: int
    values: Mapping[str, Any] = field(repr=False)
    problem: ItemError | None = None
    number: int = 0
    fields: tuple[str, ...] = field(default=(), repr=False)

    def used(self, number: int, columns: ImportColumns) -> Item:
        """Return the item with its number among all, the names of its fields, and the values in use."""
        fields = tuple(name for name, value in self.values.items() if name and value not in (None, ""))
        wanted = {*columns.found_in(fields).names(), *([] if columns.label else [NUMBERED])}
        values = {name: self.values[name] for name in self.values if name in wanted}
        problem = self.problem
        for name, value in values.items():
            # JSON may hold one half of a surrogate pair without the other, which cannot be stored.
            if isinstance(value, str) and value.encode(errors="ignore").decode() != value:
                problem = problem or ItemError("json", f"its field {name!r} holds text that is not Unicode")
                values = {}
                break
        if problem is None and self.size > MAX_IMAGE_BYTES:
            problem = ItemError("image", f"{self.size:,} bytes; the limit is {MAX_IMAGE_BYTES:,}")
        return replace(self, number=number, values=values, problem=problem, fields=fields)


def contents_of(items: Iterable[Item]) -> Iterator[bytes | Exception]:
    """Yield the bytes of each image, in order, or why it cannot be read.

    A tar is opened once for all that follow each other in it.
    """
    groups = [tuple(group) for _, group in groupby(items, key=lambda item: item.path)]
    threads = _FAR_READERS if groups and is_remote(groups[0][0].path) else 1
    for found in in_threads(_contents, groups, threads):
        yield from found


def _contents(items: Sequence[Item]) -> list[bytes | Exception]:
    folder, name = split_uri(items[0].path)
    found: list[bytes | Exception] = []
    try:
        with folder.open(name) as stream:
            for item in items:
                stream.seek(item.start)
                found.append(stream.read(item.size))
    except (OSError, InputError) as error:
        return [*found, *[error] * (len(items) - len(found))]
    return found


def read_table(home: DataFolder, name: str) -> tuple[list[str], list[dict[str, Any]]]:
    """Return the columns and lines of a table; InputError where it cannot be read."""
    path = home.address(name)
    try:
        text = home.read_bytes(name).decode("utf-8-sig")
    except (IntegrityError, UnicodeDecodeError) as error:
        raise InputError(
            f"{path!r} cannot be read as UTF-8 text ({error}); expected a table with commas"
        ) from error
    lines = csv.DictReader(io.StringIO(text, newline=""), strict=True)
    try:
        return list(lines.fieldnames or ()), list(lines)
    except csv.Error as error:
        # Of a line that was not read it counts none; a quote that never ends reaches over all that follow.
        raise InputError(
            f"{path!r}, line {lines.line_num + 1}: {error}; expected a table with commas"
        ) from error


def require_columns(known: Sequence[str], wanted: Iterable[str], where: str) -> None:
    """Refuse columns that are not there, or there several times (InputError)."""
    for name in wanted:
        count = known.count(name)
        if count != 1:
            meant = did_you_mean(name, known)
            found = f"{count} columns {name!r}; expected one" if count else f"no column {name!r}{meant}"
            raise InputError(
                f"{where!r} has {found}; found {', '.join(known) or 'none'}",
                next="name the columns with the options of `realtouch import`",
            )


def size_below(home: DataFolder, name: str, sizes: Callable[[str], Mapping[str, int]]) -> int:
    """Return the size of a file below a folder; ItemError where there is none, or its name leads elsewhere.

    ``sizes`` lists a folder of a store, such as ``functools.cache(home.sizes)``.
    """
    words = problem_of_name(name)
    if words:
        raise ItemError("name", f"the name {words}; expected a path below the folder")
    if not home.is_local:
        folder, _, base = name.rpartition("/")
        size = sizes(folder).get(base)
    else:
        path = Path(home.address(name))
        try:
            is_below = path.resolve().is_relative_to(Path(home.address()).resolve())
        except (OSError, RuntimeError):  # links in a circle
            is_below = False
        if not is_below:
            raise ItemError("name", "a link leads out of the folder; expected a path below it")
        size = path.stat().st_size if path.is_file() else None
    if size is None:
        raise ItemError("missing", "the file does not exist")
    return size
