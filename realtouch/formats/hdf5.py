"""HDF5 of other programs as recordings: each group with a dataset of pictures at a given path is an episode.

Datasets below the group with a row for each picture are columns with the name of their path; attributes are
values. Only values in the file itself are read, with the filters of the library; links are not followed.
Metadata are checked before a value is read. A chunk is unpacked to its stated size and no further: HDF5 would
allocate whatever the packed bytes ask for.
"""

from __future__ import annotations

import io
import math
import weakref
import zlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from functools import lru_cache, partial
from importlib import import_module
from itertools import islice
from typing import IO, Any

import numpy as np

from realtouch.formats import picture_arrays, zarr_recordings
from realtouch.importing import import_options, source_files, source_touches
from tactile_toolkit import cache, errors, store, touch, wording
from tactile_toolkit.columns import tables
from tactile_toolkit.value_types import AnyArray

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
_REFERENCE = np.dtype([("size", "<u4"), ("address", "<u8"), ("number", "<u4")])
_HEAP_MARK = b"GCOL\x01"
_HEAP_HEADER, _HEAP_ALIGNMENT = 16, 8  # bytes, of a heap and of each object in it
_MAX_HEAP_OBJECTS = 1 << 16
_MASKS = "mask/"
_SPLITS = ("train", "valid", "val", "validation", "test")


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


class _HeapRows:
    """Rows of bytes of any length: a dataset of references to heaps of the file.

    The references and heaps are parsed here. HDF5 would allocate whatever a reference states.
    """

    def __init__(self, address: str, dataset: H5Object, stream: IO[bytes]) -> None:
        self._stream = stream
        self._file_bytes = stream.seek(0, io.SEEK_END)
        self._base = dataset.file.userblock_size
        self._heap = lru_cache(4)(self._objects)
        sizes = dataset.file.id.get_create_plist().get_sizes()
        if len(dataset.shape) != 1 or sizes != (8, 8) or _filters(dataset):
            raise errors.InputError(
                f"{address!r}: rows of bytes {dataset.shape}, compressed or with short addresses; expected "
                "one row for each picture",
                next="write it again, by `h5repack -f NONE FILE NEW`",
            )
        self.count = count = int(dataset.shape[0])
        parts = [(0, dataset.id.get_offset())]
        step = count
        if dataset.chunks:
            step = int(dataset.chunks[0])
            chunks = map(dataset.id.get_chunk_info, range(dataset.id.get_num_chunks()))
            parts = [(int(chunk.chunk_offset[0]), chunk.byte_offset) for chunk in chunks]
        cache.require_unpackable(count * _REFERENCE.itemsize, f"{address}: {count:,} rows")
        self._references = np.zeros(count, _REFERENCE)
        for start, offset in parts:
            rows = self._references[start : start + step]
            if offset is not None:
                read = np.frombuffer(self._read(offset, rows.nbytes), _REFERENCE)
                rows[: len(read)] = read
        self.mean_bytes = int(self._references["size"].mean(dtype=np.float64)) if count else 0

    def row(self, number: int) -> bytes:
        """Return the bytes of a row; ItemError if it has none, or too many."""
        size, at, index = self._references[number].tolist()
        start, stored = self._heap(at).get(index, (0, -1)) if size else (0, -1)
        if size != stored or size > touch.MAX_IMAGE_BYTES:
            raise errors.ItemError(
                "missing", f"row {number:,} holds no bytes, or too many; expected a picture"
            )
        return self._read(start, size)

    def _read(self, at: int, size: int) -> bytes:
        """Return bytes of the file; fewer at its end, none beyond it."""
        if at >= self._file_bytes:
            return b""
        self._stream.seek(at)
        return self._stream.read(size)

    def _objects(self, address: int) -> dict[int, tuple[int, int]]:
        """Return offset and size of each object of a heap, by its number; empty if it is damaged."""
        objects: dict[int, tuple[int, int]] = {}
        start = self._base + address
        header = self._read(start, _HEAP_HEADER)
        if not header.startswith(_HEAP_MARK):
            return objects
        at = _HEAP_HEADER
        end = int.from_bytes(header[8:16], "little")
        while at < end and len(objects) < _MAX_HEAP_OBJECTS:
            header = self._read(start + at, _HEAP_HEADER)
            number = int.from_bytes(header[:2], "little")
            size = int.from_bytes(header[8:16], "little")
            if not number:  # the rest is free
                break
            at += _HEAP_HEADER
            objects[number] = (start + at, size)
            at += size + -size % _HEAP_ALIGNMENT
        return objects


def _is_of_bytes(dataset: H5Object) -> bool:
    """Return whether rows may be encoded pictures: bytes of any length, text, or rows of 8 bits."""
    dtype = dataset.dtype
    axes = len(dataset.shape or ())
    if axes == 1 and dtype.kind == "O":
        h5py = import_module("h5py")
        return h5py.check_vlen_dtype(dtype) == np.uint8 or h5py.check_string_dtype(dtype) is not None
    return (axes == 1 and dtype.kind == "S") or (axes == 2 and dtype == np.uint8)


def _pictures_in(address: str, root: H5Object, path: str, stream: IO[bytes]) -> picture_arrays.Pictures:
    """Return the pictures of a dataset: pixels, or encoded ones; InputError if it holds none."""
    if not _is_of_bytes(root[path]):
        return picture_arrays.PictureArray.of(dataset_in(address, root, path))
    if root[path].dtype.kind == "O":
        rows = _HeapRows(address, root[path], stream)
        return picture_arrays.EncodedPictures(address, rows.count, rows.mean_bytes, rows.row).checked()
    array = dataset_in(address, root, path)
    block = lru_cache(1)(array.block)

    def read(number: int) -> bytes:
        index, row = divmod(number, array.step)
        content: bytes = block(index)[row].tobytes()
        return content.rstrip(b"\0")  # shorter pictures are padded

    width = math.prod(array.shape[1:]) * array.dtype.itemsize
    return picture_arrays.EncodedPictures(address, array.shape[0], width, read).checked()


def find_hdf5(
    home: store.DataFolder,
    columns: import_options.ImportColumns,
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
            groups = sorted(_groups(address, root, kinds, image), key=wording.natural_key)
            splits = _splits_of(address, root, kinds, groups, ledger)
            for group in groups:
                parts = [group.strip("/")]
                if len(names) > 1 or not group:
                    parts.insert(0, name.rpartition(".")[0])
                title = "/".join(filter(None, parts))
                pictures = _pictures_in(address, root, f"{group}{image}", stream)
                recording = _recording(home, name, root, kinds, (title, group, image), columns, pictures)
                if group in splits and columns.split is None:
                    recording = replace(recording, values={"split": splits[group], **recording.values})
                yield recording


def _splits_of(
    address: str, root: H5Object, kinds: dict[str, str], groups: Sequence[str], ledger: source_files.Ledger
) -> dict[str, str]:
    """Return the split of each episode, by its group, as masks of robomimic state it: lists of their names.

    Masks are splits if they have the names of splits and each episode is in one of them. Everything else
    outside the episodes is noted as left out.
    """
    outside = [path for path, kind in kinds.items() if kind != "Group" and not path.startswith(tuple(groups))]
    of_name: dict[str, list[str]] = {}
    known = [f"{_MASKS}{split}" for split in _SPLITS]
    for path in [path for path in known if kinds.get(path) == "Dataset"]:
        with suppress(errors.InputError):
            for name in dataset_in(address, root, path).rows().reshape(-1):
                text = name.decode(errors="replace") if isinstance(name, bytes) else str(name)
                of_name.setdefault(text, []).append(path)
    masks = [of_name.get(group.strip("/").rpartition("/")[2], []) for group in groups]
    are_splits = all(len(paths) == 1 for paths in masks)
    splits = {}
    if are_splits:
        splits = {group: paths[0].removeprefix(_MASKS) for group, paths in zip(groups, masks, strict=True)}
    for path in outside:
        if are_splits and path in known:
            continue
        reason = "outside the episodes"
        if path.startswith(_MASKS):
            reason = "a mask; masks called train, valid or test are splits if each episode is in one"
        ledger.left_out[f"{path} ({reason})"] = None
    return splits


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
        several = [
            path
            for path in datasets
            if len(root[path].shape or ()) == _PICTURE_AXES or _is_of_bytes(root[path])
        ]
        advice = (
            "PATH, with the path below the group of each episode: obs/tactile for data/demo_0/obs/tactile"
        )
        if len(several) == 1:
            advice = several[0]
        shown = ", ".join(sorted(several, key=wording.natural_key)[:_SHOWN])
        content = f"no dataset of pictures {image!r}" if image else "datasets; none was named as the pictures"
        raise errors.InputError(
            f"{address!r} has {content}; found {shown or 'none'}",
            next=f"add --map image={advice}",
        )
    return groups


def _recording(
    home: store.DataFolder,
    path: str,
    root: H5Object,
    kinds: dict[str, str],
    named: tuple[str, str, str],
    columns: import_options.ImportColumns,
    pictures: picture_arrays.Pictures,
) -> source_touches.Recording:
    title, group, image = named
    address = home.address(path)
    below = {member.removeprefix(group): kind for member, kind in kinds.items() if member.startswith(group)}
    inside = {
        member: partial(dataset_in, address, root, f"{group}{member}")
        for member, kind in below.items()
        if kind == "Dataset"
    }
    inside.pop(image)
    per_frame, left_out = picture_arrays.columns_of(inside, len(pictures), columns)
    left_out += [f"{member} (a link)" for member, kind in below.items() if kind == "link"]
    values: dict[str, object] = {}
    parts = group.split("/")
    for member in dict.fromkeys(("/", *("/".join(parts[:depth]) for depth in range(1, len(parts))))):
        for name, value in root[member].attrs.items():
            stated = np.asarray(value)
            is_text = isinstance(value, str) and len(value) <= _MAX_LETTERS
            if is_text or (stated.dtype.kind in "biuf" and stated.size <= _MAX_NUMBERS and stated.ndim < 2):
                values[name] = stated.tolist()
            else:
                left_out.append(f"attribute {name}")
    divisor = pictures.divisor if isinstance(pictures, picture_arrays.PictureArray) else ""
    about = (f"{divisor} {group}{image}", 0, len(pictures), pictures.picture_bytes, values, per_frame)
    whole = source_touches.Recording(
        title, home.address(), path, *about, left_out=tuple(left_out), conversions=pictures.conversions
    )
    constant = zarr_recordings.episode_columns(whole, columns)
    return next(zarr_recordings.split_episodes(whole, np.array([len(pictures)]), [title], constant))


def _open_pictures(home: store.DataFolder, path: str, part: str) -> picture_arrays.Pictures:
    divisor, name = part.split(" ", 1)
    address = home.address(path)
    pictures: picture_arrays.Pictures
    with ExitStack() as closing, in_words(address):
        stream = closing.enter_context(tables.open_source(home, path))
        root = open_file(stream)
        if divisor:
            pictures = picture_arrays.PictureArray(dataset_in(address, root, name), float(divisor))
        else:
            pictures = _pictures_in(address, root, name, stream)
        weakref.finalize(pictures, closing.pop_all().close)
    return pictures


read_contents = partial(picture_arrays.read_contents, opened=_open_pictures)
