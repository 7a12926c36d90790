"""WebDataset: tars in which each touch is an image and a JSON file of one name, read by their headers."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import pyarrow as pa

from realtouch.convert.conversion import Made
from realtouch.convert.index_tables import with_files
from realtouch.exchange.flat import IMAGE, plan as plan_rows
from realtouch.exchange.found_touches import (
    IMAGE_ENDINGS,
    FoundTouch,
    open_source,
    path_of,
    require_columns,
    source_of,
)
from realtouch.tars import files_of_tar
from realtouch.touch_options import ImportColumns
from tactile_toolkit import store
from tactile_toolkit.errors import InputError, IntegrityError, ItemError

_FOLDER = "webdataset"
_MOST_TEXT_BYTES = 1 << 20  # of a file with fields; of a longer one nothing is read


def tar_of(samples: Iterable[tuple[str, bytes, Mapping[str, Any]]]) -> bytes:
    """Return a tar of images, each with its fields as JSON; the same samples give the same bytes."""
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        for name, image, fields in samples:
            text = json.dumps(fields, ensure_ascii=False, separators=(",", ":")).encode()
            for member, content in ((name, image), (f"{name.partition('.')[0]}.json", text)):
                header = tarfile.TarInfo(member)
                header.size = len(content)
                tar.addfile(header, io.BytesIO(content))
    return stream.getvalue()


def items(home: store.DataFolder, columns: ImportColumns, table: str | None) -> Iterator[FoundTouch]:
    """Yield a touch for each sample of the tars, by their headers and JSON files alone."""
    if table is not None:
        raise InputError("--table is about folders of images; a WebDataset has JSON files")
    known = dict[str, None]()
    for folder, name in _tars(home):
        seen = set[str]()  # of one tar: many number their samples from 0 in each
        for key, members in groupby(_members(folder, name), key=lambda each: each[0]):
            item = _sample(folder, name, key, list(members), columns)
            if key in seen:
                problem = ItemError("duplicate", f"the key {key!r} stands in an earlier sample of this tar")
                item = replace(item, problem=problem)
            seen.add(key)
            known |= dict.fromkeys(item.values)
            yield item
    if known:
        require_columns(list(known), columns.found_in(known).names(), home.address())


def _tars(home: store.DataFolder) -> list[tuple[store.DataFolder, str]]:
    """Return the tars of a folder, or the one that was named itself, each with its folder."""
    names = [name for name in home.sizes() if name.lower().endswith(".tar") and not store.is_hidden(name)]
    if names:
        return [(home, name) for name in names]
    place = home.address()
    if Path(place).is_file() if home.is_local else place.lower().endswith(".tar"):
        return [source_of(place)]
    raise InputError(f"{place!r} holds no tars (*.tar); compressed ones are unpacked first")


# Key, ending, place and size of a file in a tar, and the content where it is small text.
_Member = tuple[str, str, int, int, bytes]


def _members(folder: store.DataFolder, name: str) -> Iterator[_Member]:
    try:
        with open_source(folder, name) as stream:
            for member in files_of_tar(stream, folder.size_bytes(name)):
                start, path = member.offset_data, path_of(member.name)
                if store.is_hidden(path):  # as archives of a Mac have, one for each file
                    continue
                directory, slash, base = path.rpartition("/")
                stem, _, ending = base.partition(".")
                content = b""
                if not _is_image(ending) and member.size <= _MOST_TEXT_BYTES:
                    stream.seek(start)
                    content = stream.read(member.size)
                yield f"{directory}{slash}{stem}", ending.lower(), start, member.size, content
    except (tarfile.TarError, OSError) as error:
        raise IntegrityError(
            f"{folder.address(name)!r} is not an intact tar ({error}); nothing was written",
            next="fetch it again",
        ) from error


def _is_image(ending: str) -> bool:
    """Return whether an ending is that of an image; there may be several: ``rgb.jpg``."""
    return ending.lower().rpartition(".")[2] in IMAGE_ENDINGS


def _sample(
    folder: store.DataFolder, name: str, key: str, members: Sequence[_Member], columns: ImportColumns
) -> FoundTouch:
    """Put the files of one key together."""
    wanted = None if columns.image in (None, "file") else str(columns.image).lower()
    named = store.problem_of_name(key)
    problem = ItemError("name", f"the key {named}") if named else None
    images = [member for member in members if _is_image(member[1]) and wanted in (None, member[1])]
    if not images:
        expected = wanted or ", ".join(IMAGE_ENDINGS)
        problem = problem or ItemError("missing", f"no image; expected one of {expected}")
    values: dict[str, Any] = {}
    for _, ending, _, _, content in members:
        if ending == "json":
            try:
                values |= _fields(content)
            except ItemError as error:
                problem = problem or error
        elif not _is_image(ending):
            values.setdefault(ending, content.decode(errors="replace").strip())
    _, _, start, size, _ = images[0] if images else ("", "", 0, 0, b"")
    return FoundTouch(key, folder.address(), name, start, size, values, problem)


def _fields(content: bytes) -> dict[str, Any]:
    try:
        return dict(json.loads(content))
    except (ValueError, TypeError, RecursionError) as error:
        raise ItemError(
            "json", "its JSON file cannot be read; expected an object of at most 1 MiB"
        ) from error


def _pack(shard: store.ShardName, rows: pa.Table, skipped: Sequence[store.Skipped]) -> Made:
    """Return the touches of a shard as one tar; the same touches give the same bytes."""
    index = rows.drop_columns([IMAGE])
    images = (each.as_py() for each in rows[IMAGE])
    samples = (
        (image["path"], image["bytes"], fields)
        for image, fields in zip(images, index.to_pylist(), strict=True)
    )
    path = f"{_FOLDER}/{shard.split}-{shard.index:06d}.tar"
    return with_files(index, {path: tar_of(samples)} if len(rows) else {})


plan = partial(plan_rows, folder=_FOLDER, pack=_pack)
