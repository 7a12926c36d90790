"""Items of a gallery, and the tasks that make them.

The page filters by columns that rows declare as facets, and sorts by those declared as measures.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import pyarrow as pa

from tactile_toolkit import catalog, places, read
from tactile_toolkit.json_types import JsonObject
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.rows import Column
from tactile_toolkit.wording import class_name

SPLIT = "split"
"""Name of the facet of splits, which all galleries of rows have."""


@dataclass(frozen=True, slots=True)
class GalleryItem:
    """An item of the page.

    ``values`` are those of facets and measures by name of the column; None is an unknown value, an empty list
    means no value.
    """

    id: str  # searched for by users
    title: str
    values: JsonObject
    thumbnail: bytes = field(repr=False)  # PNG
    # JSON values that the page loads when the item is opened: "notes" (pairs of a title and a text) and
    # either "mesh" (see packed_mesh) or "touches".
    content: Mapping[str, object] = field(repr=False)
    # Further files by the end of their name, such as "000.jpg".
    media: Mapping[str, bytes] = field(default_factory=dict, repr=False)


ItemMaker: TypeAlias = Callable[[Any, str, tuple[str, ...], Any], GalleryItem]
"""Function of a record, the split, the class names, and further information about the row."""


@dataclass(frozen=True)
class RowsTask:
    """Makes the items of some rows of a split.

    ``item`` takes a record, the split, the class names, and the entry of ``known`` for the row: further
    information, such as its report.
    """

    dataset: read.AnyRecords
    split: str
    item: ItemMaker
    known: tuple[object, ...] = field(repr=False)

    @property
    def size(self) -> int:
        """Number of items that it makes."""
        return len(self.dataset)

    def make(self) -> list[GalleryItem]:
        """Make the items, in order; their split and class are added to the values."""
        names, made = self.dataset.label_names, []
        for record, known in zip(self.dataset, self.known, strict=True):
            item = self.item(record, self.split, names, known)
            given = {SPLIT: self.split, "label": class_name(names, record.label), **item.values}
            made.append(replace(item, values=given))
        return made


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


def gallery_of_rows(
    kind: DatasetKind,
    name: places.Name | places.Place,
    chosen: catalog.RowFilter,
    title: str,
    columns: Sequence[Column],
    item: ItemMaker,
    rows_per_task: int,
    known: Callable[[Any, str], Sequence[object]] = lambda rows, _: [None] * len(rows),
) -> Gallery:
    """Plan a gallery of chosen rows of some splits; see :class:`RowsTask` for ``item``.

    ``columns`` are the facets and measures, except the split. ``known`` takes the chosen rows and their
    split, and returns an entry for each row, such as its report.

    Raises InputError for an unknown data set or split, or another kind; IntegrityError for a damaged or
    unfinished one; HubError where the repository cannot be reached or does not exist.
    """
    among = chosen.given()
    only = among.pop("split")
    place = places.open_place(name).require(kind, "gallery")
    opened = catalog.open_splits(place, only, kind.load, kind.nouns)
    tasks: list[RowsTask] = []
    shown: dict[str, int] = {}
    for split, dataset, positions in catalog.choose_rows(opened.items(), **among):
        rows = dataset[positions]
        shown[split] = len(rows)
        given = known(rows, split)
        for start in range(0, len(rows), rows_per_task):
            part = slice(start, start + rows_per_task)
            tasks.append(RowsTask(rows[part], split, item, tuple(given[part])))
    heading = f"{title} · {catalog.short_name(place.name)}"
    if place.unfinished:
        heading = f"{heading} (unfinished, {place.unfinished})"
    of_split = Column(pa.string(), name=SPLIT, role="facet", title="Split", values=tuple(shown))
    return Gallery(kind.name, heading, (kind.noun, kind.nouns), (*columns, of_split), tuple(tasks), shown)
