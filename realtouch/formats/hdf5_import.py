"""HDF5 as recordings: each group with a dataset of pictures at a given path is an episode.

Datasets below the group with a row for each picture are columns with the name of their path; attributes are
values. Links are not followed.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial
from itertools import islice

import numpy as np

from realtouch import importing
from realtouch.formats import hdf5_arrays, picture_arrays, zarr_recordings
from tactile_toolkit import errors, store
from tactile_toolkit.columns import column_types

_ENDINGS = (".h5", ".hdf5")
_MAX_OBJECTS, _DEEPEST = 20_000, 16
_MAX_NUMBERS, _MAX_LETTERS = 256, 1000  # of an attribute
_SHOWN, _PICTURE_AXES = 8, 4


def find_hdf5(
    home: store.DataFolder, columns: importing.ImportColumns, table: str | None
) -> Iterator[importing.Recording]:
    """Yield a recording for each group that has the dataset of pictures; InputError lists such datasets.

    Groups are in natural order: ``data/demo_2`` before ``data/demo_10``.
    """
    expected = f"HDF5 file; expected {' or '.join(_ENDINGS)}"
    home, names = importing.files_to_read(home, expected, partial(importing.visible_files, endings=_ENDINGS))
    image = columns.image_name.strip("/")
    for name in names:
        place = home.address(name)
        with importing.open_source(home, name) as stream, hdf5_arrays.in_words(place):
            root = hdf5_arrays.open_file(stream)
            kinds = dict(islice(_members(place, root, "", _DEEPEST), _MAX_OBJECTS + 1))
            if len(kinds) > _MAX_OBJECTS:
                raise errors.InputError(f"{place!r}: more than {_MAX_OBJECTS:,} datasets and groups")
            for group in sorted(_groups(place, root, kinds, image), key=importing.natural_order):
                parts = [group.strip("/")]
                if len(names) > 1 or not group:
                    parts.insert(0, name.rpartition(".")[0])
                title = "/".join(filter(None, parts))
                yield _recording(home, name, root, kinds, (title, group, image), columns)


def _members(place: str, group: hdf5_arrays.H5Object, path: str, deepest: int) -> Iterator[tuple[str, str]]:
    """Yield the path and kind of each member of a group and of the groups in it; links are not followed."""
    if not deepest:
        raise errors.InputError(f"{place!r}: more than {_DEEPEST} nested groups")
    for name in group:
        kind = hdf5_arrays.kind_of_member(group, name)
        yield f"{path}{name}", kind
        if kind == "Group":
            yield from _members(place, group[name], f"{path}{name}/", deepest - 1)


def _groups(place: str, root: hdf5_arrays.H5Object, kinds: dict[str, str], image: str) -> list[str]:
    """Return the paths of groups with a dataset of pictures; an InputError lists possible datasets."""
    datasets = [path for path, kind in kinds.items() if kind == "Dataset"]
    groups = [path.removesuffix(image) for path in datasets if f"/{path}".endswith(f"/{image}")]
    if not image or not groups:
        several = [path for path in datasets if len(root[path].shape or ()) == _PICTURE_AXES]
        shown = ", ".join(sorted(several, key=importing.natural_order)[:_SHOWN])
        wanted = f"no dataset of pictures {image!r}" if image else "datasets; none was named as the pictures"
        raise errors.InputError(
            f"{place!r} has {wanted}; found {shown or 'none'}",
            next="add --map image=PATH, with the path below the group of each episode: obs/tactile for "
            "data/demo_0/obs/tactile",
        )
    return groups


def _recording(
    home: store.DataFolder,
    path: str,
    root: hdf5_arrays.H5Object,
    kinds: dict[str, str],
    named: tuple[str, str, str],
    columns: importing.ImportColumns,
) -> importing.Recording:
    title, group, image = named
    place = home.address(path)
    below = {each.removeprefix(group): kind for each, kind in kinds.items() if each.startswith(group)}
    inside = {
        each: partial(hdf5_arrays.dataset_in, place, root, f"{group}{each}")
        for each, kind in below.items()
        if kind == "Dataset"
    }
    pictures = picture_arrays.PictureArray.of(inside.pop(image)())
    wanted = {importing.NUMBERED, *columns.found_in(inside).names()}
    found, left_out = picture_arrays.columns_of(inside, len(pictures), wanted)
    per_frame = {each: column_types.from_numpy(values) for each, values in found.items()}
    left_out += [f"{each} (a link)" for each, kind in below.items() if kind == "link"]
    values: dict[str, object] = {}
    for each in dict.fromkeys(("/", f"/{group}")):
        for name, value in root[each].attrs.items():
            stated = np.asarray(value)
            is_text = isinstance(value, str) and len(value) <= _MAX_LETTERS
            if is_text or (stated.dtype.kind in "biuf" and stated.size <= _MAX_NUMBERS and stated.ndim < 2):
                values[name] = stated.tolist()
            else:
                left_out.append(f"attribute {name}")
    part, size = f"{pictures.divisor!r} {group}{image}", math.prod(pictures.shape[1:])
    about = (part, 0, len(pictures), size, values, per_frame)
    whole = importing.Recording(title, home.address(), path, *about, left_out=tuple(left_out))
    constant = zarr_recordings.of_episodes(whole, columns).intersection(wanted)
    return next(zarr_recordings.episodes_of(whole, np.array([len(pictures)]), [title], constant))


def _open_pictures(home: str, path: str, part: str) -> picture_arrays.PictureArray:
    divisor, name = part.split(" ", 1)
    folder = store.open_folder(home)
    with ExitStack() as closing, hdf5_arrays.in_words(folder.address(path)):
        root = hdf5_arrays.open_file(closing.enter_context(importing.open_source(folder, path)))
        array = hdf5_arrays.dataset_in(folder.address(path), root, name)
        weakref.finalize(array, closing.pop_all().close)
    return picture_arrays.PictureArray(array, float(divisor))


read_frames = partial(picture_arrays.read_pictures, opened=_open_pictures)
describe_conversion = partial(picture_arrays.described_pictures, opened=_open_pictures)
