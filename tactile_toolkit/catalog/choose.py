"""Which rows of a data set to show: by split, by id, or the first of each class."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.catalog.locate import splits_of
from tactile_toolkit.errors import InputError
from tactile_toolkit.read.dataset import RecordDataset
from tactile_toolkit.store.address import is_remote, place_of_data
from tactile_toolkit.store.files import expanded

__all__ = [
    "Choice",
    "chosen_records",
    "chosen_rows",
    "class_by_class",
    "open_splits",
    "portions",
    "short_name",
    "splits_to_show",
]

D = TypeVar("D", bound=RecordDataset[Any])


def open_splits(name: str, split: str | None, load: Callable[[str, str], D], things: str) -> dict[str, D]:
    """Open one split of a local data set, or all of them; those without rows are left out.

    ``load`` opens a split of a path; ``things`` is what the rows are, for messages, such as ``"digits"``.
    InputError where there is no such split, or nothing in it.
    """
    known = splits_of(name)
    if split is not None and split not in known:
        message = f"no split {split!r} in {name!r}: it has {', '.join(known)}; next: choose one of them"
        raise InputError(message)
    chosen = known if split is None else (split,)
    opened = {each: load(name, each) for each in chosen}
    filled = {each: rows for each, rows in opened.items() if len(rows)}
    if not filled:
        message = (
            f"{', '.join(chosen)} of {name!r}: no {things}; next: generate some, or choose another split"
        )
        raise InputError(message)
    return filled


def chosen_records(
    datasets: Mapping[str, RecordDataset[Any]], ids: Sequence[int], name: str, things: str
) -> list[tuple[str, Any]]:
    """Return the records of some ids with their splits, or the first of all when no id is given.

    Raises InputError where there is no row of some id.
    """
    if not ids:
        split, dataset = next(iter(datasets.items()))
        return [(split, dataset[0])]
    found: dict[int, tuple[str, Any]] = {}
    for split, dataset in datasets.items():
        known = dataset.ids  # each time, a copy of the rows chosen
        for row in np.flatnonzero(np.isin(known, ids)).tolist():
            found.setdefault(int(known[row]), (split, dataset[row]))
    missing = [str(number) for number in dict.fromkeys(ids) if number not in found]
    if missing:
        message = (
            f"no {things} of id {', '.join(missing)} in {', '.join(datasets)} of {name!r}; next: give ids of "
            "the data set, such as those on its contact sheet"
        )
        raise InputError(message)
    return [found[number] for number in dict.fromkeys(ids)]


def class_by_class(dataset: RecordDataset[Any], ids: Sequence[int], per_class: int) -> NDArray[np.int64]:
    """Return rows, class after class: those of some ids, or the first so many of each class.

    Reads the id and label columns only.
    """
    labels = dataset.labels
    if ids:
        rows = np.flatnonzero(np.isin(dataset.ids, ids))
        return rows[np.argsort(labels[rows], kind="stable")]
    return np.concatenate([np.flatnonzero(labels == label)[:per_class] for label in np.unique(labels)])


@dataclass(frozen=True, slots=True)
class Choice:
    """Which rows of a data set to show: one split or all, the first rows of each split and of each class."""

    name: str
    split: str | None = None
    limit: int | None = None
    per_class: int | None = None


def chosen_rows(labels: NDArray[np.int64], limit: int | None, per_class: int | None) -> NDArray[np.int64]:
    """Choose rows of one split: the first ``per_class`` of each class, and of these the first ``limit``.

    Takes the class of each row, returns row numbers, rising.
    """
    rows = np.arange(len(labels))
    if per_class is not None:
        kept = [rows[labels == label][:per_class] for label in np.unique(labels)]
        rows = np.sort(np.concatenate(kept)) if kept else rows
    return rows[:limit]


def portions(rows: NDArray[np.int64], size: int) -> Iterator[NDArray[np.int64]]:
    """Cut rows into portions of at most ``size``."""
    for start in range(0, len(rows), size):
        yield rows[start : start + size]


def splits_to_show(name: str, split: str | None, revision: str | None = None) -> tuple[str, ...]:
    """Return the splits of a data set, or the one asked for."""
    return splits_of(name, revision=revision) if split is None else (split,)


def short_name(name: str) -> str:
    """Return a data set's name without the folders that it lies in: a site may be given to others."""
    if is_remote(name):
        return name.rstrip("/").rpartition("/")[2]
    place = expanded(place_of_data(name))
    return place.resolve().name if place.exists() else name
