"""HDF5 of other programs as recordings: each group with a dataset of pictures at a given path is an episode.

Datasets below the group with a row for each picture are columns with the name of their path; attributes are
values. Only values in the file itself are read, with the filters of the library; links are not followed.
Metadata are checked before a value is read. A chunk is unpacked to its stated size and no further: HDF5 would
allocate whatever the packed bytes ask for.
"""

from __future__ import annotations

import math
import weakref
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from importlib import import_module
from itertools import islice
from typing import IO, Any

import numpy as np

from realtouch import touch_options
from realtouch.formats import picture_arrays, zarr_recordings
from realtouch.importing import source_files, source_touches
from tactile_toolkit import cache, errors, store, wording
from tactile_toolkit.array_types import AnyArray
from tactile_toolkit.columns import column_types, tables

H5Object = Any
"""A file, group or dataset of h5py, which has no types for type checkers."""
_DEFLATE, _LZF = 1, 32000

# Known filters, in the order in which they may occur. A dataset has at most one of gzip and lzf.
_FILTERS = {2: "shuffle", _DEFLATE: "gzip", _LZF: "lzf", 3: "fletcher32"}
_LZF_RATIO = 90  # of unpacked to packed bytes, at most
_SPARE_BYTES = 1 << 16
_STEP_BYTES = 4 << 20
_DAMAGE = (OSError, RuntimeError, ValueError, TypeError, LookupError, MemoryError, OverflowError, zlib.error)

_ENDINGS = (".h5", ".hdf5")
_MAX_OBJECTS, _DEEPEST = 20_000, 16
_MAX_NUMBERS, _MAX_LETTERS = 256, 1000  # of an attribute
_SHOWN, _PICTURE_AXES = 8, 4


@contextmanager
def in_words(address: str) -> Iterator[None]:
    """Turn errors of the library into InputError."""
    try:
        yield
    except _DAMAGE as error:
        raise errors.InputError(
            f"{address!r}: not an intact file of HDF5", next="write the file again"
        ) from error


def open_file(stream: IO[bytes]) -> H5Object:
    """Open an HDF5 file from a stream, which must stay open."""
    with errors.needs_extra("reading HDF5", "h5py", "hdf5"):
        return import_module("h5py").File(stream, "r")


def kind_of_member(group: H5Object, name: str) -> str:
    """Return the kind of a member of a group: ``Dataset``, ``Group``, or ``link`` to another place."""
    if type(group.get(name, getlink=True)).__name__ != "HardLink":
        return "link"
    return str(group.get(name, getclass=True).__name__)


def dataset_in(file: str, root: H5Object, path: str) -> picture_arrays.StoredArray:
    """Open a dataset by its path in the file, not through links; InputError if it cannot be used."""
    address = f"{file}/{path}"
    member = root
    with in_words(address):
        for name in path.split("/"):
            if kind_of_member(member, name) == "link":
                raise errors.InputError(f"{address!r} lies behind a link")
            member = member[name]
        shape = tuple(member.shape or ())
        dtype = np.dtype(member.dtype)
        step = max(1, _STEP_BYTES // max(1, math.prod(shape[1:]) * dtype.itemsize))
        if member.chunks:
            step = int(member.chunks[0])
            cache.require_unpackable(_chunk_bytes(member), f"{address}: a chunk")
        filters = _filters(member)
        array = picture_arrays.StoredArray(
            address, shape, dtype, step, partial(_block, address, member, step), member.id.get_storage_size
        )
        if member.is_virtual or member.external:
            raise array.refused("its values lie in other files; expected them in this file")
    if filters != [number for number in _FILTERS if number in filters] or {_DEFLATE, _LZF} <= {*filters}:
        named = ", ".join(_FILTERS.get(number, f"number {number}") for number in filters)
        raise array.refused(f"the filters {named}; expected {', '.join(_FILTERS.values())}, in this order")
    if dtype.kind not in "biufSU":
        raise array.refused(f"values of type {dtype}; expected numbers or text of a fixed length")
    return array


def _filters(dataset: H5Object) -> list[int]:
    properties = dataset.id.get_create_plist()
    return [properties.get_filter(number)[0] for number in range(properties.get_nfilters())]


def _chunk_bytes(dataset: H5Object) -> int:
    return int(math.prod(dataset.chunks) * dataset.dtype.itemsize)


def _block(address: str, dataset: H5Object, step: int, number: int) -> AnyArray:
    start = number * step
    stop = min((number + 1) * step, dataset.shape[0])
    size = (stop - start, *dataset.shape[1:])
    cache.require_unpackable(math.prod(size) * dataset.dtype.itemsize, f"{address}: {size} values")
    with in_words(address):
        if dataset.chunks and math.prod(size):
            for chunk in dataset.iter_chunks((slice(start, stop), *map(slice, size[1:]))):
                _require_chunk(address, dataset, tuple(part.start for part in chunk))
        values: AnyArray = dataset[start:stop]
    return values


def _require_chunk(address: str, dataset: H5Object, at: tuple[int, ...]) -> None:
    """Refuse a chunk that unpacks to more than its size, as HDF5 would allocate that."""
    filters, size = _filters(dataset), _chunk_bytes(dataset)
    stored = dataset.id.get_chunk_info_by_coord(at).size
    if stored > 2 * size + _SPARE_BYTES:
        raise errors.InputError(
            f"{address!r}: a chunk of {stored:,} bytes; expected at most twice what it unpacks to"
        )
    if stored and _LZF in filters:
        cache.require_unpackable(_LZF_RATIO * stored, f"{address}: a chunk")
    if stored and _DEFLATE in filters:
        unused, packed = dataset.id.read_direct_chunk(at)
        is_packed = not unused >> filters.index(_DEFLATE) & 1
        if is_packed and len(zlib.decompressobj().decompress(packed, size + 1)) != size:
            raise errors.InputError(f"{address!r}: a damaged chunk; expected {size:,} bytes unpacked")


def find_hdf5(
    home: store.DataFolder,
    columns: touch_options.ImportColumns,
    table: str | None,
    ledger: source_files.Ledger,
) -> Iterator[source_touches.Recording]:
    """Yield a recording for each group that has the dataset of pictures; InputError lists such datasets.

    Groups are in natural order: ``data/demo_2`` before ``data/demo_10``.
    """
    expected = f"HDF5 file; expected {' or '.join(_ENDINGS)}"
    home, names = source_files.files_to_read(
        home, expected, partial(source_files.visible_files, endings=_ENDINGS)
    )
    image = columns.image_name.strip("/")
    for name in names:
        address = home.address(name)
        with tables.open_source(home, name) as stream, in_words(address):
            root = open_file(stream)
            kinds = dict(islice(_members(address, root, "", _DEEPEST), _MAX_OBJECTS + 1))
            if len(kinds) > _MAX_OBJECTS:
                raise errors.InputError(f"{address!r}: more than {_MAX_OBJECTS:,} datasets and groups")
            for group in sorted(_groups(address, root, kinds, image), key=wording.natural_key):
                parts = [group.strip("/")]
                if len(names) > 1 or not group:
                    parts.insert(0, name.rpartition(".")[0])
                title = "/".join(filter(None, parts))
                yield _recording(home, name, root, kinds, (title, group, image), columns)


def _members(address: str, group: H5Object, path: str, deepest: int) -> Iterator[tuple[str, str]]:
    """Yield the path and kind of each member of a group and of the groups in it; links are not followed."""
    if not deepest:
        raise errors.InputError(f"{address!r}: more than {_DEEPEST} nested groups")
    for name in group:
        kind = kind_of_member(group, name)
        yield f"{path}{name}", kind
        if kind == "Group":
            yield from _members(address, group[name], f"{path}{name}/", deepest - 1)


def _groups(address: str, root: H5Object, kinds: dict[str, str], image: str) -> list[str]:
    """Return the paths of groups with a dataset of pictures; an InputError lists possible datasets."""
    datasets = [path for path, kind in kinds.items() if kind == "Dataset"]
    groups = [path.removesuffix(image) for path in datasets if f"/{path}".endswith(f"/{image}")]
    if not image or not groups:
        several = [path for path in datasets if len(root[path].shape or ()) == _PICTURE_AXES]
        shown = ", ".join(sorted(several, key=wording.natural_key)[:_SHOWN])
        content = f"no dataset of pictures {image!r}" if image else "datasets; none was named as the pictures"
        raise errors.InputError(
            f"{address!r} has {content}; found {shown or 'none'}",
            next="add --map image=PATH, with the path below the group of each episode: obs/tactile for "
            "data/demo_0/obs/tactile",
        )
    return groups


def _recording(
    home: store.DataFolder,
    path: str,
    root: H5Object,
    kinds: dict[str, str],
    named: tuple[str, str, str],
    columns: touch_options.ImportColumns,
) -> source_touches.Recording:
    title, group, image = named
    address = home.address(path)
    below = {member.removeprefix(group): kind for member, kind in kinds.items() if member.startswith(group)}
    inside = {
        member: partial(dataset_in, address, root, f"{group}{member}")
        for member, kind in below.items()
        if kind == "Dataset"
    }
    pictures = picture_arrays.PictureArray.of(inside.pop(image)())
    required = {source_files.NUMBERED, *columns.found_in(inside).names()}
    arrays, left_out = picture_arrays.columns_of(inside, len(pictures), required)
    per_frame = {member: column_types.column_of(values) for member, values in arrays.items()}
    left_out += [f"{member} (a link)" for member, kind in below.items() if kind == "link"]
    values: dict[str, object] = {}
    for member in dict.fromkeys(("/", f"/{group}")):
        for name, value in root[member].attrs.items():
            stated = np.asarray(value)
            is_text = isinstance(value, str) and len(value) <= _MAX_LETTERS
            if is_text or (stated.dtype.kind in "biuf" and stated.size <= _MAX_NUMBERS and stated.ndim < 2):
                values[name] = stated.tolist()
            else:
                left_out.append(f"attribute {name}")
    part = f"{pictures.divisor!r} {group}{image}"
    size = math.prod(pictures.shape[1:])
    about = (part, 0, len(pictures), size, values, per_frame)
    whole = source_touches.Recording(title, home.address(), path, *about, left_out=tuple(left_out))
    constant = zarr_recordings.of_episodes(whole, columns).intersection(required)
    return next(zarr_recordings.episodes_of(whole, np.array([len(pictures)]), [title], constant))


def _open_pictures(home: store.DataFolder, path: str, part: str) -> picture_arrays.PictureArray:
    divisor, name = part.split(" ", 1)
    with ExitStack() as closing, in_words(home.address(path)):
        root = open_file(closing.enter_context(tables.open_source(home, path)))
        array = dataset_in(home.address(path), root, name)
        weakref.finalize(array, closing.pop_all().close)
    return picture_arrays.PictureArray(array, float(divisor))


read_contents = partial(picture_arrays.read_contents, opened=_open_pictures)
describe_conversion = partial(picture_arrays.described_pictures, opened=_open_pictures)
