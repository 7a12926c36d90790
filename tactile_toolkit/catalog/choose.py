"""Which rows of a data set to show: by split, by id, or the first of each class."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.catalog.locate import splits_of
from tactile_toolkit.errors import InputError
from tactile_toolkit.read.dataset import RecordDataset
from tactile_toolkit.store.address import is_remote, place_of_data
from tactile_toolkit.store.files import expanded

D = TypeVar("D", bound=RecordDataset[Any])

_IDS = re.compile(r"(-?\d{1,20})(?:-(\d{1,20}))?", re.ASCII)

IdChoice: TypeAlias = Sequence[int | tuple[int, int]]
"""Ids, and first and last ids of ranges."""


def open_splits(name: str, split: str | None, load: Callable[[str, str], D], things: str) -> dict[str, D]:
    """Open one split of a local data set, or all of them; those without rows are left out.

    ``load`` opens a split of a path; ``things`` is what the rows are, for messages, such as ``"digits"``.
    InputError where there is no such split, or nothing in it.
    """
    known = splits_of(name)
    if split is not None and split not in known:
        raise InputError(
            f"no split {split!r} in {name!r}: it has {', '.join(known)}", next="choose one of them"
        )
    chosen = known if split is None else (split,)
    opened = {each: load(name, each) for each in chosen}
    filled = {each: rows for each, rows in opened.items() if len(rows)}
    if not filled:
        raise InputError(
            f"{', '.join(chosen)} of {name!r}: no {things}", next="generate some, or choose another split"
        )
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
        rows = np.flatnonzero(np.isin(known, ids)).tolist()
        found = {int(known[row]): (split, dataset[row]) for row in reversed(rows)} | found
    missing = [str(number) for number in dict.fromkeys(ids) if number not in found]
    if missing:
        raise InputError(
            f"no {things} of id {', '.join(missing)} in {', '.join(datasets)} of {name!r}",
            next="give ids of the data set, such as those on its contact sheet",
        )
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
    """Which rows of a data set to show: one split or all, and of each split as :func:`choose_rows` says."""

    name: str
    split: str | None = None
    limit: int | None = None
    per_class: int | None = None
    ids: IdChoice | None = None
    labels: Sequence[str] | None = None

    def rows(self, datasets: Iterable[tuple[str, D]]) -> list[tuple[str, D, NDArray[np.int64]]]:
        """Return splits with the rows that are chosen; InputError as of :func:`choose_rows`."""
        return choose_rows(
            datasets, ids=self.ids, labels=self.labels, per_class=self.per_class, limit=self.limit
        )


def choose_rows(
    datasets: Iterable[tuple[str, D]],
    *,
    ids: IdChoice | None = None,
    labels: Sequence[str] | None = None,
    per_class: int | None = None,
    limit: int | None = None,
) -> list[tuple[str, D, NDArray[np.int64]]]:
    """Choose rows of splits, each with its name; return those with their positions, in order.

    Only rows with these ``ids`` (a pair stands for all from its first to its last that are there), of these
    classes, of these the first ``per_class`` of each class, and of what is left the first ``limit`` of each
    split. Raises InputError where an id or a class is not there, no id of a range is, or nothing is left.
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
                raise InputError(
                    f"no class {unknown[0]!r} in split {split!r}; expected one of {', '.join(classes)}"
                )
            wanted &= np.isin(rows.labels, [classes.index(label) for label in labels])
        chosen = np.flatnonzero(wanted)
        if per_class is not None:
            kinds = rows.labels[chosen]
            kept = [chosen[kinds == label][:per_class] for label in np.unique(kinds)]
            chosen = np.sort(np.concatenate([chosen[:0], *kept]))
        found.append((split, rows, chosen[:limit]))
    missing = [pair for pair, there in zip(ranges or (), seen, strict=True) if not there]
    if missing:
        low, high = missing[0]
        what = f"id {low}" if low == high else f"an id from {low} to {high}"
        more = f" ({len(missing)} of the ids and ranges are not there)" if len(missing) > 1 else ""
        raise InputError(
            f"no object with {what} in what was chosen{more}",
            next="look at the ids of the split, or name another --split",
        )
    if not any(len(chosen) for _, _, chosen in found):
        raise InputError(
            "no object is chosen; expected rows of the split with the ids and classes that were asked for"
        )
    return found


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
            raise InputError(f"--ids has {part.strip()!r}; expected numbers and ranges such as 3,17,40-60")
        numbers.append(low if match[2] is None else (low, high))
    return numbers


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
