"""Which rows of a data set a gallery shows, and in which portions they are worked off."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dataset_store.places import splits_of

__all__ = ["Choice", "chosen_rows", "portions", "short_name", "splits_to_show"]


@dataclass(frozen=True, slots=True)
class Choice:
    """Which rows of a data set to show.

    Attributes
    ----------
    name : str
        Short name, folder, Parquet file or repository of the Hub, as the room's ``load`` takes it.
    split : str or None
        Only this split.
    limit, per_class : int or None
        Only the first so many rows of each split, and of each class of a split.
    """

    name: str
    split: str | None = None
    limit: int | None = None
    per_class: int | None = None


def chosen_rows(labels: NDArray[np.int64], limit: int | None, per_class: int | None) -> NDArray[np.int64]:
    """Choose rows of one split: the first ``per_class`` of each class, and of these the first ``limit``.

    Parameters
    ----------
    labels : ndarray of int64, shape (N,)
        Class of each row.
    limit, per_class : int, optional
        No bound by default.

    Returns
    -------
    ndarray of int64, shape (n,)
        Row numbers, rising.
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
    """Return the splits of a data set, or the one asked for.

    Raises
    ------
    InputError
        There is no such data set.
    HubError
        The repository cannot be reached or does not exist.
    """
    return splits_of(name, revision=revision) if split is None else (split,)


def short_name(name: str) -> str:
    """Return a data set's name without the folders that it lies in: a site may be given to others."""
    place = Path(name).expanduser()
    return place.resolve().name if place.exists() else name
