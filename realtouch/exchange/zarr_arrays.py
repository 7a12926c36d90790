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
from typing import IO, Any, Self

import numpy as np
import pyarrow as pa

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
    zlib.error,
)
_LEVEL = 1


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


class ZarrGroup:
    """A group, by its path below the source: a folder, or a file ``.zip``."""

    def __init__(self, home: store.DataFolder, path: str) -> None:
        self.home = home
        self.path = path
        self.place = home.address(path)
        is_folder = (home.info(path) or {}).get("type") == "directory"
        self.is_zip = self.place.lower().endswith(".zip") and not is_folder

    @cached_property
    def _archive(self) -> zipfile.ZipFile:
        try:
            stream = store.open_inside(self.home, self.path)
            weakref.finalize(self, stream.close)
            archive = zipfile.ZipFile(stream)
            require_plain_archive(archive)
        except (*_UNREADABLE, zipfile.BadZipFile, ItemError) as error:
            raise self.refused("", "not an intact zip of Zarr") from error
        return archive

    def _open(self, path: str) -> IO[bytes]:
        if not self.is_zip:
            return store.open_inside(self.home, self.below(path))
        if path not in self._archive.NameToInfo:
            raise ItemError("missing", "")
        return self._archive.open(path)

    def below(self, path: str) -> str:
        """Return the path of a file or folder of the group below the source."""
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
        except (*_UNREADABLE, zipfile.BadZipFile) as error:
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

    def arrays(self, folder: str) -> list[str]:
        """List the arrays directly in a folder of the group."""
        if self.is_zip:
            names = {path.removeprefix(f"{folder}/").partition("/")[0] for path in self._archive.NameToInfo}
        else:
            names = set(self.home.names(self.below(folder)))
        visible = sorted(name for name in names if not store.is_hidden(name))
        return [name for name in visible if "shape" in self._stated(f"{folder}/{name}")[1]]

    def _stated(self, path: str) -> tuple[int, dict[str, Any]]:
        """Return the version of Zarr of an array, and its metadata; empty ones where there is none."""
        found = {version: self.json(f"{path}/{name}") for version, name in _METADATA.items()}
        return next(((version, stated) for version, stated in found.items() if stated), (0, {}))

    def stated_shape(self, path: str) -> tuple[Any, ...]:
        """Return what is stated as the shape of an array, unchecked; empty if there is none."""
        found = self._stated(path)[1].get("shape")
        return tuple(found) if isinstance(found, list) else ()

    def array(self, path: str) -> ZarrArray:
        """Return an array whose metadata were checked; InputError for one that cannot be read."""
        version, stated = self._stated(path)
        try:
            return ZarrArray(self, path, **_LAYOUTS[version](stated))
        except _UNREADABLE as error:
            raise self.refused(path, "no array, or not with the metadata of Zarr 2 or 3") from error

    def refused(self, path: str, problem: str) -> InputError:
        """Return the error for a part of the group that cannot be used."""
        where = f"{self.place}/{path}".rstrip("/")
        return InputError(f"{where!r}: {problem}")


def _fill(stated: Any, dtype: np.dtype[Any]) -> Any:
    """Return the value of what no chunk holds; ValueError for one that the type cannot hold."""
    if dtype.kind in "SU":
        return np.full(1, str(stated or ""), dtype)[0]
    if isinstance(stated, str):
        stated = float(stated)
    return np.full(1, stated or 0, dtype)[0]


def _layout_of_2(stated: Mapping[str, Any]) -> dict[str, Any]:
    codecs = [*(stated["filters"] or ()), *filter(None, [stated["compressor"]])]
    axes, dtype = range(len(stated["shape"])), np.dtype(str(stated["dtype"]))
    return {
        "shape": tuple(stated["shape"]),
        "chunks": tuple(stated["chunks"]),
        "dtype": dtype,
        "fill": _fill(stated["fill_value"], dtype),
        "codecs": tuple(str(each["id"]) for each in codecs),
        "axes": tuple(axes[:: _DIRECTIONS[stated["order"]]]),
        "prefix": "",
        "separator": str(stated.get("dimension_separator", ".")),
    }


def _layout_of_3(stated: Mapping[str, Any]) -> dict[str, Any]:
    configurations = {each["name"]: each.get("configuration", {}) for each in stated["codecs"]}
    keys, grid, axes = stated["chunk_key_encoding"], stated["chunk_grid"], range(len(stated["shape"]))
    prefix, separator = _CHUNK_KEYS[keys["name"]]
    separator = str(keys.get("configuration", {}).get("separator", separator))
    dtype = np.dtype(str(stated["data_type"]))
    order = configurations.get("bytes", {}).get("endian", "little")
    return {
        "shape": tuple(stated["shape"]),
        "chunks": tuple({"regular": grid["configuration"]}[grid["name"]]["chunk_shape"]),
        "dtype": dtype.newbyteorder(order),
        "fill": _fill(stated["fill_value"], dtype),
        "codecs": tuple(name for name in configurations if name not in _WITHOUT_CHANGE),
        "axes": tuple(configurations.get("transpose", {}).get("order", axes)),
        "prefix": prefix.format(separator),
        "separator": separator,
    }


_LAYOUTS = {2: _layout_of_2, 3: _layout_of_3}


@dataclass(frozen=True, eq=False)
class ZarrArray:
    """An array: its metadata, checked, and how to read it.

    ``axes`` is the order in which a chunk holds the axes; its file is called ``prefix`` and its number along
    each axis, with ``separator`` between.
    """

    group: ZarrGroup
    path: str
    shape: tuple[int, ...]
    chunks: tuple[int, ...]
    dtype: np.dtype[Any]
    fill: Any
    codecs: tuple[str, ...]
    axes: tuple[int, ...]
    prefix: str
    separator: str

    def __post_init__(self) -> None:
        unknown = [name for name in self.codecs if name not in _CODECS] or list(self.codecs[1:])
        if unknown:
            raise self.refused(
                f"the codec {unknown[0][:40]!r}; expected one of {', '.join(_CODECS)}, alone: others may run "
                "code, lose values or are not known here; nothing was opened"
            )
        sizes = [*self.shape, *self.chunks]
        fits = all(type(size) is int and 0 <= size <= store.LARGEST for size in sizes) and all(self.chunks)
        axes = list(range(len(self.shape)))
        fits &= sorted(self.axes) == axes == list(range(len(self.chunks)))
        fits &= self.dtype.kind in "biufSU" and self.dtype.itemsize > 0
        if not fits or self.separator not in ("/", "."):
            raise self.refused(
                f"{self.dtype} {self.shape} in chunks {self.chunks}; expected numbers and fitting chunks"
            )
        require_unpackable(self._chunk_bytes, f"{self.place}: a chunk")
        count = math.prod(self._chunk_counts)
        if count > _MOST_CHUNKS:
            raise self.refused(f"{count:,} chunks; the limit is {_MOST_CHUNKS:,}")

    @property
    def place(self) -> str:
        """Address of the array, for messages."""
        return f"{self.group.place}/{self.path}"

    @property
    def step(self) -> int:
        """Rows that one chunk holds."""
        return self.chunks[0]

    def refused(self, problem: str) -> InputError:
        """Return the error for an array that cannot be used."""
        return self.group.refused(self.path, problem)

    @property
    def _chunk_counts(self) -> list[int]:
        return [-(-size // part) for size, part in zip(self.shape, self.chunks, strict=True)]

    @property
    def _chunk_bytes(self) -> int:
        return math.prod(self.chunks) * self.dtype.itemsize

    def stored_bytes(self) -> int:
        """Return how many bytes are stored of the array: of a group in a zip, those of the zip."""
        home, group = self.group.home, self.group
        if group.is_zip:
            return home.size_bytes(group.path)
        return sum(map(home.size_bytes, home.walk(group.below(self.path))))

    def require_chunks(self) -> None:
        """Unpack all chunks that are stored; InputError for one that is damaged."""
        for index in product(*map(range, self._chunk_counts)):
            self._chunk(index)

    def rows(self, start: int, stop: int) -> AnyArray:
        """Return what lies at some places along the first axis, shape (stop - start, ...)."""
        size = (stop - start, *self.shape[1:])
        what = f"{self.place}: {size} values"
        require_unpackable(math.prod(size) * self.dtype.itemsize, what)
        found = np.full(size, self.fill, self.dtype.newbyteorder("="))  # where no chunk is stored
        spans = [(start, stop), *((0, each) for each in self.shape[1:])]
        numbers = (
            range(low // part, -(-high // part)) for (low, high), part in zip(spans, self.chunks, strict=True)
        )
        for index in product(*numbers):
            inside, place = [], []
            for at, part, (low, high) in zip(index, self.chunks, spans, strict=True):
                first, last = max(at * part, low), min((at + 1) * part, high)
                inside.append(slice(first - at * part, last - at * part))
                place.append(slice(first - low, last - low))
            chunk = self._chunk(index)
            if chunk is not None:
                found[tuple(place)] = chunk[tuple(inside)]
        return found

    def _chunk(self, index: tuple[int, ...]) -> AnyArray | None:
        name = f"{self.path}/{self.prefix}{self.separator.join(map(str, index))}"
        data = self.group.read(name, 2 * self._chunk_bytes + _SPARE_BYTES)
        if data is None:
            return None
        try:
            for codec in self.codecs:
                data = _CODECS[codec](data, self._chunk_bytes)
            stored = np.frombuffer(data, self.dtype).reshape([self.chunks[axis] for axis in self.axes])
        except _UNREADABLE as error:
            expected = f"expected {self._chunk_bytes:,} bytes unpacked"
            raise self.group.refused(name, f"a damaged chunk; {expected}") from error
        return stored.transpose(np.argsort(self.axes))


class ZarrWriter(zipfile.ZipFile):
    """A zip of arrays whose chunks follow each other along the first axis; equal arrays give equal bytes."""

    def __init__(self, stream: IO[bytes], groups: Sequence[str]) -> None:
        super().__init__(stream, "w")
        for path in ("", *(f"{name}/" for name in groups)):
            self.add_json(f"{path}.zgroup", {"zarr_format": 2})

    def __enter__(self) -> Self:
        return self

    def describe(
        self, path: str, shape: Sequence[int], chunks: Sequence[int], dtype: str, fill: object = 0
    ) -> None:
        """Write what Zarr states of an array; ``fill`` is the value of what no chunk holds."""
        stated = {
            "zarr_format": 2,
            "shape": list(shape),
            "chunks": list(chunks),
            "dtype": dtype,
            "order": "C",
        }
        stated |= {"compressor": {"id": "zlib", "level": _LEVEL}, "fill_value": fill, "filters": None}
        self.add_json(f"{path}/.zarray", stated, indent=4)

    def chunk(self, path: str, number: int, values: AnyArray) -> None:
        """Write a chunk, which holds the other axes completely."""
        name = ".".join([str(number), *"0" * (values.ndim - 1)])
        self._add(f"{path}/{name}", zlib.compress(np.ascontiguousarray(values).tobytes(), _LEVEL))

    def add_json(self, path: str, stated: Mapping[str, object], indent: int | None = None) -> None:
        """Write a file of JSON."""
        self._add(path, json.dumps(stated, indent=indent).encode())

    def _add(self, path: str, content: bytes) -> None:
        self.writestr(zipfile.ZipInfo(path), content)  # without a time of writing
