"""What a gallery shows: its items, and the tasks that make them.

Filters and measures of the page are the columns that rows declare as facets and measures.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import pyarrow as pa

from tactile_toolkit import catalog, places, read
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.rows import Column
from tactile_toolkit.wording import class_name

SPLIT = "split"
"""Name of the facet of splits, which every gallery of rows has."""


@dataclass(frozen=True, slots=True)
class GalleryItem:
    """One item as a worker hands it over.

    ``values`` are those of the facets and measures by the name of the column. None is an unknown value, an
    empty list stands for no value.
    """

    id: str  # what it is searched by
    title: str
    values: Mapping[str, Any]
    thumbnail: bytes = field(repr=False)  # PNG
    # JSON values that the page loads when the item is opened: "notes" (pairs of a title and a text) and
    # either "mesh" (see packed_mesh) or "touches".
    content: Mapping[str, Any] = field(repr=False)
    # Further files by the end of their name, such as "000.jpg".
    media: Mapping[str, bytes] = field(default_factory=dict, repr=False)


@dataclass(frozen=True)
class RowsTask:
    """Makes the items of some rows of a split, from each row and what was known of it beforehand.

    Pickles with what is known of these rows alone; ``item`` takes record, split, class names and the known.
    """

    dataset: read.RecordDataset[Any]
    split: str
    item: Callable[[Any, str, tuple[str, ...], Any], GalleryItem]
    known: tuple[Any, ...] = field(repr=False)

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
    """What a site is to hold, and the tasks that make its items, in the order of the page."""

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
    item: Callable[[Any, str, tuple[str, ...], Any], GalleryItem],
    rows_per_task: int,
    known: Callable[[Any, str], Sequence[Any]] = lambda rows, _: [None] * len(rows),
) -> Gallery:
    """Plan a gallery of the rows that are chosen of some splits; see :class:`RowsTask` for ``item``.

    ``columns`` are the facets and measures, that of the split excepted. ``known`` takes the chosen rows and
    their split, and says what is known of each beforehand.

    InputError: no such data set or split, or one of another kind. IntegrityError: it is damaged or
    unfinished. HubError: the repository cannot be reached or does not exist.
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
