"""WebDataset: tars in which each touch is an image and a JSON file of one name."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Sequence
from dataclasses import dataclass

import pyarrow as pa

from realtouch.exchange.flat import IMAGE
from realtouch.exchange.vouched import file_fields, with_files
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.shards import ShardName, Skipped

__all__ = ["TAR_FOLDER", "PackTars"]

TAR_FOLDER = "webdataset"


@dataclass(frozen=True)
class PackTars:
    """What ``--layout webdataset`` does to the flat touches of a shard: one tar, named in the index."""

    folder: DataFolder

    def schema(self, rows: pa.Schema) -> pa.Schema:
        """Return the columns of the index: all but the images, and where those are."""
        return pa.schema([*(field for field in rows if field.name != IMAGE), *file_fields(1)])

    def apply(self, shard: ShardName, rows: pa.Table, skipped: Sequence[Skipped]) -> pa.Table:
        """Write the tar; the same touches give the same bytes."""
        path = f"{TAR_FOLDER}/{shard.split}-{shard.index:06d}.tar"
        index = rows.drop_columns([IMAGE])
        return with_files(self.folder, index, {path: _tar_bytes(rows, index)} if len(rows) else {})


def _tar_bytes(rows: pa.Table, index: pa.Table) -> bytes:
    images = rows[IMAGE].combine_chunks()
    names = images.field("path").to_pylist()
    encode = json.JSONEncoder(ensure_ascii=False, separators=(",", ":")).encode
    stream = io.BytesIO()
    for name, image, fields in zip(names, images.field("bytes"), index.to_pylist(), strict=True):
        text = encode(fields).encode()
        for member, content in ((name, image.as_buffer()), (f"{name.partition('.')[0]}.json", text)):
            stream.write(_header(member, len(content)))
            stream.write(content)
            stream.write(bytes(-len(content) % tarfile.BLOCKSIZE))
    stream.write(bytes(2 * tarfile.BLOCKSIZE))
    stream.write(bytes(-stream.tell() % tarfile.RECORDSIZE))
    return stream.getvalue()


def _header(name: str, size: int) -> bytes:
    """Return the entry of a file of no time and no owner: the standard library's takes 20 times as long."""
    encoded, octal = name.encode("ascii"), b"%011o" % size
    header = bytearray(_EMPTY)
    header[: len(encoded)] = encoded
    header[124:135] = octal
    checksum = _EMPTY_SUM + sum(encoded) + sum(octal) - sum(_EMPTY[124:135])
    header[148:154] = b"%06o" % checksum
    return bytes(header)


_EMPTY = tarfile.TarInfo("").tobuf(tarfile.USTAR_FORMAT)
_EMPTY_SUM = int(_EMPTY[148:154], 8)
