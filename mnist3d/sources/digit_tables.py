"""Digits of 28 x 28 pixels in tables and arrays, as data sets like MNIST are shared: CSV, NPY and NPZ."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from mnist3d.ink.grey_levels import as_grey
from mnist3d.sources.digit_arrays import SIDE_PX, Part, SmallImages, int_column, open_npy, scale_of
from tactile_toolkit import cache, store
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.value_types import AnyArray
from tactile_toolkit.wording import with_count

_PIXELS = SIDE_PX**2
_HEADER_BYTES = 1 << 16
_SEPARATORS = (",", ";", "\t")
# Words by which the names of images and of their labels differ: `x_train` and `y_train`.
_PAIR_WORDS = re.compile(r"images?|imgs?|labels?|targets?|data|[xy](?![a-z])", re.IGNORECASE)
_TABLES = (
    "a CSV table of a label and 784 pixels, or arrays of NumPy (NPY, NPZ) of shape (N, 28, 28) or (N, 784)"
)


@dataclass(frozen=True, slots=True)
class TableSource(SmallImages):
    """Tables and arrays of light digits on black, 28 x 28 pixels, as those of MNIST.

    A row of a CSV table is a digit: its label, in the column ``label`` or, without a header, in the first
    column, and 784 pixels from 0 to 255, row by row. Arrays have the shape (N, 28, 28), (N, 28, 28, 1) or
    (N, 784), integers from 0 to 255, or floats from 0 to 1 or 255. Their labels are the array of N digits in
    the same archive or folder; of several, the one whose name differs only in a word, as ``y_train`` from
    ``x_train`` or ``labels`` from ``images``.

    Parameters
    ----------
    root : str
        A table, an archive, or a folder of them. Files of other content are left out; :meth:`fingerprint`
        names them.

    Notes
    -----
    Ids count from 0 through the files by name, then through their rows. Writers are unknown.
    """

    name: ClassVar[str] = "table"
    """Word that selects this source on the command line."""

    def fingerprint(self) -> dict[str, object]:
        """Return count and SHA-256 of images and labels of each table, and the files that are left out.

        Raises InputError as :meth:`catalog` does.
        """
        facts = SmallImages.fingerprint(self)
        left_out = self._content().left_out
        if left_out:
            facts["left_out"] = dict(left_out)
        return facts

    def _parts(self) -> list[Part]:
        return list(self._content().parts)

    def _content(self) -> _Content:
        path = store.expanded(self.root)
        if not store.path_exists(path):
            raise InputError(f"{path} does not exist, expected {_TABLES}", next="check the path")
        files = [path]
        folders: list[str] = []
        if path.is_dir():
            files = store.list_files(path)
            folders = sorted(inner.name for inner in path.iterdir() if inner.is_dir())
        stamps = tuple(file.stat().st_mtime_ns for file in files)
        return _read(path, tuple(files), tuple(folders), stamps)


class _Content(NamedTuple):
    parts: tuple[Part, ...]
    left_out: tuple[tuple[str, str], ...]
    """Names of other files, and why they are left out."""


@lru_cache(maxsize=4)
def _read(
    root: Path, files: tuple[Path, ...], folders: tuple[str, ...], _stamps: tuple[int, ...]
) -> _Content:
    parts: list[Part] = []
    arrays: dict[str, AnyArray] = {}
    left_out = [(name, "a folder") for name in folders if not store.is_hidden(name)]
    for file in files:
        ending = file.suffix.lower()
        if "emnist" in file.name.lower():
            raise InputError(
                f"{file} is of EMNIST, whose images have rows and columns exchanged; expected upright digits",
                next="exchange them, by images.reshape(-1, 28, 28).transpose(0, 2, 1), and save them under "
                "another name",
            )
        problem = "not a table or array"
        if ending == ".csv":
            table = _read_csv(file)
            problem = f"{with_count(table.shape[1], 'columns')}, but no row of a label and 784 pixels"
            if len(table):
                parts.append(_part(table[:, 1:], table[:, 0], str(file)))
                continue
        elif ending in (".npy", ".npz"):
            arrays |= dict(_read_arrays(file))
            continue
        left_out.append((file.name, problem))
    pairs = _pairs(arrays, root)
    parts += [_part(arrays[name], arrays[label], f"{root}: {name}") for name, label in pairs.items()]
    unused = sorted(arrays.keys() - pairs.keys() - set(pairs.values()))
    left_out += [(name, "neither digits nor their labels") for name in unused]
    if not parts:
        content = "; ".join(f"{name}: {problem}" for name, problem in left_out[:8]) or "nothing"
        raise InputError(
            f"{root}: found no digits ({content}), expected {_TABLES}",
            next="check the path; --source folder reads pictures, --source mnist the IDX files of MNIST",
        )
    return _Content(tuple(parts), tuple(left_out))


def _part(images: AnyArray, labels: AnyArray, where: str) -> Part:
    """Check images and labels of one length."""
    digits = int_column(labels.reshape(len(labels), -1), 0, where, 9).astype(np.uint8)
    try:
        levels = as_grey(images.reshape(-1, SIDE_PX, SIDE_PX), scale_of(images), where)
    except ItemError as error:
        raise InputError(error.what, next="repair or rescale the images in the file") from error
    return levels, digits


def _read_csv(path: Path) -> AnyArray:
    """Return the numbers of a table, uint8, shape (rows, columns), the label first."""
    try:
        with store.open_regular(path) as stream:
            cache.require_unpackable(stream.seek(0, io.SEEK_END), str(path))
            stream.seek(0)
            names = stream.readline(_HEADER_BYTES).decode("utf-8-sig").strip().lower()
            separator = max(_SEPARATORS, key=names.count)
            columns = [name.strip().strip('"') for name in names.split(separator)]
            is_header = not all(map(str.isdecimal, columns))
            if len(columns) != 1 + _PIXELS or (is_header and not stream.read(3).strip()):
                return np.empty((0, len(columns)), np.uint8)
            if is_header and "label" not in columns:
                raise InputError(
                    f"{path}: no column is called 'label'; expected one",
                    next="rename the column of labels",
                )
            stream.seek(0)
            text = io.TextIOWrapper(stream, "utf-8-sig")
            # The reader of tables would hold each of 784 columns as text.
            table = np.loadtxt(
                text,
                np.uint8,
                delimiter=separator,
                skiprows=int(is_header),
                comments=None,
                quotechar='"',
                ndmin=2,
            )
        if table.shape[1] != len(columns):
            raise ValueError(f"rows of {with_count(table.shape[1], 'values')}")
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path} cannot be read as a table ({error}); expected numbers from 0 to 255",
            next="check this row, or save the table as CSV in UTF-8 again",
        ) from error
    label = columns.index("label") if is_header else 0
    return np.concatenate([table[:, label : label + 1], np.delete(table, label, axis=1)], axis=1)


def _read_arrays(path: Path) -> Iterator[tuple[str, AnyArray]]:
    """Yield the arrays of a file of NumPy with their names; pickled objects are refused."""
    if path.suffix.lower() == ".npy":
        yield path.name, open_npy(str(path))
        return
    try:
        with store.open_regular(path) as stream, zipfile.ZipFile(stream) as archive:
            cache.require_plain_archive(archive)
            for entry in archive.infolist():
                cache.require_unpackable(entry.file_size, f"{path}: {entry.filename}", entry.compress_size)
                with archive.open(entry) as member:
                    yield f"{path.name}/{entry.filename}", np.lib.format.read_array(member)
    except InputError:
        raise
    except Exception as error:  # a damaged archive or header raises many types
        raise InputError(
            f"{path}: cannot be read ({error}), expected an intact .npz file of numbers, as numpy.savez "
            "writes it",
            next="download or copy it again",
        ) from error


def _pairs(arrays: dict[str, AnyArray], root: Path) -> dict[str, str]:
    """Return the name of the labels for the name of each array of digits."""
    pairs: dict[str, str] = {}
    images = {name: array for name, array in arrays.items() if array.size and _is_images(array.shape)}
    labels = {
        name: array for name, array in arrays.items() if array.shape in ((array.size,), (array.size, 1))
    }
    for name, array in images.items():
        matches = [label for label in labels if len(labels[label]) == len(array)]
        if len(matches) > 1:
            key = _PAIR_WORDS.sub("", name)
            matches = [label for label in matches if _PAIR_WORDS.sub("", label) == key]
        if len(matches) != 1:
            shapes = ", ".join(f"{stored} {arrays[stored].shape}" for stored in arrays)
            raise InputError(
                f"{root}: {with_count(len(matches), 'arrays')} can be the labels of {name!r}; expected "
                f"one of {len(array):,} digits (found {shapes})",
                next="save images and labels together, by numpy.savez('digits.npz', images=..., labels=...)",
            )
        pairs[name] = matches[0]
    return pairs


def _is_images(shape: tuple[int, ...]) -> bool:
    return shape[1:] in ((SIDE_PX, SIDE_PX), (SIDE_PX, SIDE_PX, 1), (_PIXELS,))
