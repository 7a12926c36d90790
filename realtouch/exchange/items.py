"""What formats share: touches to import, where their images are and what is said of them; and stored images.

Stored images are checked, named, and encoded again only where they must be.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import IO, Any

import numpy as np
import pyarrow as pa

from realtouch.contact import median_in_memory
from realtouch.exchange.fields import NUMBERED
from realtouch.spec import ImportColumns
from tactile_toolkit import run, store
from tactile_toolkit.array_types import UInt8
from tactile_toolkit.errors import InputError, IntegrityError, ItemError
from tactile_toolkit.text_tables import table_lines
from tactile_toolkit.touch import MAX_IMAGE_BYTES, MEDIA_TYPE, decode_image, encode_image, image_size
from tactile_toolkit.wording import did_you_mean

IMAGE_ENDINGS = ("jpg", "jpeg", "png", "webp")
_HERE = re.compile(r"^(?:\./+)+")

# Images of a store that are asked for at a time: each answer takes long, and they are small.
_FAR_READERS = 16
# Images that are looked at for the size of all, where they agree.
_SIZES_SEEN = 32


@dataclass(frozen=True, slots=True)
class Item:
    """A touch to import: where its image is, its fields, and why it cannot be used, if so.

    ``path`` is below ``home``, the address of the source; of a group of arrays, ``part`` names what is meant.
    ``fields`` names all fields of the source that have a value.
    """

    name: str
    home: str
    path: str
    start: int
    size: int
    values: Mapping[str, Any] = field(repr=False)
    problem: ItemError | None = None
    number: int = 0
    fields: tuple[str, ...] = field(default=(), repr=False)
    part: str = ""

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


ReadContents = Callable[[Iterable[Item]], Iterator[bytes | ItemError]]
"""Yields the bytes of the image of each item, in order, or why it cannot be read."""


def common_size(items: Sequence[Item], read: ReadContents) -> tuple[int, int] | None:
    """Return height and width of most images, the first of equals; None where none can be read.

    All are looked at only where some, spread over all, differ: to read each twice takes long.
    """
    usable = [item for item in items if item.problem is None]
    # The pictures of one array are of one size.
    few = usable[:: max(1, len(usable) // _SIZES_SEEN)] if read is contents_of else usable[:1]
    sizes = _sizes(few, read)
    if len(sizes) > 1 or not sizes:
        sizes = _sizes(usable, read)
    return sizes.most_common(1)[0][0] if sizes else None


def _sizes(items: Iterable[Item], read: ReadContents) -> Counter[tuple[int, int]]:
    """Count the sizes of images; those that are not intact do not count."""
    sizes = Counter[tuple[int, int]]()
    for content in read(items):
        if isinstance(content, bytes):
            with suppress(ValueError):
                sizes[require_intact(content)] += 1
    return sizes


def contents_of(items: Iterable[Item]) -> Iterator[bytes | ItemError]:
    """Yield the bytes of each image, in order, or why it cannot be read.

    A tar is opened once for all that follow each other in it.
    """
    groups = [tuple(group) for _, group in groupby(items, key=lambda item: (item.home, item.path))]
    threads = _FAR_READERS if groups and store.is_remote(groups[0][0].home) else 1
    for found in run.in_threads(_contents, groups, threads):
        yield from found


def _contents(items: Sequence[Item]) -> list[bytes | ItemError]:
    found: list[bytes | ItemError] = []
    try:
        with store.open_inside(store.open_folder(items[0].home), items[0].path) as stream:
            for item in items:
                stream.seek(item.start)
                found.append(stream.read(item.size))
    except ItemError as error:
        return [*found, *[error] * (len(items) - len(found))]
    except (OSError, InputError):  # what they say differs between systems
        unreadable = ItemError("image", "the file cannot be read")
        return [*found, *[unreadable] * (len(items) - len(found))]
    return found


def path_of(text: str) -> str:
    """Return the path that a table or tar names, with slashes: programs of Windows write backslashes."""
    return _HERE.sub("", text.strip().replace("\\", "/"))


def source_of(place: str) -> tuple[store.DataFolder, str]:
    """Return the folder of a file that the user named, and its name there; it may be a link itself."""
    return store.split_uri(place if store.is_remote(place) else os.path.realpath(place))


def open_source(folder: store.DataFolder, name: str) -> IO[bytes]:
    """Open a file of a source that holds many touches or what is known of them; InputError names it."""
    try:
        return store.open_inside(folder, name)
    except ItemError as error:
        raise InputError(f"{folder.address(name)!r} cannot be read: {error.what}") from error


def read_table(folder: store.DataFolder, name: str) -> tuple[list[str], list[dict[str, Any]]]:
    """Return the columns and lines of a table; InputError where it cannot be read."""
    with open_source(folder, name) as stream:
        content = stream.read()
    return table_lines(content, folder.address(name))


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


_JPEG = b"\xff\xd8"
_JPEG_END = b"\xff\xd9"


def require_intact(data: bytes | memoryview) -> tuple[int, int]:
    """Return height and width of an image that begins and ends as an intact one does.

    The pixels of a JPEG are not decoded, which would take longer than all other work, unless bytes follow the
    mark of its end: cameras send whole buffers, and encoders of clips fill up to even lengths. Raises
    ValueError.
    """
    size = image_size(data)
    if data[:2] != _JPEG:
        decode_image(data)
    elif bytes(data[-2:]) != _JPEG_END and not bytes(data[-16:]).rstrip(b"\0").endswith(_JPEG_END):
        try:
            decode_image(data)
        except ValueError as error:
            raise ValueError(
                f"an image of {len(data):,} bytes without the mark of its end; expected a whole JPEG"
            ) from error
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


def decoded(image: bytes, name: str, out: UInt8 | None = None) -> UInt8:
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
