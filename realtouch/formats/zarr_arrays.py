"""Arrays of Zarr 2 and 3 from other programs, in folders and zips.

The metadata of an array are checked before a chunk is opened. Only the lossless codecs below are known. A
chunk is unpacked to its stated size and no further. (The package zarr opens any codec that is named, unpacks
without a limit, and follows links.)
"""

from __future__ import annotations

import json
import math
import weakref
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from importlib import import_module
from itertools import product
from typing import IO

import numpy as np
import pyarrow as pa

from realtouch.formats import picture_arrays
from tactile_toolkit import cache, errors, store, wording
from tactile_toolkit.value_types import AnyArray, JsonDict, JsonObject, JsonValue

_METADATA = {2: ".zarray", 3: "zarr.json"}
_MAX_METADATA_BYTES = 1 << 20
_SPARE_BYTES = 1 << 16  # a chunk that does not compress may be this much larger than its values


_DIRECTIONS = {"C": 1, "F": -1}

# Zarr 3: the prefix of the names of chunks, and the default separator of their numbers.
_CHUNK_KEYS = {"default": ("c{}", "/"), "v2": ("", ".")}
_MAX_CHUNKS = 1 << 18
_SPARSE_VERSION = 3  # whose writers leave out chunks of the fill value
_ATTRIBUTES = ".zattrs"
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
    is_stated = all(
        int.from_bytes(data[at : at + 4], "little") == size_expected for at, size_expected in expected
    )
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
        sizes = [*self.shape, *self.chunks]
        axes = list(range(len(self.shape)))
        fits = all(type(size) is int and 0 <= size < 1 << 63 for size in sizes) and all(self.chunks)
        fits &= axes != [] and sorted(self.axes) == axes == list(range(len(self.chunks)))
        fits &= self.dtype.kind in "biufSU" and self.dtype.itemsize > 0 and self.separator in ("/", ".")
        if not fits:
            return f"{self.dtype} {self.shape} in chunks {self.chunks}; expected numbers and fitting chunks"
        count = math.prod(self.counts)
        if count > _MAX_CHUNKS:
            return f"{wording.with_count(count, 'chunks')}; the limit is {_MAX_CHUNKS:,}"
        return ""

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
        codecs=tuple(str(codec["id"]) for codec in codecs),
        axes=tuple(range(len(stated["shape"]))[:: _DIRECTIONS[stated["order"]]]),
        prefix="",
        separator=str(stated.get("dimension_separator", ".")),
    )


def _layout_of_3(stated: JsonObject) -> ZarrLayout:
    configurations = {codec["name"]: codec.get("configuration", {}) for codec in stated["codecs"]}
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


def _is_chunk(path: str) -> bool:
    return path.rpartition("/")[2] not in (*_METADATA.values(), _ATTRIBUTES)


class ZarrGroup:
    """A group, given by its path below the source: a folder or a ``.zip`` file.

    ``absent`` counts the chunks of each array that were read as the fill value, as they are not stored.
    """

    def __init__(self, home: store.DataFolder, path: str) -> None:
        self.home, self.path, self.address = home, path, home.address(path)
        self.absent: dict[str, int] = {}
        is_folder = (home.info(path) or {}).get("type") == "directory"
        self.is_zip = path.lower().endswith(".zip") and not is_folder

    @cached_property
    def _archive(self) -> zipfile.ZipFile:
        try:
            stream = self.home.open_inside(self.path)
            weakref.finalize(self, stream.close)
            archive = zipfile.ZipFile(stream)
            cache.require_plain_archive(archive)
        except (*UNREADABLE, errors.ItemError) as error:
            raise self.refused("", "not an intact zip of Zarr") from error
        return archive

    def _open(self, path: str) -> IO[bytes]:
        if not self.is_zip:
            return self.home.open_inside(self._below(path))
        if path not in self._archive.NameToInfo:
            raise errors.ItemError("missing", "")
        return self._archive.open(path)

    def _below(self, path: str) -> str:
        return f"{self.path}/{path}".strip("/")

    def read(self, path: str, most: int = _MAX_METADATA_BYTES) -> bytes | None:
        """Return a file of the group, at most ``most`` bytes; None if it does not exist."""
        try:
            with self._open(path) as stream:
                content = stream.read(most + 1)
        except errors.ItemError as error:
            if error.reason == "missing":
                return None
            raise self.refused(path, error.what) from error
        except UNREADABLE as error:
            raise self.refused(path, "a damaged file or zip") from error
        if len(content) > most:
            raise self.refused(path, f"a file of more than {most:,} bytes; expected at most that many")
        return content

    def json(self, path: str) -> JsonDict:
        """Return a file of the group as a JSON object; empty if the file does not exist."""
        try:
            return dict(json.loads(self.read(path) or b"{}"))
        except (ValueError, TypeError, RecursionError) as error:
            raise self.refused(path, "no JSON object; expected metadata of Zarr") from error

    def arrays(self, folder: str) -> dict[str, object]:
        """Return the stated shapes of the arrays directly in a folder of the group, unchecked."""
        if self.is_zip:
            names = {path.removeprefix(f"{folder}/").partition("/")[0] for path in self._archive.NameToInfo}
        else:
            names = set(self.home.names(self._below(folder)))
        visible = sorted(name for name in names if not store.is_hidden(name))
        stated = {name: self._stated(f"{folder}/{name}")[1] for name in visible}
        return {name: metadata["shape"] for name, metadata in stated.items() if "shape" in metadata}

    def _stated(self, path: str) -> tuple[int, JsonDict]:
        """Return the Zarr version and the metadata of an array; 0 and empty if it does not exist."""
        by_version = {version: self.json(f"{path}/{name}") for version, name in _METADATA.items()}
        return next(((version, stated) for version, stated in by_version.items() if stated), (0, {}))

    def array(self, path: str, *, holds_pictures: bool = False) -> picture_arrays.StoredArray:
        """Return an array after a check of its metadata; InputError if it cannot be read.

        Chunks that are not stored hold the fill value where programs leave them out: in arrays without any
        chunk, beside other chunks of the same pictures, and in arrays of numbers that the package zarr 3
        wrote, which are of Zarr 3 or have a file of attributes, even an empty one. Reading any other missing
        chunk raises IntegrityError.
        """
        version, stated = self._stated(path)
        try:
            layout = LAYOUTS[version](stated)
        except UNREADABLE as error:
            raise self.refused(path, "no array, or not with the metadata of Zarr 2 or 3") from error
        problem = layout.problem()
        address = f"{self.address}/{path}"
        if problem:
            raise self.refused(path, problem)
        cache.require_unpackable(layout.chunk_bytes, f"{address}: a chunk")
        is_sparse = not holds_pictures and (
            version == _SPARSE_VERSION
            or self.read(f"{path}/{_ATTRIBUTES}") is not None
            or not any(map(_is_chunk, self._files_of(path)))
        )
        read = partial(self._block, path, layout, is_sparse, holds_pictures)
        size = partial(self._stored_bytes, path)
        return picture_arrays.StoredArray(address, layout.shape, layout.dtype, layout.chunks[0], read, size)

    def refused(self, path: str, problem: str) -> errors.InputError:
        """Return the error for a part of the group that cannot be used."""
        address = f"{self.address}/{path}".rstrip("/")
        return errors.InputError(f"{address!r}: {problem}")

    def _stored_bytes(self, path: str) -> int:
        """Return the size of the stored array in bytes; for a zipped group, the size of the zip."""
        if self.is_zip:
            return self.home.size_bytes(self.path)
        return sum(map(self.home.size_bytes, self.home.walk(self._below(path))))

    def _files_of(self, path: str) -> Iterator[str]:
        """Yield the paths of the files of an array, without their order."""
        if self.is_zip:
            return (name for name in self._archive.NameToInfo if name.startswith(f"{path}/"))
        return self.home.walk(self._below(path))

    def _block(
        self, path: str, layout: ZarrLayout, is_sparse: bool, holds_pictures: bool, number: int
    ) -> AnyArray:
        step, *parts = layout.chunks
        size = (min(step, layout.shape[0] - number * step), *layout.shape[1:])
        dtype = layout.dtype.newbyteorder("=")
        cache.require_unpackable(math.prod(size) * dtype.itemsize, f"{self.address}/{path}: {size} values")
        values: AnyArray = np.broadcast_to(layout.fill, size)  # the value where no chunk is stored
        missing = list[str]()
        for index in product(*map(range, layout.counts[1:])):
            name = f"{path}/{layout.prefix}{layout.separator.join(map(str, (number, *index)))}"
            chunk = self._chunk(name, layout)
            if chunk is None:
                missing.append(name)
            else:
                if not values.flags.writeable:
                    values = np.array(values, dtype)
                spans = (slice(at * part, (at + 1) * part) for at, part in zip(index, parts, strict=True))
                target = values[(slice(None), *spans)]
                target[...] = chunk[tuple(map(slice, target.shape))]
        is_part = holds_pictures and values.flags.writeable  # some chunks of these pictures are stored
        if missing and not (is_sparse or is_part):
            raise errors.IntegrityError(
                f"'{self.address}/{missing[0]}' is missing; expected every chunk of the array, which was "
                "perhaps not copied whole",
                next=f"copy the group again, or leave the array out: --map {path.rpartition('/')[2]}=",
            )
        self.absent[path] = self.absent.get(path, 0) + len(missing)
        return values

    def _chunk(self, name: str, layout: ZarrLayout) -> AnyArray | None:
        data = self.read(name, 2 * layout.chunk_bytes + _SPARE_BYTES)
        if data is None:
            return None
        try:
            return layout.unpacked(data)
        except UNREADABLE as error:
            raise self.refused(
                name, f"a damaged chunk; expected {layout.chunk_bytes:,} bytes unpacked"
            ) from error
