"""Tables that index files: columns, names of files and checksums."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any
from urllib.parse import unquote

import pyarrow as pa

from realtouch.convert.conversion import Made
from tactile_toolkit import read, store

# Of the columns ``file`` and ``sha256`` of an index, which name up to two files for each row.
_PREFIXES = ("", "meta_")
_NOT_PLAIN = re.compile(rb"[^A-Za-z0-9_-]")
_LONGEST = 100
_KEPT = 60  # of a longer one, before its digest


def with_files(
    index: pa.Table, files: Mapping[str, bytes], named: Sequence[Sequence[str]] | None = None
) -> Made:
    """Return the files of a shard with its index, which names up to two for each row: by default all."""
    digests = {path: store.sha256_hex(content) for path, content in files.items()}
    columns = named or [[path] * len(index) for path in files]
    for prefix, paths in zip(_PREFIXES, columns, strict=False):
        for name, values in (("file", paths), ("sha256", [digests[path] for path in paths])):
            index = index.append_column(f"{prefix}{name}", pa.array(values, pa.string()))
    return index, files


def files_of(folder: store.DataFolder, record: store.ShardRecord) -> dict[str, str]:
    """Return the checksum of each file that the index of a finished shard names, by path."""
    shard = read.Shard(folder.address(record.shard.data_path))
    found: dict[str, str] = {}
    for prefix in _PREFIXES:
        names = [f"{prefix}file", f"{prefix}sha256"]
        if all(name in shard.types for name in names):
            paths, digests = (column.to_pylist() for column in shard.read(columns=names).columns)
            found |= dict(zip(paths, digests, strict=True))
    return found


def checksums(folder: store.DataFolder, manifest: store.Manifest) -> dict[str, str]:
    """Return the checksum of each file that the shards name, for the manifest."""
    return {path: sha256 for record in manifest.shards for path, sha256 in files_of(folder, record).items()}


def schema_of(source: pa.Schema, wanted: Mapping[str, tuple[pa.DataType, Collection[str]]]) -> pa.Schema:
    """Return those of the wanted columns that a source can fill.

    With the type of each stand columns of the source, of which one is needed; without any it is always there.
    """
    known = read.column_types(source)
    return pa.schema(
        (name, data_type)
        for name, (data_type, needed) in wanted.items()
        if not needed or any(each in known for each in needed)
    )


def table_of(schema: pa.Schema, columns: Mapping[str, Any]) -> pa.Table:
    """Return the columns of a schema as a table; those that are not given have no values."""
    unknown = [None] * len(columns["id"])
    return pa.table([pa.array(columns.get(each.name, unknown), each.type) for each in schema], schema=schema)


def write_changed(folder: store.DataFolder, files: Mapping[str, bytes]) -> dict[str, str]:
    """Write files where they differ: a run over a finished set changes nothing. Return their checksums."""
    digests = {path: store.sha256_hex(content) for path, content in files.items()}
    for path, content in files.items():
        if not store.is_unchanged(folder, path, digests[path]):
            folder.write_bytes(path, content)
    return digests


def file_stem(round_id: str) -> str:
    """Return the name of a file for a round, without an ending: its id, if that is plain.

    Whatever is not a letter, a digit, ``-`` or ``_`` is escaped as in addresses, ``a.b`` as ``a%2Eb``, so
    that different ids stay different and lead nowhere else on any system; a long one ends in its digest.
    """
    content = round_id.encode()
    stem = _NOT_PLAIN.sub(_escaped, content).decode()
    if len(stem) > _LONGEST:
        return f"{stem[:_KEPT]}-{hashlib.sha256(content).hexdigest()[:16]}"
    if not stem or store.problem_of_name(stem):  # none, or a device of Windows, such as ``con``
        return f"%{content[:1].hex().upper()}{stem[1:]}"
    return stem


def id_of_stem(stem: str) -> str:
    """Return the id of which :func:`file_stem` made a name; a name that others made, as it is."""
    round_id = unquote(stem)
    if file_stem(round_id) == stem:
        return round_id
    return stem


def _escaped(found: re.Match[bytes]) -> bytes:
    return f"%{found[0].hex().upper()}".encode()
