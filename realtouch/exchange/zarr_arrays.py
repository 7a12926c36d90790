"""Arrays of Zarr 2 and 3 that others wrote, in a folder or a zip: read without codecs that run code.

What metadata state is checked before a chunk is opened: the codecs, of which only the lossless ones below are
known, and the sizes of chunks and arrays. A chunk unpacks to its stated size and no further. (The package
zarr follows links, and opens whatever codec is named.)
"""

from __future__ import annotations

import json
import math
import weakref
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from importlib import import_module
from itertools import product
from typing import IO, Any

import numpy as np
import pyarrow as pa

from realtouch.exchange.picture_arrays import StoredArray
from tactile_toolkit import store
from tactile_toolkit.array_types import AnyArray
from tactile_toolkit.bounds import require_plain_archive, require_unpackable
from tactile_toolkit.errors import InputError, ItemError, needs_extra

_DIRECTIONS = {"C": 1, "F": -1}
# Of Zarr 3: how the names of chunks begin, and what stands between their numbers by default.
_CHUNK_KEYS = {"default": ("c{}", "/"), "v2": ("", ".")}
_METADATA = {2: ".zarray", 3: "zarr.json"}
_MOST_METADATA_BYTES = 1 << 20
_MOST_CHUNKS = 1 << 18
_SPARE_BYTES = 1 << 16  # that a chunk which does not compress may take beyond its values
_WITHOUT_CHANGE = ("bytes", "transpose")  # of Zarr 3: how values lie in a chunk
# Errors of the standard library, Arrow and numcodecs; a damaged header causes MemoryError.
_UNREADABLE = (
    *(OSError, EOFError, ValueError, TypeError, LookupError, RuntimeError, MemoryError, OverflowError),
    *(zlib.error, zipfile.BadZipFile),
)


def _deflated(data: bytes, size: int) -> bytes:
    return zlib.decompressobj(47).decompress(data, size + 1)  # with the header of zlib or of gzip


def _zstd(data: bytes, size: int) -> bytes:
    return bytes(pa.Codec("zstd").decompress(data, size))


def _by_numcodecs(name: str, sizes_at: Sequence[int], data: bytes, size: int) -> bytes:
    """Unpack where the header, at some places, states the size unpacked, and that of all where it does."""
    with needs_extra("reading this Zarr group", "numcodecs", "zarr"):
        codec = import_module(f"numcodecs.{name}")
    expected = zip(sizes_at, (size, len(data)), strict=False)
    is_stated = all(int.from_bytes(data[at : at + 4], "little") == each for at, each in expected)
    return b"" if not is_stated else bytes(codec.decompress(data))


_CODECS: dict[str, Callable[[bytes, int], bytes]] = {
    "blosc": partial(_by_numcodecs, "blosc", (4, 12)),
    "gzip": _deflated,
    "lz4": partial(_by_numcodecs, "lz4", (0,)),
    "zlib": _deflated,
    "zstd": _zstd,
}
"""Functions that unpack data to a given number of bytes; a result of another length means damage."""


@dataclass(frozen=True)
class _Layout:
    """What metadata state of an array, and by that how it is read.

    ``axes`` is the order in which a chunk holds the axes; its file is called ``prefix`` and its number along
    each axis, with ``separator`` between.
    """

    shape: tuple[int, ...]
    chunks: tuple[int, ...]
    dtype: np.dtype[Any]
    fill: AnyArray
    codecs: tuple[str, ...]
    axes: tuple[int, ...]
    prefix: str
    separator: str

    @property
    def chunk_bytes(self) -> int:
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
        return f"{count:,} chunks; the limit is {_MOST_CHUNKS:,}" if count > _MOST_CHUNKS else ""


def _fill(stated: Any, dtype: np.dtype[Any]) -> AnyArray:
    """Return the value of what no chunk holds; ValueError for one that the type cannot hold."""
    if dtype.kind in "SU":
        stated = str(stated or "")
    elif isinstance(stated, str):
        stated = float(stated)
    return np.full((), stated or np.zeros((), dtype), dtype.newbyteorder("="))


def _layout_of_2(stated: Mapping[str, Any]) -> _Layout:
    codecs = [*(stated["filters"] or ()), *filter(None, [stated["compressor"]])]
    dtype = np.dtype(str(stated["dtype"]))
    return _Layout(
        shape=tuple(stated["shape"]),
        chunks=tuple(stated["chunks"]),
        dtype=dtype,
        fill=_fill(stated["fill_value"], dtype),
        codecs=tuple(str(each["id"]) for each in codecs),
        axes=tuple(range(len(stated["shape"]))[:: _DIRECTIONS[stated["order"]]]),
        prefix="",
        separator=str(stated.get("dimension_separator", ".")),
    )


def _layout_of_3(stated: Mapping[str, Any]) -> _Layout:
    configurations = {each["name"]: each.get("configuration", {}) for each in stated["codecs"]}
    keys, grid = stated["chunk_key_encoding"], stated["chunk_grid"]
    prefix, separator = _CHUNK_KEYS[keys["name"]]
    separator = str(keys.get("configuration", {}).get("separator", separator))
    dtype = np.dtype(str(stated["data_type"]))
    order = configurations.get("bytes", {}).get("endian", "little")
    return _Layout(
        shape=tuple(stated["shape"]),
        chunks=tuple({"regular": grid["configuration"]}[grid["name"]]["chunk_shape"]),
        dtype=dtype.newbyteorder(order),
        fill=_fill(stated["fill_value"], dtype),
        codecs=tuple(name for name in configurations if name not in _WITHOUT_CHANGE),
        axes=tuple(configurations.get("transpose", {}).get("order", range(len(stated["shape"])))),
        prefix=prefix.format(separator),
        separator=separator,
    )


_LAYOUTS = {2: _layout_of_2, 3: _layout_of_3}


class ZarrGroup:
    """A group, by its path below the source: a folder, or a file ``.zip``."""

    def __init__(self, home: store.DataFolder, path: str) -> None:
        self.home, self.path, self.place = home, path, home.address(path)
        is_folder = (home.info(path) or {}).get("type") == "directory"
        self.is_zip = path.lower().endswith(".zip") and not is_folder

    @cached_property
    def _archive(self) -> zipfile.ZipFile:
        try:
            stream = store.open_inside(self.home, self.path)
            weakref.finalize(self, stream.close)
            archive = zipfile.ZipFile(stream)
            require_plain_archive(archive)
        except (*_UNREADABLE, ItemError) as error:
            raise self.refused("", "not an intact zip of Zarr") from error
        return archive

    def _open(self, path: str) -> IO[bytes]:
        if not self.is_zip:
            return store.open_inside(self.home, self._below(path))
        if path not in self._archive.NameToInfo:
            raise ItemError("missing", "")
        return self._archive.open(path)

    def _below(self, path: str) -> str:
        return f"{self.path}/{path}".strip("/")

    def read(self, path: str, most: int = _MOST_METADATA_BYTES) -> bytes | None:
        """Return a file of the group, of ``most`` bytes at most; None if there is none."""
        try:
            with self._open(path) as stream:
                found = stream.read(most + 1)
        except ItemError as error:
            if error.reason == "missing":
                return None
            raise self.refused(path, error.what) from error
        except _UNREADABLE as error:
            raise self.refused(path, "a damaged file or zip") from error
        if len(found) > most:
            raise self.refused(path, f"a file of more than {most:,} bytes; expected at most that many")
        return found

    def json(self, path: str) -> dict[str, Any]:
        """Return a file of the group as a JSON object; an empty one where there is none."""
        try:
            return dict(json.loads(self.read(path) or b"{}"))
        except (ValueError, TypeError, RecursionError) as error:
            raise self.refused(path, "no JSON object; expected what Zarr states of an array") from error

    def arrays(self, folder: str) -> dict[str, object]:
        """Return what is stated as the shapes of the arrays directly in a folder of the group, unchecked."""
        if self.is_zip:
            names = {path.removeprefix(f"{folder}/").partition("/")[0] for path in self._archive.NameToInfo}
        else:
            names = set(self.home.names(self._below(folder)))
        visible = sorted(name for name in names if not store.is_hidden(name))
        stated = {name: self._stated(f"{folder}/{name}")[1] for name in visible}
        return {name: each["shape"] for name, each in stated.items() if "shape" in each}

    def _stated(self, path: str) -> tuple[int, dict[str, Any]]:
        """Return the version of Zarr of an array, and its metadata; empty ones where there is none."""
        found = {version: self.json(f"{path}/{name}") for version, name in _METADATA.items()}
        return next(((version, stated) for version, stated in found.items() if stated), (0, {}))

    def array(self, path: str) -> StoredArray:
        """Return an array whose metadata were checked; InputError for one that cannot be read."""
        version, stated = self._stated(path)
        try:
            layout = _LAYOUTS[version](stated)
        except _UNREADABLE as error:
            raise self.refused(path, "no array, or not with the metadata of Zarr 2 or 3") from error
        problem, place = layout.problem(), f"{self.place}/{path}"
        if problem:
            raise self.refused(path, problem)
        require_unpackable(layout.chunk_bytes, f"{place}: a chunk")
        read, size = partial(self._block, path, layout), partial(self._stored_bytes, path)
        return StoredArray(place, layout.shape, layout.dtype, layout.chunks[0], read, size)

    def refused(self, path: str, problem: str) -> InputError:
        """Return the error for a part of the group that cannot be used."""
        where = f"{self.place}/{path}".rstrip("/")
        return InputError(f"{where!r}: {problem}")

    def _stored_bytes(self, path: str) -> int:
        """Return how many bytes are stored of an array: of a group in a zip, those of the zip."""
        if self.is_zip:
            return self.home.size_bytes(self.path)
        return sum(map(self.home.size_bytes, self.home.walk(self._below(path))))

    def _block(self, path: str, layout: _Layout, number: int) -> AnyArray:
        step, *parts = layout.chunks
        size = (min(step, layout.shape[0] - number * step), *layout.shape[1:])
        dtype = layout.dtype.newbyteorder("=")
        require_unpackable(math.prod(size) * dtype.itemsize, f"{self.place}/{path}: {size} values")
        found: AnyArray = np.broadcast_to(layout.fill, size)  # where no chunk is stored
        for index in product(*map(range, layout.counts[1:])):
            chunk = self._chunk(path, layout, (number, *index))
            if chunk is not None:
                found = found if found.flags.writeable else np.array(found, dtype)
                spans = (slice(at * part, (at + 1) * part) for at, part in zip(index, parts, strict=True))
                target = found[(slice(None), *spans)]
                target[...] = chunk[tuple(map(slice, target.shape))]
        return found

    def _chunk(self, path: str, layout: _Layout, index: tuple[int, ...]) -> AnyArray | None:
        name = f"{path}/{layout.prefix}{layout.separator.join(map(str, index))}"
        data = self.read(name, 2 * layout.chunk_bytes + _SPARE_BYTES)
        if data is None:
            return None
        try:
            for codec in layout.codecs:
                data = _CODECS[codec](data, layout.chunk_bytes)
            stored = np.frombuffer(data, layout.dtype).reshape([layout.chunks[axis] for axis in layout.axes])
        except _UNREADABLE as error:
            expected = f"expected {layout.chunk_bytes:,} bytes unpacked"
            raise self.refused(name, f"a damaged chunk; {expected}") from error
        return stored.transpose(np.argsort(layout.axes))
