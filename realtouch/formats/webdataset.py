"""WebDataset: tars in which each touch is an image and a JSON file of the same name."""

from __future__ import annotations

import json
import re
import tarfile
from collections.abc import Iterable, Iterator, Mapping

import msgspec
import pyarrow as pa

from realtouch import convert
from realtouch.formats.touch_rows import NamedImage, TouchFormat
from tactile_toolkit import store

_FOLDER = "webdataset"
_WITHOUT_NAN = json.JSONEncoder(ensure_ascii=False, separators=(",", ":"), allow_nan=False)
_encode = msgspec.json.Encoder().encode
# Signs of values that msgspec, which is ten times as fast, writes in another way than `json`: NaN, infinity,
# and numbers that one of them writes with an exponent.
_UNLIKE_JSON = (b"null", b"0.0000")
_EXPONENT = re.compile(rb"e[-\d]")
# Fields of a header (POSIX.1-1988, ustar): name, size and checksum. The checksum is the sum of all bytes,
# with blanks in its own place.
_NAME_BYTES, _SIZE, _SUM = 100, slice(124, 135), slice(148, 154)
_HEADER = tarfile.TarInfo().tobuf(tarfile.USTAR_FORMAT)
_SUM_OF_OTHERS = int(_HEADER[_SUM], 8) - sum(_HEADER[_SIZE])

Sample = tuple[str, bytes | memoryview, Mapping[str, object]]
"""The name of an image, its bytes, and the fields for its JSON file."""


def tar_of(samples: Iterable[Sample]) -> bytes:
    """Return a tar of images, each with its fields as JSON; the same samples give the same bytes."""
    parts: list[bytes | memoryview] = []
    size = 2 * tarfile.BLOCKSIZE
    for name, image, fields in samples:
        for member, content in ((name, image), (f"{name.partition('.')[0]}.json", _json_of(fields))):
            rest = -len(content) % tarfile.BLOCKSIZE
            parts += (_header(member, len(content)), content, bytes(rest))
            size += tarfile.BLOCKSIZE + len(content) + rest
    return b"".join([*parts, bytes(2 * tarfile.BLOCKSIZE + -size % tarfile.RECORDSIZE)])


def _header(member: str, size: int) -> bytes:
    """Return the header of a file as `tarfile` writes it, but ten times as fast unless the name is long."""
    name, digits = member.encode(), b"%011o" % size
    if len(name) > _NAME_BYTES:
        header = tarfile.TarInfo(member)
        header.size = size
        try:
            return header.tobuf(tarfile.USTAR_FORMAT)
        except ValueError:  # ustar cannot divide the name
            return header.tobuf(tarfile.PAX_FORMAT)
    found = bytearray(_HEADER)
    found[: len(name)] = name
    found[_SIZE] = digits
    found[_SUM] = b"%06o" % (_SUM_OF_OTHERS + sum(name) + sum(digits))
    return bytes(found)


def _json_of(fields: Mapping[str, object]) -> bytes:
    """Return fields as `json` writes them; NaN becomes null, as JSON has no NaN."""
    content = _encode(fields)
    if not (any(each in content for each in _UNLIKE_JSON) or _EXPONENT.search(content)):
        return content
    try:
        return _WITHOUT_NAN.encode(fields).encode()
    except ValueError:
        known = {name: _without_nan(value) for name, value in fields.items()}
        return json.dumps(known, ensure_ascii=False, separators=(",", ":")).encode()


def _without_nan(value: object) -> object:
    if isinstance(value, list):
        return list(map(_without_nan, value))
    return None if value != value else value


def _pack(shard: store.ShardName, index: pa.Table, images: Iterator[NamedImage]) -> convert.Made:
    """Return the touches of a shard as one tar."""
    samples = ((*image, fields) for image, fields in zip(images, index.to_pylist(), strict=True))
    return convert.with_files(index, {f"{_FOLDER}/{shard.split}-{shard.index:06d}.tar": tar_of(samples)})


plan_webdataset = TouchFormat(_FOLDER, _pack).plan
