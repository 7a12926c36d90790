"""What a gallery shows: items, what they can be filtered by, and the work that makes them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from tactile_toolkit.catalog.choose import Choice, portions, short_name, splits_to_show
from tactile_toolkit.catalog.kinds import require_kind
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.read.dataset import RecordDataset

NONE = "none"
"""Facet value of items without a value, so that these can be looked at too."""

SPLIT = "split"
"""Name of the facet of splits; its values stand in the order of the data set."""


@dataclass(frozen=True, slots=True)
class Facet:
    """Something that items are filtered by; ``name`` is its key in :attr:`Item.facets`.

    ``values`` are shown in their order, others that items have follow in natural order.
    """

    name: str
    title: str
    values: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Measure:
    """A number of each item, shown with it and sorted by; ``name`` is its key in :attr:`Item.measures`."""

    name: str
    title: str
    unit: str = ""  # as it is shown; empty for counts
    decimals: int = 0


@dataclass(frozen=True, slots=True)
class Item:
    """One item as a worker hands it over."""

    id: str  # what it is searched by
    title: str
    facets: Mapping[str, Sequence[str]]
    measures: Mapping[str, float | None]  # None, or no entry, where it is unknown
    thumbnail: bytes = field(repr=False)  # PNG
    # JSON values that the page loads when the item is opened: "notes" (pairs of a title and a text) and
    # either "mesh" (see tactile_toolkit.gallery.packing.packed_mesh) or "touches".
    content: Mapping[str, Any] = field(repr=False)
    # Further files by the end of their name, such as "000.jpg".
    media: Mapping[str, bytes] = field(default_factory=dict, repr=False)


class ItemTask(Protocol):
    """The unit of work: a small picklable value from which any process makes the same items."""

    @property
    def size(self) -> int:
        """How many items it makes."""
        ...

    def make(self) -> list[Item]:
        """Make the items, in order; touches no file of the site."""
        ...


@dataclass(frozen=True)
class Gallery:
    """What a site is to hold, and the tasks that make its items, in the order of the page."""

    kind: str  # of the data set, such as "mnist3d"
    title: str
    nouns: tuple[str, str]  # one item and several
    facets: tuple[Facet, ...]
    measures: tuple[Measure, ...]
    tasks: tuple[ItemTask, ...]
    splits: Mapping[str, int]  # how many items of each are shown

    @property
    def size(self) -> int:
        """How many items there are."""
        return sum(task.size for task in self.tasks)


@dataclass(frozen=True)
class RowsTask:
    """Makes the items of some rows of a split, from each row and what was known of it beforehand.

    Pickles with what is known of these rows alone; ``item`` takes record, split, class names and the known.
    """

    dataset: RecordDataset[Any]
    split: str
    item: Callable[[Any, str, tuple[str, ...], Any], Item]
    known: tuple[Any, ...] = field(repr=False)

    @property
    def size(self) -> int:
        """How many items it makes."""
        return len(self.dataset)

    def make(self) -> list[Item]:
        """Make the items, in order."""
        names = self.dataset.label_names
        return [
            self.item(record, self.split, names, known)
            for record, known in zip(self.dataset, self.known, strict=True)
        ]


def gallery_of_rows(
    kind: DatasetKind,
    choice: Choice,
    title: str,
    facets: tuple[Facet, ...],
    measures: tuple[Measure, ...],
    item: Callable[[Any, str, tuple[str, ...], Any], Item],
    rows_per_task: int,
    known: Callable[[Any, str], Sequence[Any]] = lambda rows, _: [None] * len(rows),
    splits: Iterable[tuple[str, RecordDataset[Any]]] | None = None,
) -> Gallery:
    """Plan a gallery of the rows that are chosen of some splits; see :class:`RowsTask` for ``item``.

    ``known`` takes the chosen rows and their split, and says what is known of each beforehand. ``splits`` are
    those chosen, opened as data of the kind, by default.

    InputError: no such data set or split, or one of another kind. IntegrityError: it is damaged or
    unfinished. HubError: the repository cannot be reached or does not exist.
    """
    tasks: list[ItemTask] = []
    shown: dict[str, int] = {}
    for split, dataset, chosen in choice.rows(_opened(kind, choice) if splits is None else splits):
        rows = dataset[chosen]
        shown[split] = len(rows)
        given = known(rows, split)
        for portion in portions(np.arange(len(rows)), rows_per_task):
            tasks.append(RowsTask(rows[portion], split, item, tuple(given[row] for row in portion)))
    heading = f"{title} · {short_name(choice.name)}"
    return Gallery(kind.name, heading, (kind.noun, kind.nouns), facets, measures, tuple(tasks), shown)


def _opened(kind: DatasetKind, choice: Choice) -> Iterator[tuple[str, RecordDataset[Any]]]:
    for split in splits_to_show(choice.name, choice.split):
        dataset = kind.load(choice.name, split)
        require_kind(kind, "gallery", choice.name, [dataset])
        yield split, dataset
