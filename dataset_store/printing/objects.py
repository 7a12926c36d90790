"""Objects to print: what a row of a data set becomes before it is written."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from dataset_store.errors import InputError
from dataset_store.mesh import Mesh
from dataset_store.meshfile import merge_equal_vertices

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from dataset_store.mesh_records import SolidRecord
    from dataset_store.records import RecordDataset

__all__ = ["PrintObject", "Surface", "choose", "parse_ids", "require_scale", "standing"]

_ID_DIGITS = 5
_UNSAFE = re.compile(r"[^A-Za-z0-9_+-]+")
_IDS = re.compile(r"(-?\d+)(?:-(\d+))?")


class Surface(Protocol):
    """Anything with triangles: a :class:`~dataset_store.mesh.Mesh` or a stored record."""

    @property
    def vertices_m(self) -> NDArray[np.floating[Any]]:
        """Corners, shape (V, 3), metres."""
        ...

    @property
    def faces(self) -> NDArray[np.int32]:
        """Triangles, shape (F, 3)."""
        ...


@dataclass(frozen=True, slots=True)
class PrintObject:
    """One object to print.

    Attributes
    ----------
    name : str
        Unique, and fit for a file name: ``printed_test-7-00042``.
    split, label : str
        Where it comes from and the name of its class; both may be empty.
    id : int
        What its tag shows.
    load : callable
        Gives its triangles; called each time that they are needed, so that a thousand objects take no more
        memory than one. Picklable where worker processes are used.
    """

    name: str
    split: str
    label: str
    id: int
    load: Callable[[], Surface]


def standing(surface: Surface, scale: float = 1.0) -> Mesh:
    """Stand an object on the plate in the pose that it has: only its height above the plate changes.

    Parameters
    ----------
    surface : Surface
        Triangles as stored; corners at the very same place are made one, as solids need it.
    scale : float
        Factor on all lengths, about the origin.

    Returns
    -------
    Mesh
        Float64, lowest point at z = 0.
    """
    vertices_m = np.asarray(surface.vertices_m, np.float64) * scale
    faces = np.asarray(surface.faces, np.int32)
    # What names corners that are not there is left as it is: the check of the solid says so.
    if faces.size and faces.min() >= 0 and faces.max() < len(vertices_m):
        vertices_m, faces = _merged(vertices_m, faces)
    if len(vertices_m):
        vertices_m[:, 2] -= vertices_m[:, 2].min()
    return Mesh(vertices_m, faces)


def _merged(
    vertices_m: NDArray[np.float64], faces: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    vertices, merged = merge_equal_vertices(vertices_m, faces)
    return np.asarray(vertices, np.float64), merged


def choose(
    datasets: Iterable[tuple[str, RecordDataset[SolidRecord]]],
    *,
    ids: Sequence[int] | None = None,
    labels: Sequence[str] | None = None,
    limit: int | None = None,
) -> list[PrintObject]:
    """Choose rows of data sets; no mesh is read.

    Parameters
    ----------
    datasets : iterable of (str, RecordDataset)
        Split and its rows.
    ids : sequence of int, optional
        Only these rows.
    labels : sequence of str, optional
        Only these classes, by name.
    limit : int, optional
        Only the first so many of what is left of each split.

    Returns
    -------
    list of PrintObject
        In the order of the rows.

    Raises
    ------
    InputError
        An id or a class is not there, an id stands twice in a split, or nothing is left.
    """
    objects: list[PrintObject] = []
    seen: set[int] = set()
    for split, rows in datasets:
        known = rows.ids
        seen.update(known.tolist())
        wanted = np.ones(len(rows), bool) if ids is None else np.isin(known, list(ids))
        if labels is not None:
            wanted &= np.isin(rows.labels, _label_numbers(labels, rows.label_names, split))
        objects += _objects(split, rows, np.flatnonzero(wanted)[:limit])
    _require_found(ids, seen)
    if not objects:
        message = (
            "no object is chosen; expected rows of the split with the ids and classes that were asked for"
        )
        raise InputError(message)
    _require_unique(objects)
    return objects


def require_scale(scale: float) -> None:
    """Refuse a factor that makes nothing to print.

    Raises
    ------
    InputError
        It is not a positive number.
    """
    if not (math.isfinite(scale) and scale > 0):
        message = f"--scale is {scale:g}; expected a positive number such as 1 or 0.5"
        raise InputError(message)


def _objects(split: str, rows: RecordDataset[SolidRecord], positions: NDArray[np.int64]) -> list[PrintObject]:
    ids, labels = rows.ids, rows.labels
    return [
        _object(
            split, _label_name(rows.label_names, int(labels[row])), int(ids[row]), partial(_row, rows, row)
        )
        for row in positions.tolist()
    ]


def _object(split: str, label: str, number: int, load: Callable[[], Surface]) -> PrintObject:
    name = "-".join(part for part in (_safe(split), _safe(label), f"{number:0{_ID_DIGITS}d}") if part)
    return PrintObject(name, split, label, number, load)


def _row(rows: RecordDataset[SolidRecord], position: int) -> Surface:
    return rows[position]


def _safe(word: str) -> str:
    # Splits and class names of other people's data sets may hold anything, a slash included.
    return _UNSAFE.sub("_", word)


def _label_name(names: Sequence[str], number: int) -> str:
    return names[number] if 0 <= number < len(names) else str(number)


def _label_numbers(labels: Sequence[str], names: Sequence[str], split: str) -> list[int]:
    unknown = [label for label in labels if label not in names]
    if unknown:
        message = f"no class {unknown[0]!r} in split {split!r}; expected one of {', '.join(names)}"
        raise InputError(message)
    return [list(names).index(label) for label in labels]


def _require_found(ids: Sequence[int] | None, seen: set[int]) -> None:
    missing = [number for number in ids or () if number not in seen]
    if missing:
        message = (
            f"no object with id {missing[0]} in what was chosen ({len(missing)} of the ids are not there); "
            "next: look at the ids of the split, or name another --split"
        )
        raise InputError(message)


def _require_unique(objects: Sequence[PrintObject]) -> None:
    names = [item.name for item in objects]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        message = (
            f"two objects would be called {twice!r}: an id stands twice in a split; next: verify the data set"
        )
        raise InputError(message)


def parse_ids(text: str) -> list[int]:
    """Read ids such as ``3,17,40-60``.

    Raises
    ------
    InputError
        The text has another form.
    """
    numbers: list[int] = []
    for part in text.split(","):
        match = _IDS.fullmatch(part.strip())
        if match is None or int(match[2] or match[1]) < int(match[1]):
            message = f"--ids has {part.strip()!r}; expected numbers and ranges such as 3,17,40-60"
            raise InputError(message)
        numbers += range(int(match[1]), int(match[2] or match[1]) + 1)
    return numbers
