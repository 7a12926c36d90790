"""Items of a gallery, the tasks that make them, and their meshes and thumbnails.

The page filters by columns that rows declare as facets, and sorts by those declared as measures.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, TypeAlias

import numpy as np
import pyarrow as pa
from PIL import Image

from tactile_toolkit import catalog, mesh, pictures, places, read
from tactile_toolkit.catalog.rows import short_name
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.rows import Column
from tactile_toolkit.touch import images
from tactile_toolkit.value_types import Floating, Int64, Integers, JsonDict, JsonObject, JsonValue, UInt8
from tactile_toolkit.wording import class_name

SPLIT = "split"
"""Name of the facet of splits, which all galleries of rows have."""

THUMBNAIL_PX = 144
"""Longer side of a thumbnail."""

STEP_MM = 0.01
"""Grid to which vertices are rounded, a twentieth of a printed layer; coarser for meshes above 655 mm, finer
for those below 10 mm."""

_SOLIDS_PER_TASK = 16
_MIN_STEPS = 1_000
_MIN_STEP_MM = 1e-6
_MAX_STEPS = np.iinfo(np.uint16).max


@dataclass(frozen=True, slots=True)
class GalleryItem:
    """An item of the page.

    ``values`` are those of facets and measures by name of the column; None is an unknown value, an empty list
    means no value.
    """

    id: str  # searched for by users
    title: str
    values: JsonObject
    thumbnail: bytes = field(repr=False)  # see thumbnail_of
    # JSON values that the page loads when the item is opened: "notes" (pairs of a title and a text) and
    # either "mesh" (see packed_mesh) or "touches".
    content: Mapping[str, object] = field(repr=False)
    # Further files by the end of their name, such as "000.jpg".
    media: Mapping[str, bytes] = field(default_factory=dict, repr=False)

    @staticmethod
    def thumbnail_of(pixels: UInt8) -> bytes:
        """Make a PNG thumbnail of grey levels or colours, also with opacity: (H, W) or (H, W, 2 to 4)."""
        picture = Image.fromarray(np.ascontiguousarray(pixels))
        picture.thumbnail((THUMBNAIL_PX, THUMBNAIL_PX), Image.Resampling.BOX)
        return images.encode_png(picture)


ItemMaker: TypeAlias = Callable[[Any, str, tuple[str, ...], Any], GalleryItem]
"""Function of a record, the split, the class names, and further information about the row."""


@dataclass(frozen=True)
class RowsTask:
    """Makes the items of some rows of a split.

    ``item`` takes a record, the split, the class names, and the entry of ``known`` for the row: further
    information, such as its report.
    """

    dataset: read.RecordDataset[Any]
    split: str
    item: ItemMaker
    known: tuple[object, ...] = field(repr=False)

    @property
    def size(self) -> int:
        """Number of items that it makes."""
        return len(self.dataset)

    def make(self) -> list[GalleryItem]:
        """Make the items, in order; their split and class are added to the values."""
        names = self.dataset.label_names
        made = []
        for record, known in zip(self.dataset, self.known, strict=True):
            item = self.item(record, self.split, names, known)
            label = class_name(names, record.label) if record.label >= 0 else None
            made.append(replace(item, values={**item.values, SPLIT: self.split, "label": label}))
        return made


def _no_facts(_record: pictures.DrawnSolid, _known: object) -> JsonObject:
    """Return no further values; not a lambda, since tasks travel to other processes."""
    return {}


@dataclass(frozen=True)
class Gallery:
    """Content of a site, and the tasks that make its items, in the order of the page."""

    kind: str  # of the data set, such as "mnist3d"
    title: str
    nouns: tuple[str, str]  # one item and several
    columns: tuple[Column, ...]  # facets, which the page filters by, and measures, which it sorts by
    tasks: tuple[RowsTask, ...]
    splits: Mapping[str, int]  # number of items of each that are shown

    @property
    def size(self) -> int:
        """Number of items."""
        return sum(task.size for task in self.tasks)

    @classmethod
    def of_rows(
        cls,
        chosen: pictures.ChosenRows,
        title: str,
        columns: Sequence[Column],
        item: ItemMaker,
        rows_per_task: int,
        known: Callable[[Any, str], Sequence[object]] = lambda rows, _: [None] * len(rows),
    ) -> Gallery:
        """Plan a gallery of chosen rows; see :class:`RowsTask` for ``item``.

        ``columns`` are the facets and measures, except the split. ``known`` takes the chosen rows of a split
        and the split, and returns an entry for each row, such as its report.
        """
        tasks: list[RowsTask] = []
        for split, rows in chosen.splits.items():
            known_values = tuple(known(rows, split))
            for start in range(0, len(rows), rows_per_task):
                part = slice(start, start + rows_per_task)
                tasks.append(RowsTask(rows[part], split, item, known_values[part]))
        shown = {split: len(rows) for split, rows in chosen.splits.items()}
        heading = chosen.titled(f"{title} · {short_name(chosen.place.name)}")
        kind = chosen.kind
        of_split = Column(pa.string(), name=SPLIT, role="facet", title="Split", values=tuple(shown))
        return cls(kind.name, heading, (kind.noun, kind.nouns), (*columns, of_split), tuple(tasks), shown)

    @classmethod
    def of_solids(
        cls,
        kind: DatasetKind,
        name: places.Name | places.Place,
        chosen: catalog.RowFilter = catalog.RowFilter.ALL,
        *,
        title: str,
        columns: Sequence[Column],
        facts: Callable[[Any, Any], JsonObject] = _no_facts,
        known: Callable[[Any, str], Sequence[object]] = lambda rows, _: [None] * len(rows),
    ) -> Gallery:
        """Plan a gallery of chosen solids that draw themselves; see :meth:`of_rows`.

        ``facts`` takes a record and its entry of ``known``, and returns values of columns that are neither
        stored nor a property of the record. Raises as :meth:`tactile_toolkit.pictures.ChosenRows.of`.
        """
        item = partial(_solid_item, tuple(column.name for column in columns), facts)
        picked = pictures.ChosenRows.of(kind, name, chosen, "tactile gallery")
        return cls.of_rows(picked, title, columns, item, _SOLIDS_PER_TASK, known)


def _solid_item(
    shown: Sequence[str],
    facts: Callable[[Any, Any], JsonObject],
    record: pictures.DrawnSolid,
    split: str,
    label_names: Sequence[str],
    known: object,
) -> GalleryItem:
    """Show a solid. IntegrityError for a stored mesh that cannot be drawn."""
    surface = mesh.Mesh(record.vertices_m, record.faces)
    problem = surface.array_problem
    if problem is not None:
        raise IntegrityError(
            f"the mesh of id {record.id} in split {split!r} cannot be drawn: {problem[1]}",
            next="run `verify` and `validate` on the data set, then generate or download it again",
        )
    values: JsonDict = {
        "volume_mm3": surface.volume_m3 * mesh.MM_PER_M**3,
        "vertices": len(surface.vertices_m),
        "faces": len(surface.faces),
        **facts(record, known),
    }
    for name in shown:
        if name not in values and (hasattr(type(record), name) or record.row.has(name)):
            values[name] = _value(record, name)
    content = packed_mesh(surface.vertices_m, surface.faces, record.parts, flat=record.is_faceted)
    return GalleryItem(
        id=str(record.id),
        title=record.caption(label_names),
        values=values,
        thumbnail=GalleryItem.thumbnail_of(record.cutout(THUMBNAIL_PX)),
        content={"notes": record.notes, "mesh": content},
    )


def _value(record: pictures.DrawnSolid, name: str) -> JsonValue:
    """Return a property of a record, or a stored value; None if the data set does not have it."""
    try:
        value: JsonValue = getattr(record, name) if hasattr(type(record), name) else record.row.value(name)
    except InputError:
        return None
    return value


def packed_mesh(
    vertices_m: Floating,
    faces: Integers,
    parts: Sequence[tuple[int, str]] = (),
    *,
    flat: bool = False,
) -> dict[str, object]:
    """Pack a mesh, (V, 3) in metres with z up and (F, 3), as JSON values for the viewer of the page.

    ``parts`` are runs of triangles with their colour, ``"main"`` or ``"other"``; all are ``"main"`` by
    default. ``flat`` shows sharp edges instead of smooth shading. ``vertices`` and ``faces`` become base64 of
    zlib of four planes of bytes (lowest first) of zigzag numbers, each the difference to the number before;
    vertices are all x, all y, all z, in steps of ``step_mm`` above ``low_mm``.
    """
    vertices_mm = np.asarray(vertices_m, np.float64) * mesh.MM_PER_M
    low_mm = vertices_mm.min(axis=0)
    extent_mm = float((vertices_mm.max(axis=0) - low_mm).max())
    step_mm = max(min(STEP_MM, max(extent_mm / _MIN_STEPS, _MIN_STEP_MM)), extent_mm / _MAX_STEPS)
    steps = np.round((vertices_mm - low_mm) / step_mm).astype(np.int64)
    return {
        "vertices": _packed(steps.T.reshape(-1)),
        "faces": _packed(np.asarray(faces, np.int64).reshape(-1)),
        "vertex_count": len(vertices_mm),
        "face_count": len(faces),
        "step_mm": step_mm,
        "low_mm": [round(float(value), 6) for value in low_mm],
        "parts": [list(part) for part in parts] or [[len(faces), "main"]],
        "flat": flat,
    }


def _packed(numbers: Int64) -> str:
    # Neighbours differ little, so the upper planes of bytes are nearly all zero and compress well.
    change = np.diff(numbers, prepend=0)
    # Small differences of either sign become small numbers (as in Protocol Buffers).
    zigzag = ((change << 1) ^ (change >> 63)).astype("<u4")
    planes = zigzag.view(np.uint8).reshape(-1, 4).T
    return base64.b64encode(zlib.compress(planes.tobytes(), 6)).decode("ascii")
