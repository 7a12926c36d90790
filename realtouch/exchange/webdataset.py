"""WebDataset: tars in which each touch is an image and a JSON file of the same name."""

from __future__ import annotations

import json
import tarfile
from collections.abc import Iterable, Iterator, Mapping

import pyarrow as pa

from realtouch.convert.conversion import Made, with_files
from realtouch.exchange.flat import PackedFormat
from realtouch.stored_images import StoredImage
from tactile_toolkit import store

_FOLDER = "webdataset"
_WITHOUT_NAN = json.JSONEncoder(ensure_ascii=False, separators=(",", ":"), allow_nan=False)


def tar_of(samples: Iterable[tuple[str, bytes, Mapping[str, object]]]) -> bytes:
    """Return a tar of images, each with its fields as JSON; the same samples give the same bytes."""
    parts: list[bytes] = []
    size = 2 * tarfile.BLOCKSIZE
    for name, image, fields in samples:
        for member, content in ((name, image), (f"{name.partition('.')[0]}.json", _json_of(fields))):
            rest = -len(content) % tarfile.BLOCKSIZE
            header = tarfile.TarInfo(member)
            header.size = len(content)
            parts += (header.tobuf(tarfile.USTAR_FORMAT), content, bytes(rest))
            size += tarfile.BLOCKSIZE + len(content) + rest
    return b"".join([*parts, bytes(2 * tarfile.BLOCKSIZE + -size % tarfile.RECORDSIZE)])


def _json_of(fields: Mapping[str, object]) -> bytes:
    try:
        return _WITHOUT_NAN.encode(fields).encode()
    except ValueError:
        known = {name: _without_nan(value) for name, value in fields.items()}
        return json.dumps(known, ensure_ascii=False, separators=(",", ":")).encode()


def _without_nan(value: object) -> object:
    """Return a JSON value; a missing number is null in JSON, which has no NaN."""
    if isinstance(value, list):
        return list(map(_without_nan, value))
    return None if value != value else value


def _pack(shard: store.ShardName, index: pa.Table, images: Iterator[StoredImage]) -> Made:
    """Return the touches of a shard as one tar; the same touches give the same bytes."""
    pairs = zip(images, index.to_pylist(), strict=True)
    samples = ((image["path"], image["bytes"], fields) for image, fields in pairs)
    return with_files(index, {f"{_FOLDER}/{shard.split}-{shard.index:06d}.tar": tar_of(samples)})


plan_webdataset = PackedFormat(_FOLDER, _pack).plan
