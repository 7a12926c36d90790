"""Samples in tars: WebDataset, where a touch is an image and a JSON file of the same name, and FoTa.

FoTa are the tars that T3 trains on: ``SPLIT/data-000000.tar`` with poses in millimetres, and ``count.txt``.
Facts of the format: a sample is ``KEY.jpg`` and ``KEY.json``; poses are ``x_mm``, ``y_mm``, ``z_mm`` and
``quat_x`` to ``quat_w``; tars are numbered from 0 without gaps; ``count.txt`` has the number of samples.
"""

from __future__ import annotations

import json
import math
import tarfile
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache, partial
from itertools import groupby
from operator import attrgetter
from pathlib import PurePath
from typing import NamedTuple

import msgspec
import pyarrow as pa

from realtouch import touch_options
from realtouch.convert import conversion, picture_files
from realtouch.formats import touch_rows
from realtouch.importing import import_options, source_files, source_touches
from realtouch.touches import media
from tactile_toolkit import errors, store
from tactile_toolkit.columns import column_types, tables
from tactile_toolkit.value_types import JsonDict, JsonObject

_FOLDER = "webdataset"
Sample = tuple[str, bytes | memoryview, Mapping[str, object]]
"""The name of an image, its bytes, and the fields for its JSON file."""

# First bytes of files of gzip, bzip2, xz and Zstandard.
_COMPRESSED = (b"\x1f\x8b", b"BZh", b"\xfd7zX", b"\x28\xb5\x2f\xfd")
_MAX_FIELDS = 1000
_MAX_TEXT_BYTES = 1 << 20  # longer files with fields are not read

_FOTA_FOLDER = "fota"
_PER_METRE = (1000.0, 1000.0, 1000.0, 1.0, 1.0, 1.0, 1.0)


def tar_of(samples: Iterable[Sample]) -> bytes:
    """Return a tar of images, each with its fields as JSON; the same samples give the same bytes."""
    parts: list[bytes | memoryview] = []
    size = 2 * tarfile.BLOCKSIZE
    for name, image, fields in samples:
        for member, content in ((name, image), (f"{name.partition('.')[0]}.json", _json_of(fields))):
            padding = -len(content) % tarfile.BLOCKSIZE
            parts += (_header(member, len(content)), content, bytes(padding))
            size += tarfile.BLOCKSIZE + len(content) + padding
    return b"".join([*parts, bytes(2 * tarfile.BLOCKSIZE + -size % tarfile.RECORDSIZE)])


def _header(member: str, size: int) -> bytes:
    header = tarfile.TarInfo(member)
    header.size = size
    try:
        return header.tobuf(tarfile.USTAR_FORMAT)
    except ValueError:  # ustar cannot divide the name
        return header.tobuf(tarfile.PAX_FORMAT)


def _json_of(fields: Mapping[str, object]) -> bytes:
    texts = (f"{_json_text(name)}:{_json_text(value)}" for name, value in fields.items())
    return f"{{{','.join(texts)}}}".encode()


def _json_text(value: object) -> str:
    """Return a value as JSON, which has neither NaN nor infinity.

    NaN becomes null; infinity becomes 1e999, which readers of JSON take for infinity.
    """
    if isinstance(value, list):
        return f"[{','.join(map(_json_text, value))}]"
    if isinstance(value, float) and not math.isfinite(value):
        return "null" if math.isnan(value) else f"{'-' * (value < 0)}1e999"
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"))


def _pack(
    shard: store.ShardName, index: pa.Table, images: Iterator[touch_rows.NamedImage]
) -> conversion.Made:
    """Return the touches of a shard as one tar."""
    samples = ((*image, fields) for image, fields in zip(images, index.to_pylist(), strict=True))
    return conversion.with_files(index, {f"{_FOLDER}/{shard.split}-{shard.index:06d}.tar": tar_of(samples)})


plan_webdataset = touch_rows.TouchFormat((_FOLDER,), _pack).plan


def find_webdataset(
    home: store.DataFolder,
    columns: import_options.ImportColumns,
    table: str | None,
    ledger: source_files.Ledger,
) -> Iterator[source_touches.SourceTouches]:
    """Yield the samples of each tar as touches; only headers and short texts are read."""
    known = dict[str, None]()
    folder, names = source_files.files_to_read(
        home, "tars (*.tar)", partial(source_files.visible_files, endings=".tar")
    )
    for name in names:
        with store.without_collecting():
            groups = groupby(_members(folder, name), key=attrgetter("key"))
            samples = [_sample(key, list(members), columns) for key, members in groups]
        if samples:
            yield _touches(folder, name, samples)
            known |= dict.fromkeys(field for sample in samples for field in sample.values)
            ledger.left_out.update(dict.fromkeys(text for sample in samples for text in sample.unread))
    if known:
        source_files.require_columns(list(known), columns.found_in(known).names(), home.address())


def _touches(folder: store.DataFolder, name: str, samples: Sequence[_Sample]) -> source_touches.SourceTouches:
    """Return the samples of a tar; of samples with the same key, only the first can be used."""
    problems = {number: sample.problems[0] for number, sample in enumerate(samples) if sample.problems}
    problems |= source_files.duplicates_of(
        [sample.key for sample in samples], "key as in sample {} of this tar"
    )
    names = dict.fromkeys(field for sample in samples for field in sample.values)
    if len(names) > _MAX_FIELDS:
        raise errors.InputError(
            f"{folder.address(name)!r} has {len(names):,} different fields; the limit is {_MAX_FIELDS:,}",
            next="check that no names of fields are values",
        )
    fields = {}
    for field in names:
        column = column_types.column_of([sample.values.get(field) for sample in samples])
        if pa.types.is_string(column.type) and any(field in sample.endings for sample in samples):
            column = column_types.column_of(column, from_text=True)
        fields[field.encode(errors="backslashreplace").decode()] = column
    return source_touches.SourceTouches.of(
        [sample.key for sample in samples],
        folder.address(),
        name,
        fields,
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
        with tables.open_source(folder, name) as stream:
            if stream.read(4).startswith(_COMPRESSED):
                raise errors.InputError(
                    f"{folder.address(name)!r} is compressed; expected a tar", next="unpack it"
                )
            stream.seek(0)
            for member in picture_files.files_of_tar(stream, folder.size_bytes(name)):
                start = member.offset_data
                path = source_files.path_of(member.name)
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
    return f".{ending}".lower().endswith(source_files.IMAGE_ENDINGS)


class _Sample(NamedTuple):
    """The files of one key: the image, its fields, the endings of all files, problems, files not read."""

    key: str
    image: _Member
    values: JsonObject
    endings: Collection[str]
    problems: Sequence[errors.ItemError]
    unread: Sequence[str]


def _sample(key: str, members: Sequence[_Member], columns: import_options.ImportColumns) -> _Sample:
    """Combine the files of one key."""
    problems: list[errors.ItemError] = []
    named = store.problem_of_name(key)
    if named:
        problems.append(errors.ItemError("name", f"the key {named}"))
        key = key.encode(errors="backslashreplace").decode()
    ending = columns.image_name.lower()
    images = [member for member in members if _is_image(member.ending) and ending in ("", member.ending)]
    if not images:
        expected = ending or ", ".join(source_files.IMAGE_ENDINGS)
        problems.append(errors.ItemError("missing", f"no image; expected one of {expected}"))
    if len(images) > 1:
        endings_found = ", ".join(image.ending for image in images)
        problems.append(
            errors.ItemError(
                "images", f"the images {endings_found}; expected one (--map image=ENDING names it)"
            )
        )
    values: JsonDict = {}
    unread: list[str] = []
    for member in members:
        if member.ending == "json":
            try:
                values |= _fields(member.content)
            except errors.ItemError as error:
                problems.append(error)
        elif _is_image(member.ending):
            if member not in images:
                unread.append(f"*.{member.ending} (an image that was not chosen)")
        elif member.size > len(member.content) or b"\0" in member.content:
            unread.append(f"*.{member.ending} (not text of at most 1 MiB)")
        else:
            values.setdefault(member.ending, member.content.decode(errors="surrogateescape").strip())
    # JSON may hold one half of a surrogate pair, which cannot be stored.
    texts = {name: value for name, value in values.items() if isinstance(value, str)}
    if not "".join(texts.values()).isascii():  # a fast test first, as this runs for each image
        wrong = [name for name, text in texts.items() if text.encode(errors="ignore").decode() != text]
        for name in wrong:
            problems.append(errors.ItemError("json", f"its field {name!r} holds text that is not Unicode"))
            values = {}
    endings = {member.ending for member in members}
    return _Sample(key, next(iter(images), _NO_FILE), values, endings, problems, unread)


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


def _pack_fota(
    shard: store.ShardName, index: pa.Table, images: Iterator[touch_rows.NamedImage]
) -> conversion.Made:
    """Return the touches of a shard as one tar."""
    samples = (
        (f"{PurePath(name).stem}.jpg", media.as_jpeg(image), {**fields, **_pose_mm(fields)})
        for (name, image), fields in zip(images, index.to_pylist(), strict=True)
    )
    return conversion.with_files(
        index, {f"{_FOTA_FOLDER}/{shard.split}/data-{shard.index:06d}.tar": tar_of(samples)}
    )


def _pose_mm(fields: JsonObject) -> dict[str, float]:
    """Return the pose of a touch with the names and units of the format; empty without a pose."""
    values = [fields[name] for name in touch_options.POSE_COLUMNS if name in fields]
    return {
        name: value * factor
        for name, value, factor in zip(touch_options.FOTA_POSE_COLUMNS, values, _PER_METRE, strict=False)
    }


def _write_counts(folder: store.DataFolder, manifest: store.Manifest) -> dict[str, str]:
    """Write the number of samples of each split; return the checksum of each file by its path."""
    counts = {split: str(entry["rows"]).encode() for split, entry in manifest.split_table().items()}
    files = {f"{_FOTA_FOLDER}/{split}/count.txt": count for split, count in counts.items()}
    return conversion.checksums(folder, manifest) | conversion.write_changed(folder, files)


plan_fota = touch_rows.TouchFormat((_FOTA_FOLDER,), _pack_fota, _write_counts, no_gaps=True).plan


def find_fota(
    home: store.DataFolder,
    columns: import_options.ImportColumns,
    table: str | None,
    ledger: source_files.Ledger,
) -> Iterator[source_touches.SourceTouches]:
    """Yield the samples of each tar of one split; the folder has the name of the split."""
    ledger.use(home, "count.txt")
    split = home.address().rstrip("/").rpartition("/")[2]
    in_both_units = {*touch_options.POSE_COLUMNS, *touch_options.FOTA_POSE_COLUMNS}
    for touches in find_webdataset(home, columns, table, ledger):
        if {*touches.names} >= in_both_units:  # our exports have the pose twice
            touches = replace(
                touches, per_touch=touches.per_touch.drop_columns(list(touch_options.FOTA_POSE_COLUMNS))
            )
        if "split" not in touches.names:
            touches = touches.with_fields({"split": source_touches.repeated(split, len(touches))})
        yield touches
