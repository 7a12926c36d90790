"""Which digit goes into which split: a pure function of seed and ids.

The five splits and their sizes are those of MNIST 3D (Tactile MNIST paper, table of the MNIST 3D splits; the
table prints the name of the last one as ``printed_train`` a second time).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mnist3d.sources import NO_WRITER, DigitCatalog
from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import plain_number, plain_pairs

__all__ = ["PUBLISHED_SIZES", "SPLITS", "SplitPlan", "SplitSpec", "plan_splits"]

SPLITS = ("train", "test", "holdout", "printed_train", "printed_test")
"""The five splits in canonical order, which is also the order in which scarce digits are handed out."""

PUBLISHED_SIZES: dict[str, int] = {
    "train": 1148,
    "test": 100,
    "holdout": 50,
    "printed_train": 50,
    "printed_test": 10,
}
"""Digits per class in each published split; 1,358 in all."""

_PER_CLASS = sum(PUBLISHED_SIZES.values())
_CLASSES = 10


@dataclass(frozen=True, slots=True)
class SplitSpec:
    """How digits are divided.

    Attributes
    ----------
    seed : int
        Seed of the division.
    by : {"digit", "writer"}
        ``"digit"`` draws single digits, with exact sizes per class. ``"writer"`` gives whole writers to
        splits, so that no hand is in two of them; sizes are then as near as whole writers allow.
    sizes : tuple of (str, int), or None
        Digits per class of each split; a mapping is taken too. None means the published sizes, or their
        proportions where a class has fewer than 1,358 digits.
    """

    seed: int = 0
    by: Literal["digit", "writer"] = "digit"
    sizes: tuple[tuple[str, int], ...] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "seed", plain_number(self.seed))
        if self.sizes is not None:
            object.__setattr__(self, "sizes", plain_pairs(self.sizes))
        for split, size in self.sizes or ():
            if split not in SPLITS:
                message = f"unknown split {split!r} in the split sizes; expected one of {', '.join(SPLITS)}"
                raise InputError(message)
            if not isinstance(size, int) or size < 0:
                message = f"the size of split {split!r} is {size!r}; expected 0 or more digits per class"
                raise InputError(message)

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {"seed": self.seed, "by": self.by, "sizes": dict(self.sizes) if self.sizes else None}


@dataclass(frozen=True, slots=True, eq=False)
class SplitPlan:
    """The division of a source's digits: ids and labels of each split, shape (n,).

    They are in row order, a seeded shuffle that mixes the classes.
    """

    ids: Mapping[str, NDArray[np.int64]]
    labels: Mapping[str, NDArray[np.int64]]

    def rows(self, split: str, per_class: int | None = None, limit: int | None = None) -> NDArray[np.int64]:
        """Return the ids to make of a split: the first ``per_class`` of each class, then ``limit`` rows."""
        ids, labels = self.ids[split], self.labels[split]
        if per_class is not None:
            rank_in_class = np.empty(len(labels), dtype=np.int64)
            for label in range(_CLASSES):
                members = np.flatnonzero(labels == label)
                rank_in_class[members] = np.arange(len(members))
            ids = ids[rank_in_class < per_class]
        return ids if limit is None else ids[:limit]


def plan_splits(catalog: DigitCatalog, spec: SplitSpec) -> SplitPlan:
    """Divide the digits of a source into the five splits.

    No digit is in two splits, and where a digit goes depends on the seed and the ids of its source alone.

    Parameters
    ----------
    catalog : DigitCatalog
        What the source holds.
    spec : SplitSpec
        How it is divided.

    Returns
    -------
    SplitPlan
        ``ids`` and ``labels`` of each split.

    Raises
    ------
    InputError
        When a class has fewer digits than ``spec.sizes`` asks for, or writers are asked for and unknown.
    """
    positions = _by_writer(catalog, spec) if spec.by == "writer" else _by_digit(catalog, spec)
    # A key of its own orders the rows, so that the rank that chose the split does not show in them.
    order = _keys(catalog.ids, spec.seed, stream=1)
    rows = {split: found[np.argsort(order[found])] for split, found in positions.items()}
    return SplitPlan(
        {split: catalog.ids[found] for split, found in rows.items()},
        {split: catalog.labels[found] for split, found in rows.items()},
    )


def _by_digit(catalog: DigitCatalog, spec: SplitSpec) -> dict[str, NDArray[np.int64]]:
    """Positions in the catalog of the digits of each split."""
    keys = _keys(catalog.ids, spec.seed, stream=0)
    positions: dict[str, list[NDArray[np.int64]]] = {split: [] for split in SPLITS}
    for label in range(_CLASSES):
        members = np.flatnonzero(catalog.labels == label)
        members = members[np.argsort(keys[members])]
        if spec.sizes is None or not len(members):  # a class that the source does not have is in no split
            sizes = _published_sizes(len(members))
        else:
            sizes = {split: dict(spec.sizes).get(split, 0) for split in SPLITS}
            wanted = sum(sizes.values())
            if wanted > len(members):
                message = (
                    f"the split sizes ask for {wanted} digits per class, the source has {len(members)} of "
                    f"class {label}; next: ask for smaller sizes or use a larger source"
                )
                raise InputError(message)
        stops = np.cumsum([sizes[split] for split in SPLITS])
        for split, stop in zip(SPLITS, stops, strict=True):
            positions[split].append(members[stop - sizes[split] : stop])
    return {split: np.concatenate(chunks) for split, chunks in positions.items()}


def _published_sizes(available: int) -> dict[str, int]:
    """Return the published sizes, or for a smaller class their proportions by largest remainder."""
    if available >= _PER_CLASS:
        return dict(PUBLISHED_SIZES)
    quotas = {split: available * size / _PER_CLASS for split, size in PUBLISHED_SIZES.items()}
    sizes = {split: int(quota) for split, quota in quotas.items()}
    by_remainder = sorted(SPLITS, key=lambda split: sizes[split] - quotas[split])
    for split in by_remainder[: available - sum(sizes.values())]:
        sizes[split] += 1
    # A split of a tiny source is empty only when there are fewer digits than splits: then the later ones are.
    for split in SPLITS:
        largest = max(SPLITS, key=lambda name: sizes[name])
        if sizes[split] == 0 and sizes[largest] > 1:
            sizes[largest] -= 1
            sizes[split] += 1
    return sizes


def _by_writer(catalog: DigitCatalog, spec: SplitSpec) -> dict[str, NDArray[np.int64]]:
    """Positions in the catalog of the digits of each split, whole writers at a time."""
    if len(catalog) and (catalog.writers == NO_WRITER).any():
        message = (
            "splits by writer need the writer of every digit, and the source does not know them; next: name "
            "the writer column (--writer-column) or split by digit"
        )
        raise InputError(message)
    sizes = PUBLISHED_SIZES if spec.sizes is None else dict(spec.sizes)
    shares = np.array([sizes.get(split, 0) for split in SPLITS], dtype=np.float64)
    if shares.sum() == 0:
        message = "all split sizes are 0; expected at least one split with digits"
        raise InputError(message)
    writers, counts = np.unique(catalog.writers, return_counts=True)
    split_of = _share_writers(writers, counts, shares / shares.sum(), spec.seed)
    return {
        split: np.flatnonzero(np.isin(catalog.writers, writers[split_of == index]))
        for index, split in enumerate(SPLITS)
    }


def _share_writers(
    writers: NDArray[np.int64], counts: NDArray[np.int64], shares: NDArray[np.float64], seed: int
) -> NDArray[np.int64]:
    """Return the index of each writer's split; every split with a share gets one while writers last."""
    wanted, given = shares * counts.sum(), np.zeros(len(SPLITS))
    split_of = np.full(len(writers), -1, dtype=np.int64)
    unserved = [int(split) for split in np.flatnonzero(shares)]
    for writer in np.argsort(_keys(writers, seed, stream=2)):
        split = unserved.pop(0) if unserved else int(np.argmax(wanted - given))
        split_of[writer] = split
        given[split] += counts[writer]
    return split_of


def _keys(ids: Sequence[int] | NDArray[np.int64], seed: int, stream: int) -> NDArray[np.uint64]:
    """Return a pseudo-random sort key per id.

    A bijective mixer of 64 bits (SplitMix64's finaliser) has no collisions between ids, so the order never
    depends on the sorting algorithm, and the key of an id never on which other ids there are.
    """
    offset = np.random.SeedSequence([seed, stream]).generate_state(1, np.uint64)[0]
    with np.errstate(over="ignore"):
        mixed = np.asarray(ids).astype(np.uint64) + offset
        mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return np.asarray(mixed ^ (mixed >> np.uint64(31)))
