"""Metadata of Zarr 2 and 3 arrays, which are checked before a chunk is opened, and unpacking of chunks.

Only the lossless codecs below are known. A chunk is unpacked to its stated size and no further. (The package
zarr opens any codec that is named, unpacks without a limit, and follows links.)
"""

from __future__ import annotations

import math
import zipfile
import zlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module

import numpy as np
import pyarrow as pa

from tactile_toolkit import errors, wording
from tactile_toolkit.array_types import AnyArray
from tactile_toolkit.json_types import JsonObject, JsonValue

_DIRECTIONS = {"C": 1, "F": -1}
# Zarr 3: the prefix of the names of chunks, and the default separator of their numbers.
_CHUNK_KEYS = {"default": ("c{}", "/"), "v2": ("", ".")}
_MAX_CHUNKS = 1 << 18
_ARRANGING = ("bytes", "transpose")  # codecs of Zarr 3 that arrange the values of a chunk
# Errors of the standard library, Arrow and numcodecs; a damaged header causes MemoryError.
UNREADABLE = (
    *(OSError, EOFError, ValueError, TypeError, LookupError, RuntimeError, MemoryError, OverflowError),
    *(zlib.error, zipfile.BadZipFile),
)


def _deflated(data: bytes, size: int) -> bytes:
    return zlib.decompressobj(47).decompress(data, size + 1)  # with the header of zlib or of gzip


def _by_numcodecs(name: str, sizes_at: Sequence[int], data: bytes, size: int) -> bytes:
    """Unpack data if the header states the right sizes; return nothing otherwise.

    ``sizes_at`` are the offsets of the size of the unpacked data and, for some codecs, of the packed data.
    """
    with errors.needs_extra("reading this Zarr group", "numcodecs", "zarr"):
        codec = import_module(f"numcodecs.{name}")
    expected = zip(sizes_at, (size, len(data)), strict=False)
    is_stated = all(int.from_bytes(data[at : at + 4], "little") == each for at, each in expected)
    return bytes(codec.decompress(data)) if is_stated else b""


_CODECS: dict[str, Callable[[bytes, int], bytes]] = {
    "blosc": partial(_by_numcodecs, "blosc", (4, 12)),
    "gzip": _deflated,
    "lz4": partial(_by_numcodecs, "lz4", (0,)),
    "zlib": _deflated,
    "zstd": lambda data, size: bytes(pa.Codec("zstd").decompress(data, size)),
}
"""Functions that unpack data to a given number of bytes; a result of another length means damage."""


@dataclass(frozen=True)
class ZarrLayout:
    """The layout of an array, as its metadata state it.

    ``axes`` is the order of the axes in a chunk. The name of its file is ``prefix``, then its number along
    each axis, with ``separator`` between the numbers.
    """

    shape: tuple[int, ...]
    chunks: tuple[int, ...]
    dtype: np.dtype[np.generic]
    fill: AnyArray
    codecs: tuple[str, ...]
    axes: tuple[int, ...]
    prefix: str
    separator: str

    @property
    def chunk_bytes(self) -> int:
        """Size of a chunk, unpacked."""
        return math.prod(self.chunks) * self.dtype.itemsize

    @property
    def counts(self) -> list[int]:
        """Chunks along each axis."""
        return [-(-size // part) for size, part in zip(self.shape, self.chunks, strict=True)]

    def problem(self) -> str:
        """Return why the array cannot be read; empty if it can."""
        unknown = [name for name in self.codecs if name not in _CODECS] or list(self.codecs[1:])
        if unknown:
            return (
                f"the codec {unknown[0][:40]!r}; expected one of {', '.join(_CODECS)}, alone: others may run "
                "code, lose values or be unknown; nothing was opened"
            )
        sizes, axes = [*self.shape, *self.chunks], list(range(len(self.shape)))
        fits = all(type(size) is int and 0 <= size < 1 << 63 for size in sizes) and all(self.chunks)
        fits &= axes != [] and sorted(self.axes) == axes == list(range(len(self.chunks)))
        fits &= self.dtype.kind in "biufSU" and self.dtype.itemsize > 0 and self.separator in ("/", ".")
        if not fits:
            return f"{self.dtype} {self.shape} in chunks {self.chunks}; expected numbers and fitting chunks"
        count = math.prod(self.counts)
        if count > _MAX_CHUNKS:
            return f"{wording.with_count(count, 'chunks')}; the limit is {_MAX_CHUNKS:,}"
        return ""

    def chunk_name(self, index: Iterable[int]) -> str:
        """Return the name of the file of a chunk."""
        return f"{self.prefix}{self.separator.join(map(str, index))}"

    def unpacked(self, data: bytes) -> AnyArray:
        """Return the values of a chunk; raises one of UNREADABLE if it is damaged."""
        for codec in self.codecs:
            data = _CODECS[codec](data, self.chunk_bytes)
        stored = np.frombuffer(data, self.dtype).reshape([self.chunks[axis] for axis in self.axes])
        return stored.transpose(np.argsort(self.axes))


def _fill(stated: JsonValue, dtype: np.dtype[np.generic]) -> AnyArray:
    """Return the value where no chunk is stored; ValueError if the type cannot hold it."""
    if dtype.kind in "SU":
        stated = str(stated or "")
    elif isinstance(stated, str):
        stated = float(stated)
    return np.full((), stated or np.zeros((), dtype), dtype.newbyteorder("="))


def _layout_of_2(stated: JsonObject) -> ZarrLayout:
    codecs = [*(stated["filters"] or ()), *filter(None, [stated["compressor"]])]
    dtype = np.dtype(str(stated["dtype"]))
    return ZarrLayout(
        shape=tuple(stated["shape"]),
        chunks=tuple(stated["chunks"]),
        dtype=dtype,
        fill=_fill(stated["fill_value"], dtype),
        codecs=tuple(str(each["id"]) for each in codecs),
        axes=tuple(range(len(stated["shape"]))[:: _DIRECTIONS[stated["order"]]]),
        prefix="",
        separator=str(stated.get("dimension_separator", ".")),
    )


def _layout_of_3(stated: JsonObject) -> ZarrLayout:
    configurations = {each["name"]: each.get("configuration", {}) for each in stated["codecs"]}
    keys, grid = stated["chunk_key_encoding"], stated["chunk_grid"]
    prefix, separator = _CHUNK_KEYS[keys["name"]]
    separator = str(keys.get("configuration", {}).get("separator", separator))
    dtype = np.dtype(str(stated["data_type"]))
    order = configurations.get("bytes", {}).get("endian", "little")
    return ZarrLayout(
        shape=tuple(stated["shape"]),
        chunks=tuple({"regular": grid["configuration"]}[grid["name"]]["chunk_shape"]),
        dtype=dtype.newbyteorder(order),
        fill=_fill(stated["fill_value"], dtype),
        codecs=tuple(name for name in configurations if name not in _ARRANGING),
        axes=tuple(configurations.get("transpose", {}).get("order", range(len(stated["shape"])))),
        prefix=prefix.format(separator),
        separator=separator,
    )


LAYOUTS = {2: _layout_of_2, 3: _layout_of_3}
"""Functions that read the metadata of an array, by the version of Zarr."""
