"""Which digit goes into which split: a pure function of seed and ids.

The five splits and their sizes are those of MNIST 3D (Tactile MNIST paper, table of the MNIST 3D splits; the
table prints the name of the last one as ``printed_train`` a second time).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mnist3d.sources import NO_WRITER, DigitCatalog
from mnist3d.spec import PUBLISHED_SIZES, SPLITS, SplitSpec
from tactile_toolkit.errors import InputError

__all__ = ["PUBLISHED_SIZES", "SPLITS", "SplitPlan", "SplitSpec", "plan_splits"]

_PER_CLASS = sum(PUBLISHED_SIZES.values())
_CLASSES = 10

# 1 MB of each column: what is computed of a part stays in the processor's cache.
_PART = 1 << 17
_BUCKETS = 256
_BUCKET_SHIFT = np.uint64(56)
# From here on ids of 32 bits where they fit: those of 10^8 digits take 0.4 GB instead of 0.8.
_SMALL_SOURCE = 1 << 24


@dataclass(frozen=True, slots=True, eq=False)
class SplitPlan:
    """The division of a source's digits: ids and labels of each split, shape (n,).

    They are in row order, a seeded shuffle that mixes the classes. Ids are int64, or uint32 where the source
    has more than 16 million digits; labels are uint8.
    """

    ids: dict[str, NDArray[np.integer[Any]]]
    labels: dict[str, NDArray[np.uint8]]

    def rows(
        self, split: str, per_class: int | None = None, limit: int | None = None
    ) -> NDArray[np.integer[Any]]:
        """Return the ids to make of a split: the first ``per_class`` of each class, then ``limit`` rows."""
        ids, labels = self.ids[split], self.labels[split]
        if per_class is not None:
            kept = np.zeros(len(labels), bool)
            for label in range(_CLASSES):
                kept[np.flatnonzero(labels == label)[:per_class]] = True
            ids = ids[kept]
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
    divide = {"writer": _by_writer, "none": _undivided}.get(spec.by or "", _by_digit)
    split_of = divide(catalog, spec)
    plan = SplitPlan({}, {})
    for number, split in enumerate(SPLITS):
        plan.ids[split], plan.labels[split] = _in_row_order(catalog, split_of == number, spec.seed)
    return plan


def _parts(catalog: DigitCatalog) -> Iterator[tuple[slice, DigitCatalog]]:
    """Yield a catalog part by part, so that what is computed of it stays small beside it."""
    for start in range(0, len(catalog), _PART):
        place = slice(start, min(start + _PART, len(catalog)))
        yield place, catalog.part(place.start, place.stop)


def _in_row_order(
    catalog: DigitCatalog, chosen: NDArray[np.bool_], seed: int
) -> tuple[NDArray[np.integer[Any]], NDArray[np.uint8]]:
    """Return ids and labels of some digits in the order of their rows."""

    # A key of its own orders the rows, so that the rank that chose the split does not show in them.
    def keys(ids: NDArray[np.integer[Any]]) -> NDArray[np.uint64]:
        return _keys(ids, seed, stream=1)

    # Keys of 10^8 digits and their order would take 1.6 GB. So digits are shared out by how their keys begin,
    # and what begins alike is put in order on its own.
    counts = np.zeros(_BUCKETS, np.int64)
    for place, part in _parts(catalog):
        counts += np.bincount(keys(part.ids[chosen[place]]) >> _BUCKET_SHIFT, minlength=_BUCKETS)
    stops = np.cumsum(counts)
    free = stops - counts
    ids = np.empty(stops[-1], _id_type(catalog))
    labels = np.empty(stops[-1], np.uint8)
    for place, part in _parts(catalog):
        found = np.flatnonzero(chosen[place])
        buckets = (keys(part.ids[found]) >> _BUCKET_SHIFT).astype(np.uint8)
        found = found[np.argsort(buckets, kind="stable")]
        taken = np.bincount(buckets, minlength=_BUCKETS)
        places = np.repeat(free + taken - np.cumsum(taken), taken) + np.arange(len(found))
        ids[places], labels[places] = part.ids[found], _small_labels(part)[found]
        free += taken
    for bucket in map(slice, stops - counts, stops):
        order = np.argsort(keys(ids[bucket]))
        ids[bucket], labels[bucket] = ids[bucket][order], labels[bucket][order]
    return ids, labels


def _small_labels(part: DigitCatalog) -> NDArray[np.uint8]:
    """Return the labels of a part in a byte each; one that is no digit stays none."""
    return np.minimum(part.labels.astype(np.uint64), np.uint64(255)).astype(np.uint8)


def _id_type(catalog: DigitCatalog) -> type[np.integer[Any]]:
    last = catalog.part(len(catalog) - 1, len(catalog)).ids if len(catalog) else np.zeros(1)
    is_small = len(catalog) <= _SMALL_SOURCE or last[0] > np.iinfo(np.uint32).max
    return np.int64 if is_small else np.uint32


def _undivided(catalog: DigitCatalog, spec: SplitSpec) -> NDArray[np.uint8]:
    return np.full(len(catalog), SPLITS.index("train"), np.uint8)


def _by_digit(catalog: DigitCatalog, spec: SplitSpec) -> NDArray[np.uint8]:
    """Return the index of each digit's split, or how many splits there are where it is in none."""
    split_of = np.full(len(catalog), len(SPLITS), np.uint8)
    labels = np.empty(len(catalog), np.uint8)
    for place, part in _parts(catalog):
        labels[place] = _small_labels(part)
    for label in range(_CLASSES):
        is_member = labels == label
        ids = np.concatenate([part.ids[is_member[place]] for place, part in _parts(catalog)] or [labels])
        keys = _keys(ids, spec.seed, stream=0)
        sizes = _sizes_of(label, len(ids), spec)
        stops = np.cumsum([sizes[split] for split in SPLITS])
        # The first of each class by their keys go to the first split, the next to the second.
        within = stops[stops < len(ids)]
        # Not sorted: which keys are the lowest counts here; in which order they come, later.
        bounds = np.partition(keys, within)[within] if len(within) else keys[:0]
        split_of[is_member] = np.searchsorted(bounds, keys, side="right")
    return split_of


def _sizes_of(label: int, available: int, spec: SplitSpec) -> dict[str, int]:
    """Return how many digits of a class go into each split."""
    if spec.sizes is None or not available:  # a class that the source does not have is in no split
        return _published_sizes(available)
    sizes = {split: dict(spec.sizes).get(split, 0) for split in SPLITS}
    wanted = sum(sizes.values())
    if wanted > available:
        message = (
            f"the split sizes ask for {wanted} digits per class, the source has {available} of class "
            f"{label}; next: ask for smaller sizes or use a larger source"
        )
        raise InputError(message)
    return sizes


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


def _by_writer(catalog: DigitCatalog, spec: SplitSpec) -> NDArray[np.uint8]:
    """Return the index of each digit's split, whole writers at a time."""
    sizes = PUBLISHED_SIZES if spec.sizes is None else dict(spec.sizes)
    shares = np.array([sizes.get(split, 0) for split in SPLITS], dtype=np.float64)
    found = [np.unique(part.writers, return_counts=True) for _, part in _parts(catalog)]
    writers, inverse = np.unique(
        np.concatenate([each for each, _ in found] or [np.zeros(0, np.int64)]), return_inverse=True
    )
    if NO_WRITER in writers:
        message = (
            "splits by writer need the writer of every digit, and the source does not know them; next: name "
            "the writer column (--writer-column) or split by digit"
        )
        raise InputError(message)
    if shares.sum() == 0:
        message = "all split sizes are 0; expected at least one split with digits"
        raise InputError(message)
    counts = np.zeros(len(writers), np.int64)
    np.add.at(counts, inverse, np.concatenate([each for _, each in found] or [np.zeros(0, np.int64)]))
    home = _share_writers(writers, counts, shares / shares.sum(), spec.seed).astype(np.uint8)
    split_of = np.empty(len(catalog), np.uint8)
    for place, part in _parts(catalog):
        split_of[place] = home[np.searchsorted(writers, part.writers)]
    return split_of


def _share_writers(
    writers: NDArray[np.int64], counts: NDArray[np.int64], shares: NDArray[np.float64], seed: int
) -> NDArray[np.int64]:
    """Return the index of each writer's split; every split with a share gets one while writers last."""
    wanted, given = shares * counts.sum(), np.zeros(len(SPLITS))
    split_of = np.full(len(writers), -1, dtype=np.int64)
    # Every split first gets a writer: by shares alone, small ones of few writers would stay empty.
    unserved = [int(split) for split in np.flatnonzero(shares)]
    for writer in np.argsort(_keys(writers, seed, stream=2)):
        split = unserved.pop(0) if unserved else int(np.argmax(wanted - given))
        split_of[writer] = split
        given[split] += counts[writer]
    return split_of


def _keys(ids: NDArray[np.integer[Any]], seed: int, stream: int) -> NDArray[np.uint64]:
    """Return a pseudo-random sort key per id.

    A bijective mixer of 64 bits (SplitMix64's finaliser) has no collisions between ids, so the order never
    depends on the sorting algorithm, and the key of an id never on which other ids there are.
    """
    offset = np.random.SeedSequence([seed, stream]).generate_state(1, np.uint64)[0]
    with np.errstate(over="ignore"):
        mixed = np.asarray(ids).astype(np.uint64)
        mixed += offset
        mixed ^= mixed >> np.uint64(30)
        mixed *= np.uint64(0xBF58476D1CE4E5B9)
        mixed ^= mixed >> np.uint64(27)
        mixed *= np.uint64(0x94D049BB133111EB)
        mixed ^= mixed >> np.uint64(31)
        return mixed
