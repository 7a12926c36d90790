"""HDF5 datasets of other programs: only values in the file itself are read, with the filters of the library.

Metadata are checked before a value is read. A chunk is unpacked to its stated size and no further: HDF5 would
allocate whatever the packed bytes ask for.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from typing import IO, Any

import numpy as np

from realtouch.formats.picture_arrays import StoredArray
from tactile_toolkit.array_types import AnyArray
from tactile_toolkit.cache import require_unpackable
from tactile_toolkit.errors import InputError, needs_extra

H5Object = Any
"""A file, group or dataset of h5py, which has no types for type checkers."""

_DEFLATE, _LZF = 1, 32000
# Known filters, in the order in which they may occur. A dataset has at most one of gzip and lzf.
_FILTERS = {2: "shuffle", _DEFLATE: "gzip", _LZF: "lzf", 3: "fletcher32"}
_LZF_RATIO = 90  # of unpacked to packed bytes, at most
_SPARE_BYTES = 1 << 16
_STEP_BYTES = 4 << 20
_DAMAGE = (OSError, RuntimeError, ValueError, TypeError, LookupError, MemoryError, OverflowError, zlib.error)


@contextmanager
def in_words(place: str) -> Iterator[None]:
    """Turn errors of the library into InputError."""
    try:
        yield
    except _DAMAGE as error:
        raise InputError(f"{place!r}: not an intact file of HDF5", next="write the file again") from error


def open_file(stream: IO[bytes]) -> H5Object:
    """Open an HDF5 file from a stream, which must stay open."""
    with needs_extra("reading HDF5", "h5py", "hdf5"):
        return import_module("h5py").File(stream, "r")


def kind_of_member(group: H5Object, name: str) -> str:
    """Return the kind of a member of a group: ``Dataset``, ``Group``, or ``link`` to another place."""
    if type(group.get(name, getlink=True)).__name__ != "HardLink":
        return "link"
    return str(group.get(name, getclass=True).__name__)


def dataset_in(file: str, root: H5Object, path: str) -> StoredArray:
    """Open a dataset by its path in the file, not through links; InputError if it cannot be used."""
    place, found = f"{file}/{path}", root
    with in_words(place):
        for name in path.split("/"):
            if kind_of_member(found, name) == "link":
                raise InputError(f"{place!r} lies behind a link")
            found = found[name]
        shape, dtype = tuple(found.shape or ()), np.dtype(found.dtype)
        step = max(1, _STEP_BYTES // max(1, math.prod(shape[1:]) * dtype.itemsize))
        if found.chunks:
            step = int(found.chunks[0])
            require_unpackable(_chunk_bytes(found), f"{place}: a chunk")
        filters = _filters(found)
        array = StoredArray(
            place, shape, dtype, step, partial(_block, place, found, step), found.id.get_storage_size
        )
        if found.is_virtual or found.external:
            raise array.refused("its values lie in other files; expected them in this file")
    if filters != [each for each in _FILTERS if each in filters] or {_DEFLATE, _LZF} <= {*filters}:
        named = ", ".join(_FILTERS.get(each, f"number {each}") for each in filters)
        raise array.refused(f"the filters {named}; expected {', '.join(_FILTERS.values())}, in this order")
    if dtype.kind not in "biufSU":
        raise array.refused(f"values of type {dtype}; expected numbers or text of a fixed length")
    return array


def _filters(dataset: H5Object) -> list[int]:
    properties = dataset.id.get_create_plist()
    return [properties.get_filter(number)[0] for number in range(properties.get_nfilters())]


def _chunk_bytes(dataset: H5Object) -> int:
    return int(math.prod(dataset.chunks) * dataset.dtype.itemsize)


def _block(place: str, dataset: H5Object, step: int, number: int) -> AnyArray:
    start, stop = number * step, min((number + 1) * step, dataset.shape[0])
    size = (stop - start, *dataset.shape[1:])
    require_unpackable(math.prod(size) * dataset.dtype.itemsize, f"{place}: {size} values")
    with in_words(place):
        if dataset.chunks and math.prod(size):
            for chunk in dataset.iter_chunks((slice(start, stop), *map(slice, size[1:]))):
                _require_chunk(place, dataset, tuple(each.start for each in chunk))
        found: AnyArray = dataset[start:stop]
    return found


def _require_chunk(place: str, dataset: H5Object, at: tuple[int, ...]) -> None:
    """Refuse a chunk that unpacks to more than its size, as HDF5 would allocate that."""
    filters, size = _filters(dataset), _chunk_bytes(dataset)
    stored = dataset.id.get_chunk_info_by_coord(at).size
    if stored > 2 * size + _SPARE_BYTES:
        raise InputError(f"{place!r}: a chunk of {stored:,} bytes; expected at most twice what it unpacks to")
    if stored and _LZF in filters:
        require_unpackable(_LZF_RATIO * stored, f"{place}: a chunk")
    if stored and _DEFLATE in filters:
        unused, packed = dataset.id.read_direct_chunk(at)
        is_packed = not unused >> filters.index(_DEFLATE) & 1
        if is_packed and len(zlib.decompressobj().decompress(packed, size + 1)) != size:
            raise InputError(f"{place!r}: a damaged chunk; expected {size:,} bytes unpacked")
