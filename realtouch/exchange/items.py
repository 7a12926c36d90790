"""What formats share: touches to import, where their images are and what is said of them; and stored images.

Stored images are checked, named, and encoded again only where they must be.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from realtouch.contact import median_in_memory
from realtouch.spec import ImportColumns
from tactile_toolkit.errors import InputError, IntegrityError, ItemError
from tactile_toolkit.run.threads import in_threads
from tactile_toolkit.store.folder import DataFolder, split_uri
from tactile_toolkit.store.names import is_remote, problem_of_name
from tactile_toolkit.touch.jpeg import MAX_IMAGE_BYTES, Pixels, decode_image, encode_image, image_size
from tactile_toolkit.touch.schema import MEDIA_TYPE
from tactile_toolkit.wording import did_you_mean

NUMBERED = "label"
"""The field of our own exports that numbers the classes."""

IMAGE_ENDINGS = ("jpg", "jpeg", "png", "webp")
HERE = re.compile(r"^(?:\./+)+")
"""What a path may begin with to no effect."""

# Images of a store that are asked for at a time: each answer takes long, and they are small.
_FAR_READERS = 16


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


_JPEG = b"\xff\xd8"
_JPEG_END = b"\xff\xd9"


def require_intact(data: bytes | memoryview) -> tuple[int, int]:
    """Return height and width of an image that begins and ends as an intact one does.

    The pixels of a JPEG are not decoded: that alone would take longer than all other work. Raises ValueError.
    """
    size = image_size(data)
    if data[:2] != _JPEG:
        decode_image(data)
    # Encoders of clips fill up to even lengths.
    elif bytes(data[-2:]) != _JPEG_END and not bytes(data[-16:]).rstrip(b"\0").endswith(_JPEG_END):
        raise ValueError(
            f"an image of {len(data):,} bytes without the mark of its end; expected a whole JPEG"
        )
    return size


def image_column(images: list[Any], names: list[str]) -> pa.Array:
    """Return images as a column with file names, whose endings follow from their first bytes."""
    endings = ("jpg" if each[:2] == _JPEG else "png" if each[:4] == b"\x89PNG" else "webp" for each in images)
    paths = [f"{name}.{ending}" for name, ending in zip(names, endings, strict=True)]
    parts = [pa.array(images, pa.binary()), pa.array(paths, pa.string())]
    return pa.StructArray.from_arrays(parts, fields=list(MEDIA_TYPE))


def as_jpeg(image: bytes) -> bytes:
    """Return an image for readers that know JPEG alone: as it is, or encoded again."""
    return image if image[:2] == _JPEG else encode_image(decode_image(image))


def decoded(image: bytes, name: str, out: Pixels | None = None) -> Pixels:
    """Return the pixels of an image; IntegrityError where it is damaged between its header and its end."""
    try:
        return decode_image(image, out)
    except ValueError as error:
        raise IntegrityError(
            f"{name!r}: {error}",
            next="run `realtouch verify` on the source, and leave the round out first (`realtouch select`)",
        ) from error


def background_of(images: Sequence[bytes], names: Sequence[str]) -> bytes:
    """Return the median of some images as JPEG: the gel at rest; InputError where they differ in size.

    Raises IntegrityError, with the name, for one that cannot be decoded.
    """
    sizes = {image_size(image) for image in images}
    if len(sizes) > 1:
        found = ", ".join(f"{width} x {height}" for height, width in sorted(sizes))
        raise InputError(
            f"images of {found} pixels have no common background; expected one size",
            next="make them alike with `realtouch resize`",
        )
    pixels = [decoded(image, name) for image, name in zip(images, names, strict=True)]
    return encode_image(median_in_memory(np.stack(pixels)))
