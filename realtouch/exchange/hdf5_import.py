"""HDF5 as recordings: each group with a dataset of pictures at a given path is an episode.

Datasets below the group with a row a picture are columns by their paths; attributes are values. Nothing is
opened through a link.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Any

import numpy as np

from realtouch.exchange.fields import NUMBERED
from realtouch.exchange.found_touches import FoundTouch, natural_order, open_source, source_of, visible_files
from realtouch.exchange.hdf5_arrays import H5Dataset, in_words, is_inside, open_file
from realtouch.exchange.picture_arrays import PictureArray, columns_of, described_pictures, encoded_pictures
from realtouch.exchange.recordings import Recording
from realtouch.exchange.zarr_recordings import episodes_of, of_episodes
from realtouch.touch_options import ImportColumns
from tactile_toolkit import store
from tactile_toolkit.errors import InputError, ItemError

_ENDINGS = (".h5", ".hdf5")
_MOST_OBJECTS, _DEEPEST = 20_000, 16
_MOST_NUMBERS, _MOST_LETTERS = 256, 1000  # of an attribute
_SHOWN, _PICTURE_AXES = 8, 4


def find_hdf5(home: store.DataFolder, columns: ImportColumns, table: str | None) -> Iterator[Recording]:
    """Yield a recording for each group that has the dataset of pictures; InputError lists such datasets."""
    names = visible_files(home, _ENDINGS)
    if (home.info("") or {}).get("type") == "file":
        home, name = source_of(home.address())
        names = [name]
    if not names:
        raise InputError(f"{home.address()!r} holds no file of HDF5; expected {' or '.join(_ENDINGS)}")
    for name in names:
        stem = name.rpartition(".")[0] if len(names) > 1 else ""
        with open_source(home, name) as stream, in_words(home.address(name)):
            yield from _File(home, name, stem, open_file(stream)).recordings(columns)


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
            if not is_inside(group, name):
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
            wanted = (
                f"no dataset of pictures {image!r}" if image else "datasets; none was named as the pictures"
            )
            raise InputError(
                f"{self.place!r} has {wanted}; found {', '.join(shown) or 'none'}",
                next="add --map image=PATH, with the path below the group of each episode: obs/tactile for "
                "data/demo_0/obs/tactile",
            )
        for group in sorted(groups, key=natural_order):
            yield self._recording(group, image, columns)

    def _recording(self, group: str, image: str, columns: ImportColumns) -> Recording:
        inside = {
            path.removeprefix(group): partial(H5Dataset, self.place, each)
            for path, each in self.datasets.items()
            if path.startswith(group)
        }
        pictures = PictureArray.of(inside.pop(image)())
        wanted = {NUMBERED, *columns.found_in(inside).names()}
        per_frame, left_out = columns_of(inside, len(pictures), wanted)
        left_out += [each.removeprefix(group) for each in self.left_out if each.startswith(group)]
        values: dict[str, object] = {}
        for each in dict.fromkeys(("", group)):
            left_out += _add_attributes(self.groups[each], values)
        name = "/".join(filter(None, (self.prefix, group.strip("/")))) or self.path.rpartition(".")[0]
        part, size = f"{pictures.divisor!r} {group}{image}", math.prod(pictures.shape[1:])
        about = (part, 0, len(pictures), size, values, per_frame)
        whole = Recording(name, self.home.address(), self.path, *about, left_out=tuple(left_out))
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
    with ExitStack() as closing, in_words(place):
        found = open_file(closing.enter_context(open_source(home, item.path)))
        for name in path.split("/"):
            if not is_inside(found, name):
                raise InputError(f"{place!r}: {path!r} lies behind a link now")
            found = found[name]
        array = H5Dataset(place, found)
        weakref.finalize(array, closing.pop_all().close)
    return PictureArray(array, float(divisor))


def describe_conversion(items: Sequence[FoundTouch]) -> str:
    """Return what is done to the pictures of a file; empty if they are taken as they are."""
    return described_pictures(items, open_pictures)


def encoded_frames(items: Iterable[FoundTouch]) -> Iterator[bytes | ItemError]:
    """Yield each picture of some items in order, images as PNG, those of clips as JPEG."""
    return encoded_pictures(items, open_pictures)
