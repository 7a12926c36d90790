"""What a gallery shows: items, what they can be filtered by, and the work that makes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

__all__ = ["NONE", "SPLIT", "Facet", "Gallery", "Item", "ItemTask", "Measure"]

NONE = "none"
"""Facet value of items that have none, so that these can be looked at too."""

SPLIT = "split"
"""Name of the facet of splits; its values stand in the order of the data set."""


@dataclass(frozen=True, slots=True)
class Facet:
    """Something that items are filtered by.

    Attributes
    ----------
    name : str
        Key in :attr:`Item.facets`.
    title : str
        What readers call it.
    values : tuple of str
        Values in the order to show them in; others that items have follow in natural order.
    """

    name: str
    title: str
    values: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Measure:
    """A number of each item, shown with it and sorted by.

    Attributes
    ----------
    name : str
        Key in :attr:`Item.measures`.
    title : str
        What readers call it.
    unit : str
        Unit as it is shown; empty for counts.
    decimals : int
        Decimals shown and stored.
    """

    name: str
    title: str
    unit: str = ""
    decimals: int = 0


@dataclass(frozen=True, slots=True)
class Item:
    """One item as a worker hands it over.

    Attributes
    ----------
    id : str
        What it is searched by.
    title : str
        What it is, in few words: ``"digit 3"``.
    facets : mapping of str to sequence of str
        Its values of each :class:`Facet`.
    measures : mapping of str to float or None
        Its value of each :class:`Measure`; None (or no entry) where it is unknown.
    thumbnail : bytes
        A small picture, PNG.
    content : mapping
        JSON values that the page loads when the item is opened: ``"notes"`` (pairs of a title and a text)
        and either ``"mesh"`` (see :func:`tactile_toolkit.gallery.meshes.packed_mesh`) or ``"touches"``.
    media : mapping of str to bytes
        Further files by the end of their name, such as ``"000.jpg"``.
    """

    id: str
    title: str
    facets: Mapping[str, Sequence[str]]
    measures: Mapping[str, float | None]
    thumbnail: bytes = field(repr=False)
    content: Mapping[str, Any] = field(repr=False)
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
    """What a site is to hold.

    Attributes
    ----------
    kind : str
        Kind of data set, such as ``"mnist3d"``.
    title : str
        Heading of the page.
    nouns : tuple of str
        One item and several: ``("digit", "digits")``.
    facets : tuple of Facet
        What the page filters by.
    measures : tuple of Measure
        Numbers of each item.
    tasks : tuple of ItemTask
        Work that makes the items, in the order of the page.
    splits : mapping of str to int
        How many items of each split are shown.
    """

    kind: str
    title: str
    nouns: tuple[str, str]
    facets: tuple[Facet, ...]
    measures: tuple[Measure, ...]
    tasks: tuple[ItemTask, ...]
    splits: Mapping[str, int]

    @property
    def size(self) -> int:
        """How many items there are."""
        return sum(task.size for task in self.tasks)
