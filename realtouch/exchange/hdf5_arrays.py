"""Datasets of HDF5 that others wrote: read from the file itself alone, by filters that come with the library.

What the metadata state is checked before a value is read. A chunk unpacks to its stated size and no further:
HDF5 would allocate whatever the packed bytes ask for.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import IO, Any

import numpy as np

from tactile_toolkit.array_types import AnyArray
from tactile_toolkit.bounds import require_unpackable
from tactile_toolkit.errors import InputError, needs_extra

_DEFLATE, _LZF = 1, 32000
# Filters that are known, in the order in which they may stand.
_FILTERS = {2: "shuffle", _DEFLATE: "gzip", _LZF: "lzf", 3: "fletcher32"}
_LZF_RATIO = 90  # of unpacked to packed bytes, at most
_SPARE_BYTES = 1 << 16
_STEP_BYTES = 4 << 20
_DAMAGE = (OSError, RuntimeError, ValueError, TypeError, LookupError, MemoryError, OverflowError, zlib.error)


class H5Dataset:
    """A dataset whose metadata were checked; see :class:`realtouch.exchange.picture_arrays.StoredArray`."""

    def __init__(self, place: str, dataset: Any) -> None:
        self.place = f"{place}{dataset.name}"
        self.dataset = dataset
        with in_words(self.place):
            if dataset.is_virtual or dataset.external:
                raise self.refused("its values lie in other files; expected them in this file")
            self.shape = tuple(dataset.shape or ())
            self.dtype = np.dtype(dataset.dtype)
            self.step = max(1, _STEP_BYTES // max(1, math.prod(self.shape[1:]) * self.dtype.itemsize))
            if dataset.chunks:
                self.step = int(dataset.chunks[0])
                require_unpackable(self._chunk_bytes, f"{self.place}: a chunk")
            properties = dataset.id.get_create_plist()
            self.filters = [properties.get_filter(number)[0] for number in range(properties.get_nfilters())]
        order = [*_FILTERS]
        known = [order.index(each) for each in self.filters if each in order]
        if len(known) < len(self.filters) or sorted({*known}) != known or {_DEFLATE, _LZF} <= {*self.filters}:
            found = ", ".join(_FILTERS.get(each, f"number {each}") for each in self.filters)
            raise self.refused(f"the filters {found}; expected {', '.join(_FILTERS.values())}, in this order")
        if self.dtype.kind not in "biufSU":
            raise self.refused(f"values of type {self.dtype}; expected numbers or text of a fixed length")

    @property
    def _chunk_bytes(self) -> int:
        sides: tuple[int, ...] = self.dataset.chunks
        return math.prod(sides) * int(self.dtype.itemsize)

    def stored_bytes(self) -> int:
        """Return how many bytes are stored of the dataset."""
        size: int = self.dataset.id.get_storage_size()
        return size

    def refused(self, problem: str) -> InputError:
        """Return the error for a dataset that cannot be used."""
        return InputError(f"{self.place!r}: {problem}")

    def rows(self, start: int, stop: int) -> AnyArray:
        """Return what lies at some places along the first axis, shape (stop - start, ...)."""
        size = (stop - start, *self.shape[1:])
        require_unpackable(math.prod(size) * self.dtype.itemsize, f"{self.place}: {size} values")
        with in_words(self.place):
            if self.dataset.chunks and math.prod(size):
                spans = (slice(start, stop), *(slice(0, each) for each in self.shape[1:]))
                for chunk in self.dataset.iter_chunks(spans):
                    sides = zip(chunk, self.dataset.chunks, strict=True)
                    self._require_chunk(tuple(each.start - each.start % side for each, side in sides))
            found: AnyArray = self.dataset[start:stop]
        return found

    def _require_chunk(self, at: tuple[int, ...]) -> None:
        """Refuse a chunk that unpacks to more than its size, which HDF5 would allocate."""
        stored = self.dataset.id.get_chunk_info_by_coord(at).size
        if stored > 2 * self._chunk_bytes + _SPARE_BYTES:
            raise self.refused(f"a chunk of {stored:,} bytes; expected at most twice what it unpacks to")
        if stored and _LZF in self.filters:
            require_unpackable(_LZF_RATIO * stored, f"{self.place}: a chunk")
        if stored and _DEFLATE in self.filters:
            unused, packed = self.dataset.id.read_direct_chunk(at)
            is_packed = not unused >> self.filters.index(_DEFLATE) & 1
            size = self._chunk_bytes
            if is_packed and len(zlib.decompressobj().decompress(packed, size + 1)) != size:
                raise self.refused(f"a damaged chunk; expected {size:,} bytes unpacked")


@contextmanager
def in_words(place: str) -> Iterator[None]:
    """Turn errors of the library into InputError."""
    try:
        yield
    except _DAMAGE as error:
        raise InputError(f"{place!r}: not an intact file of HDF5", next="write the file again") from error


def open_file(stream: IO[bytes]) -> Any:
    """Open a file of HDF5 from a stream, which must stay open."""
    with needs_extra("reading HDF5", "h5py", "hdf5"):
        return import_module("h5py").File(stream, "r")


def is_inside(group: Any, name: str) -> bool:
    """Return whether a member of a group is in it, and not a link to another place or file."""
    return type(group.get(name, getlink=True)).__name__ == "HardLink"
