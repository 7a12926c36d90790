"""HDF5 as recordings: each group with a dataset of pictures at a given path is an episode.

Datasets below the group with a row a picture are columns by their paths; attributes are values. Nothing is
opened through a link or from another file, nor by filters other than those of HDF5 and h5py itself.
"""

from __future__ import annotations

import math
import weakref
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from importlib import import_module
from typing import IO, Any

import numpy as np

from realtouch.exchange.fields import NUMBERED
from realtouch.exchange.found_touches import FoundTouch, natural_order, open_source, source_of, visible_files
from realtouch.exchange.picture_arrays import PictureArray, columns_of, encoded_pictures
from realtouch.exchange.recordings import Recording
from realtouch.exchange.zarr_recordings import episodes_of, of_episodes
from realtouch.touch_options import ImportColumns
from tactile_toolkit import store
from tactile_toolkit.array_types import AnyArray
from tactile_toolkit.bounds import require_unpackable
from tactile_toolkit.errors import InputError, ItemError, needs_extra

ENDINGS = (".h5", ".hdf5")
_DEFLATE, _LZF = 1, 32000
# Filters that are known, in the order in which they may stand.
_FILTERS = {2: "shuffle", _DEFLATE: "gzip", _LZF: "lzf", 3: "fletcher32"}
_LZF_RATIO = 90  # of unpacked to packed bytes, at most
_SPARE_BYTES = 1 << 16
_STEP_BYTES = 4 << 20
_MOST_OBJECTS = 20_000
_MOST_NUMBERS, _MOST_LETTERS = 256, 1000  # of an attribute
_SHOWN = 8
_PICTURE_AXES = 4
_DEEPEST = 16
_DAMAGE = (OSError, RuntimeError, ValueError, TypeError, LookupError, MemoryError, zlib.error)


class _Dataset:
    """A dataset whose metadata were checked; see :class:`realtouch.exchange.picture_arrays.StoredArray`."""

    def __init__(self, place: str, dataset: Any) -> None:
        self.place = f"{place}{dataset.name}"
        self.dataset = dataset
        with _in_words(self.place):
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
        with _in_words(self.place):
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
            mask, packed = self.dataset.id.read_direct_chunk(at)
            size = self._chunk_bytes
            if not mask:
                size = len(zlib.decompressobj().decompress(packed, size + 1))
            if size != self._chunk_bytes:
                raise self.refused(f"a damaged chunk; expected {self._chunk_bytes:,} bytes unpacked")


@contextmanager
def _in_words(place: str) -> Iterator[None]:
    """Turn errors of the library into InputError."""
    try:
        yield
    except _DAMAGE as error:
        raise InputError(f"{place!r}: not an intact file of HDF5", next="write the file again") from error


def _opened(stream: IO[bytes]) -> Any:
    """Open a file of HDF5 from a stream, which must stay open."""
    with needs_extra("reading HDF5", "h5py", "hdf5"):
        return import_module("h5py").File(stream, "r")


def find_hdf5(home: store.DataFolder, columns: ImportColumns, table: str | None) -> Iterator[Recording]:
    """Yield a recording for each group that has the dataset of pictures; InputError lists such datasets."""
    names = visible_files(home, ENDINGS)
    if home.address().lower().endswith(ENDINGS) and not names:
        home, name = source_of(home.address())
        names = [name]
    if not names:
        raise InputError(f"{home.address()!r} holds no file of HDF5; expected {' or '.join(ENDINGS)}")
    for name in names:
        stem = name.rpartition(".")[0] if len(names) > 1 else ""
        with open_source(home, name) as stream, _in_words(home.address(name)):
            yield from _File(home, name, stem, _opened(stream)).recordings(columns)


def _is_inside(group: Any, name: str) -> bool:
    """Return whether a member of a group is in it, and not a link to another place or file."""
    return type(group.get(name, getlink=True)).__name__ == "HardLink"


class _File:
    """What a file holds: datasets and groups by path, without those behind links."""

    def __init__(self, home: store.DataFolder, path: str, prefix: str, root: Any) -> None:
        self.home, self.path, self.place = home, path, home.address(path)
        self.prefix = prefix
        self.datasets: dict[str, Any] = {}
        self.groups: dict[str, Any] = {}
        self.left_out: list[str] = []
        self._look(root, "", _DEEPEST)

    def _look(self, group: Any, path: str, deepest: int) -> None:
        self.groups[path] = group
        for name in group:
            if len(self.datasets) + len(self.groups) > _MOST_OBJECTS or not deepest:
                most = f"{_MOST_OBJECTS:,} datasets and groups, or {_DEEPEST} groups in each other"
                raise InputError(f"{self.place!r}: more than {most}")
            below = f"{path}{name}"
            if not _is_inside(group, name):
                self.left_out.append(f"{below} (a link)")
            elif group.get(name, getclass=True).__name__ == "Group":
                self._look(group[name], f"{below}/", deepest - 1)
            elif group.get(name, getclass=True).__name__ == "Dataset":
                self.datasets[below] = group[name]

    def recordings(self, columns: ImportColumns) -> Iterator[Recording]:
        """Yield the episodes in natural order: of ``data/demo_2`` before ``data/demo_10``."""
        image = columns.image_name.strip("/")
        groups = [path.removesuffix(image) for path in self.datasets if f"/{path}".endswith(f"/{image}")]
        if not image or not groups:
            several = {path for path, each in self.datasets.items() if len(each.shape or ()) == _PICTURE_AXES}
            shown = sorted(several, key=natural_order)[:_SHOWN]
            raise InputError(
                f"{self.place!r} has no dataset of pictures {image!r}; found {', '.join(shown) or 'none'}",
                next="name it with --map image=PATH, below the file or below the group of each episode",
            )
        for group in sorted(groups, key=natural_order):
            yield self._recording(group, image, columns)

    def _recording(self, group: str, image: str, columns: ImportColumns) -> Recording:
        inside = {
            path.removeprefix(group): each for path, each in self.datasets.items() if path.startswith(group)
        }
        pictures = PictureArray.of(_Dataset(self.place, inside.pop(image)))
        arrays: dict[str, _Dataset] = {}
        left_out = [each for each in self.left_out if each.startswith(group)]
        wanted = {NUMBERED, *columns.found_in(inside).names()}
        for name, dataset in inside.items():
            try:
                arrays[name] = _Dataset(self.place, dataset)
            except InputError as error:
                if name in wanted:
                    raise
                left_out.append(f"{name} ({error.what})")
        per_frame, others = columns_of(arrays, len(pictures), wanted)
        values: dict[str, object] = {}
        for each in {"": None, group: None}:
            left_out += _add_attributes(self.groups[each], values)
        name = "/".join(filter(None, (self.prefix, group.strip("/")))) or self.path.rpartition(".")[0]
        whole = Recording(
            name,
            self.home.address(),
            self.path,
            f"{pictures.divisor!r} {group}{image}",
            0,
            len(pictures),
            math.prod(pictures.shape[1:]),
            values,
            per_frame,
            left_out=(*left_out, *others),
        )
        constant = of_episodes(whole, columns).intersection(wanted)
        return next(episodes_of(whole, np.array([len(pictures)]), [name], constant))


def _add_attributes(group: Any, values: dict[str, object]) -> list[str]:
    """Add the attributes of a group that are texts or few numbers; return the names of all others."""
    left_out = []
    for name in group.attrs:
        value = group.attrs[name]
        found = np.asarray(value)
        if isinstance(value, str) and len(value) <= _MOST_LETTERS:
            values[name] = value
        elif found.dtype.kind in "biuf" and found.size <= _MOST_NUMBERS and found.ndim < 2:
            values[name] = found.tolist()
        else:
            left_out.append(f"attribute {name}")
    return left_out


def open_pictures(item: FoundTouch) -> PictureArray:
    """Open the pictures that an item is one of."""
    divisor, path = item.part.split(" ", 1)
    home = store.open_folder(item.home)
    place = home.address(item.path)
    with ExitStack() as closing, _in_words(place):
        found = _opened(closing.enter_context(open_source(home, item.path)))
        for name in path.split("/"):
            if not _is_inside(found, name):
                raise InputError(f"{place!r}: {path!r} lies behind a link now")
            found = found[name]
        array = _Dataset(place, found)
        weakref.finalize(array, closing.pop_all().close)
    return PictureArray(array, float(divisor))


def describe_conversion(items: Sequence[FoundTouch]) -> str:
    """Return what is done to the pictures of a file; empty if they are taken as they are."""
    return open_pictures(items[0]).described()


def encoded_frames(items: Iterable[FoundTouch]) -> Iterator[bytes | ItemError]:
    """Yield the pixels of each picture of some items as PNG, in order."""
    return encoded_pictures(items, open_pictures)
