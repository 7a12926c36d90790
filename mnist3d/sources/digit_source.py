"""Digit images, where they come from, and their division into splits: a pure function of seed and ids."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mnist3d.digit_options import PUBLISHED_SIZES, SPLITS, SplitSpec
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.value_types import Int64, UInt8

NO_WRITER = -1
"""Writer number of digits whose writer is unknown."""
DIGITS = tuple("0123456789")
"""Names of the classes of digits."""


@dataclass(frozen=True, slots=True, eq=False)
class DigitImage:
    """One handwritten digit.

    Attributes
    ----------
    id : int
        Number of the digit in its source (in HWD+: the row of the image array).
    label : int
        The digit written, 0 to 9, or the number of another class.
    pixels : ndarray of uint8, shape (H, W)
        Grey levels, always dark ink (0) on light paper (255). Row 0 is the top of the digit as it is read.
    writer : int
        Number of the writer in the source, or -1.
    file : str or None
        Name of the picture, if the source is a folder of files.
    """

    id: int
    label: int
    pixels: UInt8
    writer: int = NO_WRITER
    file: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class DigitCatalog:
    """The content of a source without its pixels: three arrays of one length.

    Attributes
    ----------
    ids : ndarray of int64, shape (N,)
        Distinct, in increasing order.
    labels : ndarray of int64, shape (N,)
        Class of each id, a place in ``class_names``: the digit, 0 to 9.
    writers : ndarray of int64, shape (N,)
        Writer of each id, or -1 where the source states none.
    class_names : tuple of str
        Names of the classes, the ten digits by default.
    has_files : bool
        Whether these are a user's own pictures: each has the name of its file, and no splits are published.
    """

    ids: Int64
    labels: Int64
    writers: Int64
    class_names: tuple[str, ...] = DIGITS
    has_files: bool = False

    def __len__(self) -> int:
        """Return the number of digits."""
        return len(self.ids)


class DigitSource(Protocol):
    """A collection of labelled digit images.

    Sources are small frozen dataclasses of paths, seeds and options. They open their files on first use in
    each process, and never hold all images in memory.
    """

    @property
    def name(self) -> str:
        """Word that selects this source on the command line (``--source``)."""
        ...

    def fingerprint(self) -> dict[str, object]:
        """Return JSON values that identify the content.

        They hold no path of the machine: the same files in another folder are the same source.
        """
        ...

    def catalog(self) -> DigitCatalog:
        """Return ids, labels and writers without reading pixels."""
        ...

    def image(self, digit_id: int) -> DigitImage:
        """Read or draw one digit.

        Raises
        ------
        ItemError
            This image cannot be used (unreadable, wrong shape, NaN pixels). A run lists it and continues.
        """
        ...


def require_known(digit_id: int, count: int, source: str) -> None:
    """Raise ItemError for an id that a source of ``count`` digits does not have."""
    if not 0 <= digit_id < count:
        message = f"{source}: found id {digit_id}, expected 0 to {count - 1}"
        raise ItemError("unknown-id", message, next="choose an id in this range")


@dataclass(frozen=True, slots=True, eq=False)
class SplitPlan:
    """The division of the digits of a source: ids and labels of each split, shape (n,).

    They are in row order, a seeded shuffle that mixes the classes.
    """

    ids: dict[str, Int64]
    labels: dict[str, Int64]

    def rows(self, split: str, per_class: int | None = None, limit: int | None = None) -> Int64:
        """Return the ids to make of a split: the first ``per_class`` of each class, then ``limit`` rows."""
        ids, labels = self.ids[split], self.labels[split]
        if per_class is not None:
            kept = np.zeros(len(labels), bool)
            for label in np.unique(labels):
                kept[np.flatnonzero(labels == label)[:per_class]] = True
            ids = ids[kept]
        return ids[:limit]


def plan_splits(
    catalog: DigitCatalog, spec: SplitSpec, usual: Mapping[str, int] = PUBLISHED_SIZES
) -> SplitPlan:
    """Divide the digits of a source into splits.

    No digit is in two splits. The split of a digit depends only on the seed and the ids of its source.

    Parameters
    ----------
    catalog : DigitCatalog
        Content of the source.
    spec : SplitSpec
        How to divide it.
    usual : mapping
        Digits per class of each split, in proportion, if ``spec`` states none; the published ones by default.

    Returns
    -------
    SplitPlan
        ``ids`` and ``labels`` of each split.

    Raises
    ------
    InputError
        A class has fewer digits than ``spec.sizes`` needs, or writers are needed and unknown.
    """
    if spec.by == "none":
        split_of = np.full(len(catalog), SPLITS.index("train"))
    elif spec.by == "writer":
        split_of = _by_writer(catalog, spec, usual)
    else:
        split_of = _by_digit(catalog, spec, usual)
    plan = SplitPlan({}, {})
    for number, split in enumerate(SPLITS):
        chosen = np.flatnonzero(split_of == number)
        # Rows are ordered by another key than the one that chose the split.
        order = chosen[np.argsort(_keys(catalog.ids[chosen], spec.seed, stream=1))]
        plan.ids[split], plan.labels[split] = catalog.ids[order], catalog.labels[order]
    return plan


def _by_digit(catalog: DigitCatalog, spec: SplitSpec, usual: Mapping[str, int]) -> Int64:
    """Return the index of the split of each digit, -1 for a digit that is in no split."""
    split_of = np.full(len(catalog), -1)
    for label, name in enumerate(catalog.class_names):
        members = np.flatnonzero(catalog.labels == label)
        # By their keys, the first digits of a class go to the first split, the next to the second.
        order = members[np.argsort(_keys(catalog.ids[members], spec.seed, stream=0))]
        sizes = _sizes_of(name, len(members), spec, usual)
        home = np.repeat(np.arange(len(SPLITS)), [sizes[split] for split in SPLITS])
        split_of[order[: len(home)]] = home
    return split_of


def _sizes_of(name: str, available: int, spec: SplitSpec, usual: Mapping[str, int]) -> dict[str, int]:
    """Return the number of digits of a class in each split."""
    if spec.sizes is None or not available:  # a class that the source lacks is in no split
        return _usual_sizes(available, usual)
    sizes = {split: dict(spec.sizes).get(split, 0) for split in SPLITS}
    needed = sum(sizes.values())
    if needed > available:
        raise InputError(
            f"the split sizes ask for {needed} digits per class, the source has {available} of class {name}",
            next="ask for smaller sizes or use a larger source",
        )
    return sizes


def _usual_sizes(available: int, usual: Mapping[str, int]) -> dict[str, int]:
    """Return the published sizes, or for a smaller class their proportions (largest remainders)."""
    sizes = dict.fromkeys(SPLITS, 0)
    per_class = sum(usual.values())
    if usual == PUBLISHED_SIZES and available >= per_class:
        return dict(PUBLISHED_SIZES)
    quotas = {split: available * size / per_class for split, size in usual.items()}
    sizes |= {split: int(quota) for split, quota in quotas.items()}
    by_remainder = sorted(quotas, key=lambda split: sizes[split] - quotas[split])
    for split in by_remainder[: available - sum(sizes.values())]:
        sizes[split] += 1
    # Splits are empty only if there are fewer digits than splits; then the last splits are.
    for split in quotas:
        largest = max(quotas, key=lambda name: sizes[name])
        if sizes[split] == 0 and sizes[largest] > 1:
            sizes[largest] -= 1
            sizes[split] += 1
    return sizes


def _by_writer(catalog: DigitCatalog, spec: SplitSpec, usual: Mapping[str, int]) -> Int64:
    """Return the index of the split of each digit, the same for all digits of a writer.

    Sizes are as near to those of the specification as whole writers allow.
    """
    sizes = usual if spec.sizes is None else dict(spec.sizes)
    shares = np.array([sizes.get(split, 0) for split in SPLITS], dtype=np.float64)
    writers, inverse, counts = np.unique(catalog.writers, return_inverse=True, return_counts=True)
    if NO_WRITER in writers:
        raise InputError(
            "splits by writer need the writer of every digit, and the source does not state all writers",
            next="name the writer column (--writer-column) or split by digit",
        )
    if shares.sum() == 0:
        raise InputError(
            "all split sizes are 0; expected at least one split with digits",
            next="raise a size (--split-sizes)",
        )
    targets = shares / shares.sum() * counts.sum()
    assigned = np.zeros(len(SPLITS))
    split_of = np.full(len(writers), -1, dtype=np.int64)
    # Every split first gets a writer; by shares only, small splits of few writers would stay empty.
    unserved = [int(split) for split in np.flatnonzero(shares)]
    for writer in np.argsort(_keys(writers, spec.seed, stream=2)):
        split = unserved.pop(0) if unserved else int(np.argmax(targets - assigned))
        split_of[writer] = split
        assigned[split] += counts[writer]
    return split_of[inverse]


def _keys(ids: Int64, seed: int, stream: int) -> NDArray[np.uint64]:
    """Return a pseudo-random sort key per id.

    The finaliser of SplitMix64 is bijective, so ids have no collisions and the order does not depend on the
    sorting algorithm. The key of an id does not depend on other ids.
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
