"""WebDataset as touches: an image and the files of the same key in a tar; images are not read."""

from __future__ import annotations

import json
import tarfile
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from functools import lru_cache, partial
from itertools import groupby
from operator import attrgetter
from typing import NamedTuple

import msgspec
import pyarrow as pa

from realtouch import importing, tars
from tactile_toolkit import errors, store
from tactile_toolkit.columns import column_types
from tactile_toolkit.json_types import JsonDict, JsonObject

# First bytes of files of gzip, bzip2, xz and Zstandard.
_COMPRESSED = (b"\x1f\x8b", b"BZh", b"\xfd7zX", b"\x28\xb5\x2f\xfd")
_MAX_FIELDS = 1000
_MAX_TEXT_BYTES = 1 << 20  # longer files with fields are not read


def find_webdataset(
    home: store.DataFolder, columns: importing.ImportColumns, table: str | None
) -> Iterator[importing.FoundTouches]:
    """Yield the samples of each tar as touches; only headers and short texts are read."""
    if table is not None:
        raise errors.InputError(
            "--table applies to folders of images; a WebDataset has JSON files", next="leave out --table"
        )
    known = dict[str, None]()
    folder, names = importing.files_to_read(
        home, "tars (*.tar)", partial(importing.visible_files, endings=".tar")
    )
    for name in names:
        with store.without_collecting():
            groups = groupby(_members(folder, name), key=attrgetter("key"))
            samples = [_sample(key, list(members), columns) for key, members in groups]
        if samples:
            yield _touches(folder, name, samples)
            known |= dict.fromkeys(field for sample in samples for field in sample.values)
    if known:
        importing.require_columns(list(known), columns.found_in(known).names(), home.address())


def _touches(folder: store.DataFolder, name: str, samples: Sequence[_Sample]) -> importing.FoundTouches:
    """Return the samples of a tar; of samples with the same key, only the first can be used."""
    problems = {number: sample.problems[0] for number, sample in enumerate(samples) if sample.problems}
    problems |= importing.duplicates_of([sample.key for sample in samples], "key as in sample {} of this tar")
    names = dict.fromkeys(field for sample in samples for field in sample.values)
    if len(names) > _MAX_FIELDS:
        raise errors.InputError(
            f"{folder.address(name)!r} has {len(names):,} different fields; the limit is {_MAX_FIELDS:,}",
            next="check that no names of fields are values",
        )
    said = {}
    for field in names:
        column = column_types.from_values([sample.values.get(field) for sample in samples])
        if pa.types.is_string(column.type) and any(field in sample.endings for sample in samples):
            column = column_types.from_text(column)
        said[field.encode(errors="backslashreplace").decode()] = column
    return importing.FoundTouches.of(
        [sample.key for sample in samples],
        folder.address(),
        name,
        said,
        problems=problems,
        start=[sample.image.start for sample in samples],
        size=[sample.image.size for sample in samples],
    )


class _Member(NamedTuple):
    """A file in a tar: its sample, ending, position and size, and its content if it is short text."""

    key: str
    ending: str
    start: int
    size: int
    content: bytes


_NO_FILE = _Member("", "", 0, 0, b"")


def _members(folder: store.DataFolder, name: str) -> Iterator[_Member]:
    try:
        with importing.open_source(folder, name) as stream:
            if stream.read(4).startswith(_COMPRESSED):
                raise errors.InputError(
                    f"{folder.address(name)!r} is compressed; expected a tar", next="unpack it"
                )
            stream.seek(0)
            for member in tars.files_of_tar(stream, folder.size_bytes(name)):
                start, path = member.offset_data, importing.path_of(member.name)
                if store.is_hidden(path):  # macOS adds such a file to archives for each file
                    continue
                directory, slash, base = path.rpartition("/")
                stem, _, ending = base.partition(".")
                content = b""
                if not _is_image(ending) and member.size <= _MAX_TEXT_BYTES:
                    stream.seek(start)
                    content = stream.read(member.size)
                yield _Member(f"{directory}{slash}{stem}", ending.lower(), start, member.size, content)
    except (tarfile.TarError, OSError) as error:
        raise errors.IntegrityError(
            f"{folder.address(name)!r} is not an intact tar ({error}); nothing was written",
            next="fetch it again",
        ) from error


@lru_cache(maxsize=256)
def _is_image(ending: str) -> bool:
    """Return whether an ending is that of an image; the ending may have several parts, as ``rgb.jpg``."""
    return ending.lower().rpartition(".")[2] in importing.IMAGE_ENDINGS


class _Sample(NamedTuple):
    """The files of one key: the image, its fields, the endings of all files, and the problems."""

    key: str
    image: _Member
    values: JsonObject
    endings: Collection[str]
    problems: Sequence[errors.ItemError]


def _sample(key: str, members: Sequence[_Member], columns: importing.ImportColumns) -> _Sample:
    """Combine the files of one key."""
    problems: list[errors.ItemError] = []
    named = store.problem_of_name(key)
    if named:
        problems.append(errors.ItemError("name", f"the key {named}"))
        key = key.encode(errors="backslashreplace").decode()
    wanted = columns.image_name.lower()
    images = [each for each in members if _is_image(each.ending) and wanted in ("", each.ending)]
    if not images:
        expected = wanted or ", ".join(importing.IMAGE_ENDINGS)
        problems.append(errors.ItemError("missing", f"no image; expected one of {expected}"))
    if len(images) > 1:
        found = ", ".join(each.ending for each in images)
        problems.append(
            errors.ItemError("images", f"the images {found}; expected one (--map image=ENDING names it)")
        )
    values: JsonDict = {}
    for member in members:
        if member.ending == "json":
            try:
                values |= _fields(member.content)
            except errors.ItemError as error:
                problems.append(error)
        elif not _is_image(member.ending):
            values.setdefault(member.ending, member.content.decode(errors="surrogateescape").strip())
    # JSON may hold one half of a surrogate pair, which cannot be stored.
    texts = {name: value for name, value in values.items() if isinstance(value, str)}
    if not "".join(texts.values()).isascii():  # a fast test first, as this runs for each image
        wrong = [name for name, text in texts.items() if text.encode(errors="ignore").decode() != text]
        for name in wrong:
            problems.append(errors.ItemError("json", f"its field {name!r} holds text that is not Unicode"))
            values = {}
    endings = {member.ending for member in members}
    return _Sample(key, next(iter(images), _NO_FILE), values, endings, problems)


def _fields(content: bytes) -> JsonDict:
    try:
        # msgspec is five times as fast; `json` also reads NaN, numbers out of range and byte order marks.
        with suppress(msgspec.MsgspecError, UnicodeDecodeError):
            return dict(msgspec.json.decode(content))
        return dict(json.loads(content))
    except (ValueError, TypeError, RecursionError) as error:
        raise errors.ItemError(
            "json", "its JSON file cannot be read; expected an object of at most 1 MiB"
        ) from error
