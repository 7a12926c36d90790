"""Groups of Zarr 2 and 3 from other programs, in a folder or zip; codecs that run code are refused.

The metadata of an array are checked before a chunk is opened; see :mod:`realtouch.formats.zarr_layouts`.
"""

from __future__ import annotations

import json
import math
import weakref
import zipfile
from functools import cached_property, partial
from itertools import product
from typing import IO

import numpy as np

from realtouch.formats import picture_arrays, zarr_layouts
from tactile_toolkit import cache, errors, store
from tactile_toolkit.array_types import AnyArray
from tactile_toolkit.json_types import JsonDict

_METADATA = {2: ".zarray", 3: "zarr.json"}
_MAX_METADATA_BYTES = 1 << 20
_SPARE_BYTES = 1 << 16  # a chunk that does not compress may be this much larger than its values


class ZarrGroup:
    """A group, given by its path below the source: a folder or a ``.zip`` file."""

    def __init__(self, home: store.DataFolder, path: str) -> None:
        self.home, self.path, self.place = home, path, home.address(path)
        is_folder = (home.info(path) or {}).get("type") == "directory"
        self.is_zip = path.lower().endswith(".zip") and not is_folder

    @cached_property
    def _archive(self) -> zipfile.ZipFile:
        try:
            stream = self.home.open_inside(self.path)
            weakref.finalize(self, stream.close)
            archive = zipfile.ZipFile(stream)
            cache.require_plain_archive(archive)
        except (*zarr_layouts.UNREADABLE, errors.ItemError) as error:
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
                found = stream.read(most + 1)
        except errors.ItemError as error:
            if error.reason == "missing":
                return None
            raise self.refused(path, error.what) from error
        except zarr_layouts.UNREADABLE as error:
            raise self.refused(path, "a damaged file or zip") from error
        if len(found) > most:
            raise self.refused(path, f"a file of more than {most:,} bytes; expected at most that many")
        return found

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
        return {name: each["shape"] for name, each in stated.items() if "shape" in each}

    def _stated(self, path: str) -> tuple[int, JsonDict]:
        """Return the Zarr version and the metadata of an array; 0 and empty if it does not exist."""
        found = {version: self.json(f"{path}/{name}") for version, name in _METADATA.items()}
        return next(((version, stated) for version, stated in found.items() if stated), (0, {}))

    def array(self, path: str) -> picture_arrays.StoredArray:
        """Return an array after a check of its metadata; InputError if it cannot be read."""
        version, stated = self._stated(path)
        try:
            layout = zarr_layouts.LAYOUTS[version](stated)
        except zarr_layouts.UNREADABLE as error:
            raise self.refused(path, "no array, or not with the metadata of Zarr 2 or 3") from error
        problem, place = layout.problem(), f"{self.place}/{path}"
        if problem:
            raise self.refused(path, problem)
        cache.require_unpackable(layout.chunk_bytes, f"{place}: a chunk")
        read, size = partial(self._block, path, layout), partial(self._stored_bytes, path)
        return picture_arrays.StoredArray(place, layout.shape, layout.dtype, layout.chunks[0], read, size)

    def refused(self, path: str, problem: str) -> errors.InputError:
        """Return the error for a part of the group that cannot be used."""
        where = f"{self.place}/{path}".rstrip("/")
        return errors.InputError(f"{where!r}: {problem}")

    def _stored_bytes(self, path: str) -> int:
        """Return the size of the stored array in bytes; for a zipped group, the size of the zip."""
        if self.is_zip:
            return self.home.size_bytes(self.path)
        return sum(map(self.home.size_bytes, self.home.walk(self._below(path))))

    def _block(self, path: str, layout: zarr_layouts.ZarrLayout, number: int) -> AnyArray:
        step, *parts = layout.chunks
        size = (min(step, layout.shape[0] - number * step), *layout.shape[1:])
        dtype = layout.dtype.newbyteorder("=")
        cache.require_unpackable(math.prod(size) * dtype.itemsize, f"{self.place}/{path}: {size} values")
        found: AnyArray = np.broadcast_to(layout.fill, size)  # the value where no chunk is stored
        for index in product(*map(range, layout.counts[1:])):
            chunk = self._chunk(path, layout, (number, *index))
            if chunk is not None:
                if not found.flags.writeable:
                    found = np.array(found, dtype)
                spans = (slice(at * part, (at + 1) * part) for at, part in zip(index, parts, strict=True))
                target = found[(slice(None), *spans)]
                target[...] = chunk[tuple(map(slice, target.shape))]
        return found

    def _chunk(self, path: str, layout: zarr_layouts.ZarrLayout, index: tuple[int, ...]) -> AnyArray | None:
        name = f"{path}/{layout.chunk_name(index)}"
        data = self.read(name, 2 * layout.chunk_bytes + _SPARE_BYTES)
        if data is None:
            return None
        try:
            return layout.unpacked(data)
        except zarr_layouts.UNREADABLE as error:
            raise self.refused(
                name, f"a damaged chunk; expected {layout.chunk_bytes:,} bytes unpacked"
            ) from error
