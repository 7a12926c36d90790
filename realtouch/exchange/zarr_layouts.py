"""What metadata of Zarr 2 and 3 state of an array, checked before a chunk is opened, and how a chunk unpacks.

Of the codecs only the lossless ones below are known; a chunk unpacks to its stated size and no further. (The
package zarr opens whatever codec is named, unpacks without a limit, and follows links.)
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

from tactile_toolkit import errors, store, wording
from tactile_toolkit.array_types import AnyArray
from tactile_toolkit.json_types import JsonObject, JsonValue

_DIRECTIONS = {"C": 1, "F": -1}
# Of Zarr 3: how the names of chunks begin, and what stands between their numbers by default.
_CHUNK_KEYS = {"default": ("c{}", "/"), "v2": ("", ".")}
_MAX_CHUNKS = 1 << 18
_WITHOUT_CHANGE = ("bytes", "transpose")  # of Zarr 3: how values lie in a chunk
# Errors of the standard library, Arrow and numcodecs; a damaged header causes MemoryError.
UNREADABLE = (
    *(OSError, EOFError, ValueError, TypeError, LookupError, RuntimeError, MemoryError, OverflowError),
    *(zlib.error, zipfile.BadZipFile),
)


def _deflated(data: bytes, size: int) -> bytes:
    return zlib.decompressobj(47).decompress(data, size + 1)  # with the header of zlib or of gzip


def _by_numcodecs(name: str, sizes_at: Sequence[int], data: bytes, size: int) -> bytes:
    """Unpack where the header, at some places, states the size unpacked, and that of all where it does."""
    with errors.needs_extra("reading this Zarr group", "numcodecs", "zarr"):
        codec = import_module(f"numcodecs.{name}")
    expected = zip(sizes_at, (size, len(data)), strict=False)
    is_stated = all(int.from_bytes(data[at : at + 4], "little") == each for at, each in expected)
    return b"" if not is_stated else bytes(codec.decompress(data))


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
    """What metadata state of an array, and by that how it is read.

    ``axes`` is the order in which a chunk holds the axes; its file is called ``prefix`` and its number along
    each axis, with ``separator`` between.
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
        """Return why such an array cannot be read; empty if it can."""
        unknown = [name for name in self.codecs if name not in _CODECS] or list(self.codecs[1:])
        if unknown:
            return (
                f"the codec {unknown[0][:40]!r}; expected one of {', '.join(_CODECS)}, alone: others may run "
                "code, lose values or are not known here; nothing was opened"
            )
        sizes, axes = [*self.shape, *self.chunks], list(range(len(self.shape)))
        fits = all(type(size) is int and 0 <= size <= store.LARGEST for size in sizes) and all(self.chunks)
        fits &= axes != [] and sorted(self.axes) == axes == list(range(len(self.chunks)))
        fits &= self.dtype.kind in "biufSU" and self.dtype.itemsize > 0 and self.separator in ("/", ".")
        if not fits:
            return f"{self.dtype} {self.shape} in chunks {self.chunks}; expected numbers and fitting chunks"
        count = math.prod(self.counts)
        return (
            f"{wording.with_count(count, 'chunks')}; the limit is {_MAX_CHUNKS:,}"
            if count > _MAX_CHUNKS
            else ""
        )

    def chunk_name(self, index: Iterable[int]) -> str:
        """Return the name of the file of a chunk."""
        return f"{self.prefix}{self.separator.join(map(str, index))}"

    def unpacked(self, data: bytes) -> AnyArray:
        """Return the values of a chunk; one of UNREADABLE for a damaged one."""
        for codec in self.codecs:
            data = _CODECS[codec](data, self.chunk_bytes)
        stored = np.frombuffer(data, self.dtype).reshape([self.chunks[axis] for axis in self.axes])
        return stored.transpose(np.argsort(self.axes))


def _fill(stated: JsonValue, dtype: np.dtype[np.generic]) -> AnyArray:
    """Return the value of what no chunk holds; ValueError for one that the type cannot hold."""
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
        codecs=tuple(name for name in configurations if name not in _WITHOUT_CHANGE),
        axes=tuple(configurations.get("transpose", {}).get("order", range(len(stated["shape"])))),
        prefix=prefix.format(separator),
        separator=separator,
    )


LAYOUTS = {2: _layout_of_2, 3: _layout_of_3}
"""Functions that read what metadata state of an array, by the version of Zarr."""
