"""Choosing rows of a data set: by split, id and class, or the first of each."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Protocol, TypeVar

import numpy as np

from tactile_toolkit import places, read
from tactile_toolkit.array_types import AnyArray, Bool, Int64
from tactile_toolkit.catalog.ids import GivenId, IdChoice, id_range, id_text
from tactile_toolkit.errors import InputError

D = TypeVar("D", bound=read.AnyRecords)
C = TypeVar("C", bound="Classified")


class Classified(Protocol):
    """Rows with ids of objects and classes."""

    @property
    def ids(self) -> AnyArray:
        """Id of each row."""

    @property
    def object_ids(self) -> AnyArray:
        """Id of the object of each row."""

    @property
    def labels(self) -> Int64:
        """Class of each row."""

    @property
    def label_names(self) -> tuple[str, ...]:
        """Name of each class."""

    def __len__(self) -> int:
        """Return the number of rows."""


def open_splits(
    place: places.Place, split: str | None, load: Callable[[places.Place, str], D], item_nouns: str
) -> dict[str, D]:
    """Open one split of a data set, or all of them; those without rows are left out.

    ``load`` opens a split; ``item_nouns`` says in messages what the rows are, such as ``"digits"``. Raises
    InputError if the split does not exist or is empty, IntegrityError if it is not finished.
    """
    place.require_complete(split)
    chosen = place.chosen_splits(split)
    opened = {each: load(place, each) for each in chosen}
    filled = {each: rows for each, rows in opened.items() if len(rows)}
    if not filled:
        raise InputError(
            f"{', '.join(chosen)} of {place.name!r}: no {item_nouns}",
            next="generate some, or choose another split",
        )
    return filled


def choose_rows(
    datasets: Iterable[tuple[str, C]],
    *,
    ids: IdChoice | None = None,
    labels: Sequence[str] | None = None,
    per_class: int | None = None,
    limit: int | None = None,
) -> list[tuple[str, C, Int64]]:
    """Choose rows of splits, each with its name; return those with their positions, in order.

    The object of a row must have one of these ``ids`` and one of these classes. A pair of ids means all
    numbers from its first to its last; a text is also the id of a row, such as a round of touches. Among
    these rows, the first ``per_class`` of each class are taken, then the first ``limit`` of each split.
    Raises InputError if an id, a range or a class matches no row, or no row is left.
    """
    asked = list(ids or ())
    seen, found = np.zeros(len(asked), bool), []
    for split, rows in datasets:
        wanted = np.ones(len(rows), bool)
        if ids is not None:
            inside = np.zeros((len(asked), len(rows)), bool)
            for number, each in enumerate(asked):
                inside[number] = _with_id(rows, each)
            wanted, seen = np.any(inside, axis=0), seen | np.any(inside, axis=1)
        if labels is not None:
            classes = list(rows.label_names)
            unknown = [label for label in labels if label not in classes]
            if unknown:
                known = ", ".join(classes) or "none: it has no labels"
                raise InputError(f"no class {unknown[0]!r} in split {split!r}; expected one of {known}")
            wanted &= np.isin(rows.labels, [classes.index(label) for label in labels])
        chosen = np.flatnonzero(wanted)
        if per_class is not None:
            kinds = rows.labels[chosen]
            kept = [chosen[kinds == label][:per_class] for label in np.unique(kinds)]
            chosen = np.sort(np.concatenate([chosen[:0], *kept]))
        found.append((split, rows, chosen[:limit]))
    absent = [asked[index] for index in np.flatnonzero(~seen)]
    if absent:
        what = f"id {id_text(absent[0])}"
        if isinstance(absent[0], tuple) and absent[0][0] != absent[0][1]:
            what = f"an id from {absent[0][0]} to {absent[0][1]}"
        raise InputError(
            f"no object with {what} in what was chosen",
            next="check the ids of the split, or name another --split",
        )
    if not any(len(chosen) for _, _, chosen in found):
        raise InputError(
            "no object is chosen; expected rows of the split with the ids and classes that were asked for"
        )
    return found


def _with_id(rows: Classified, given: GivenId) -> Bool:
    """Return a mask of the rows with a given id, or one in a given range: of the object, or of the row."""
    values = rows.object_ids
    if isinstance(given, str) and rows.ids.dtype.kind not in "iuf":
        values = rows.ids
    if values.dtype.kind not in "iuf":
        return np.asarray(values == id_text(given), bool)
    low, high = id_range(given)
    return np.asarray((values >= low) & (values <= high))
