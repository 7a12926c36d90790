"""Objects to print: what a row of a data set becomes before it is written."""

from __future__ import annotations

import math
import re
import unicodedata
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.files import merge_equal_vertices
from tactile_toolkit.mesh.mesh import Mesh
from tactile_toolkit.wording import class_name

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tactile_toolkit.mesh.records import SolidRecord
    from tactile_toolkit.read.dataset import RecordDataset

__all__ = ["IdChoice", "PrintObject", "choose", "choose_rows", "parse_ids", "require_scale", "standing"]

_ID_DIGITS = 5  # file names sort as the ids do, up to 99,999
_UNSAFE = re.compile(r"[^\w+-]+")
_IDS = re.compile(r"(-?\d{1,20})(?:-(\d{1,20}))?", re.ASCII)

IdChoice: TypeAlias = Sequence[int | tuple[int, int]]
"""Ids, and first and last ids of ranges."""


@dataclass(frozen=True, slots=True)
class PrintObject:
    """One object to print, by a name that is unique and fit for a file: ``printed_test-7-00042``.

    Its split and the name of its class may be empty. ``load`` gives its triangles, each time that they are
    needed, so that a thousand objects take no more memory than one; picklable for worker processes.
    """

    name: str
    split: str
    label: str
    id: int
    load: Callable[[], Mesh | SolidRecord]


def standing(surface: Mesh | SolidRecord, scale: float = 1.0) -> Mesh:
    """Stand an object on the plate in the pose that it has: only its height above the plate changes.

    Corners with the very same coordinates are made one, as solids need it; ``scale`` is a factor on all
    lengths, about the origin.
    """
    vertices_m: NDArray[np.float64] = np.asarray(surface.vertices_m, np.float64) * scale
    faces = np.asarray(surface.faces, np.int32)
    # What names corners that are not there is left as it is: the check of the solid says so.
    if faces.size and faces.min() >= 0 and faces.max() < len(vertices_m):
        vertices_m, faces = merge_equal_vertices(vertices_m, faces)
    if len(vertices_m):
        vertices_m[:, 2] -= vertices_m[:, 2].min()
    return Mesh(vertices_m, faces)


def choose_rows(
    datasets: Iterable[tuple[str, RecordDataset[SolidRecord]]],
    *,
    ids: IdChoice | None = None,
    labels: Sequence[str] | None = None,
    limit: int | None = None,
) -> list[tuple[str, RecordDataset[SolidRecord], NDArray[np.int64]]]:
    """Choose rows of splits, each with its name; return those with their positions, in order.

    Only rows with these ``ids`` (a pair stands for all from its first to its last that are there), of these
    classes, and of what is left the first ``limit`` of each split. Raises InputError where an id or a class
    is not there, no id of a range is, or nothing is left.
    """
    ranges = None if ids is None else [entry if isinstance(entry, tuple) else (entry, entry) for entry in ids]
    seen = np.zeros(len(ranges or ()), bool)
    found = []
    for split, rows in datasets:
        wanted = np.ones(len(rows), bool)
        if ranges is not None:
            inside = [(rows.ids >= low) & (rows.ids <= high) for low, high in ranges]
            wanted = np.any(inside, axis=0)
            seen |= np.any(inside, axis=1)
        if labels is not None:
            classes = list(rows.label_names)
            unknown = [label for label in labels if label not in classes]
            if unknown:
                message = f"no class {unknown[0]!r} in split {split!r}; expected one of {', '.join(classes)}"
                raise InputError(message)
            wanted &= np.isin(rows.labels, [classes.index(label) for label in labels])
        found.append((split, rows, np.flatnonzero(wanted)[:limit]))
    missing = [pair for pair, there in zip(ranges or (), seen, strict=True) if not there]
    if missing:
        low, high = missing[0]
        what = f"id {low}" if low == high else f"an id from {low} to {high}"
        more = f" ({len(missing)} of the ids and ranges are not there)" if len(missing) > 1 else ""
        message = (
            f"no object with {what} in what was chosen{more}; next: look at the ids of the split, or name "
            "another --split"
        )
        raise InputError(message)
    if not any(len(chosen) for _, _, chosen in found):
        message = (
            "no object is chosen; expected rows of the split with the ids and classes that were asked for"
        )
        raise InputError(message)
    return found


def choose(
    datasets: Iterable[tuple[str, RecordDataset[SolidRecord]]],
    *,
    ids: IdChoice | None = None,
    labels: Sequence[str] | None = None,
    limit: int | None = None,
) -> list[PrintObject]:
    """Choose objects as :func:`choose_rows` does; no mesh is read.

    Raises InputError as there, and where an id stands twice in a split.
    """
    objects: list[PrintObject] = []
    for split, rows, chosen in choose_rows(datasets, ids=ids, labels=labels, limit=limit):
        classes = rows.label_names
        columns = (chosen.tolist(), rows.ids[chosen].tolist(), rows.labels[chosen].tolist())
        for row, number, label in zip(*columns, strict=True):
            word = class_name(classes, label)
            name = "-".join(part for part in (_safe(split), _safe(word), f"{number:0{_ID_DIGITS}d}") if part)
            objects.append(PrintObject(name, split, word, number, partial(rows.__getitem__, row)))
    names = Counter(item.name for item in objects)
    twice = next((name for name, count in names.items() if count > 1), None)
    if twice is not None:
        message = (
            f"two objects would be called {twice!r}: an id stands twice in a split; next: verify the data set"
        )
        raise InputError(message)
    return objects


def require_scale(scale: float) -> None:
    """Refuse a factor that is not a positive number."""
    if not (math.isfinite(scale) and scale > 0):
        message = f"--scale is {scale:g}; expected a positive number such as 1 or 0.5"
        raise InputError(message)


def _safe(word: str) -> str:
    # Splits and class names of other people's data sets may hold anything, a slash included. Letters of all
    # scripts stay, each in one form, as file systems differ in what they make of accents written apart.
    return _UNSAFE.sub("_", unicodedata.normalize("NFC", word))


def parse_ids(text: str) -> list[int | tuple[int, int]]:
    """Read ids such as ``3,17,40-60``: numbers, and first and last one of each range.

    Ranges stay ranges, as the ids of a split are scattered: most numbers of a range belong to no row. Raises
    InputError for another form.
    """
    numbers: list[int | tuple[int, int]] = []
    for part in text.split(","):
        match = _IDS.fullmatch(part.strip())
        low, high = (int(match[1]), int(match[2] or match[1])) if match is not None else (0, -1)
        if match is None or high < low:
            message = f"--ids has {part.strip()!r}; expected numbers and ranges such as 3,17,40-60"
            raise InputError(message)
        numbers.append(low if match[2] is None else (low, high))
    return numbers
