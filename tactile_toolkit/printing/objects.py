"""Objects to print, chosen from rows of data sets."""

from __future__ import annotations

import math
import re
import unicodedata
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from tactile_toolkit import catalog, mesh, read
from tactile_toolkit.array_types import Float64
from tactile_toolkit.errors import InputError
from tactile_toolkit.json_types import JsonValue
from tactile_toolkit.wording import class_name

if TYPE_CHECKING:
    from tactile_toolkit.mesh import SolidRecord


_ID_DIGITS = 5  # file names sort like ids up to 99,999
_UNSAFE = re.compile(r"[^\w+-]+")


@dataclass(frozen=True, slots=True)
class PrintObject:
    """An object to print, with a unique name that is valid as a file name: ``printed_test-7-00042``.

    Split and class name may be empty. ``load`` returns its triangles whenever they are needed, so that a
    thousand objects take no more memory than one; picklable for worker processes.
    """

    name: str
    split: str
    label: str
    id: int
    load: Callable[[], mesh.Mesh | SolidRecord]


def place_on_plate(surface: mesh.Mesh | SolidRecord, scale: float = 1.0) -> mesh.Mesh:
    """Place an object on the plate without rotation: only its height above the plate changes.

    Vertices with equal coordinates are merged, as solids need; ``scale`` multiplies all lengths, about the
    origin.
    """
    vertices_m: Float64 = np.asarray(surface.vertices_m, np.float64) * scale
    faces = np.asarray(surface.faces, np.int32)
    # Faces with invalid vertex numbers are left to the check of the solid.
    if faces.size and faces.min() >= 0 and faces.max() < len(vertices_m):
        vertices_m, faces = mesh.merge_equal_vertices(vertices_m, faces)
    if len(vertices_m):
        vertices_m[:, 2] -= vertices_m[:, 2].min()
    return mesh.Mesh(vertices_m, faces)


def on_plates(objects: Iterable[PrintObject], base_mm: float | None) -> list[PrintObject]:
    """Put the upper half of each object on a plate of a thickness; None changes nothing.

    See :func:`tactile_toolkit.mesh.on_base_plate`.
    """
    if base_mm is None:
        return list(objects)
    return [replace(item, load=partial(_on_plate, item.load, base_mm)) for item in objects]


def _on_plate(load: Callable[[], mesh.Mesh | SolidRecord], base_mm: float) -> mesh.Mesh:
    return mesh.on_base_plate(place_on_plate(load()), base_mm)


def choose(
    datasets: Iterable[tuple[str, read.RecordDataset[SolidRecord]]], **chosen: JsonValue
) -> list[PrintObject]:
    """Choose objects as :func:`tactile_toolkit.catalog.choose_rows` does; no mesh is read.

    Raises InputError as there, and for a duplicate id in a split.
    """
    objects: list[PrintObject] = []
    for split, rows, found in catalog.choose_rows(datasets, **chosen):
        classes = rows.label_names
        columns = (found.tolist(), rows.ids[found].tolist(), rows.labels[found].tolist())
        for row, number, label in zip(*columns, strict=True):
            word = class_name(classes, label)
            name = "-".join(part for part in (_safe(split), _safe(word), f"{number:0{_ID_DIGITS}d}") if part)
            objects.append(PrintObject(name, split, word, number, partial(rows.__getitem__, row)))
    names = Counter(item.name for item in objects)
    twice = next((name for name, count in names.items() if count > 1), None)
    if twice is not None:
        raise InputError(
            f"two objects would be called {twice!r}: a split has a duplicate id",
            next="verify the data set",
        )
    return objects


def require_scale(scale: float) -> None:
    """Raise InputError for a factor that is not a positive number."""
    if not (math.isfinite(scale) and scale > 0):
        raise InputError(f"--scale is {scale:g}; expected a positive number such as 1 or 0.5")


def _safe(word: str) -> str:
    # Split and class names of other data sets may contain any character, such as a slash. Letters of all
    # scripts are kept, in composed form, because file systems treat separate accents differently.
    return _UNSAFE.sub("_", unicodedata.normalize("NFC", word))
