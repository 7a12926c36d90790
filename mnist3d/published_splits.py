"""The table of the MNIST 3D splits, and the specification of a division into splits."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Literal

from tactile_toolkit.checked_fields import (
    check_fields,
    choice,
    integer,
    read_split_counts,
    split_counts,
    text,
)
from tactile_toolkit.errors import InputError
from tactile_toolkit.json_types import JsonDict

SPLITS = ("train", "test", "holdout", "printed_train", "printed_test")
"""The five splits in canonical order, in which scarce digits are assigned, too."""

PUBLISHED_SIZES: dict[str, int] = {
    "train": 1148,
    "test": 100,
    "holdout": 50,
    "printed_train": 50,
    "printed_test": 10,
}
"""Digits per class in each published split, 1,358 in total."""

OWN_SIZES: dict[str, int] = {"train": 4, "test": 1}
"""Proportions of the splits of pictures in a folder, which have not been printed."""

MAX_DIGITS = 1_000_000_000
"""Largest number of digits of a source or a split."""


@dataclass(frozen=True, slots=True)
class SplitSpec:
    """Division of digits into splits.

    Attributes
    ----------
    seed : int
        Seed of the division.
    by : {"digit", "writer", "none"}, or None
        ``"digit"`` draws single digits, with exact sizes per class. ``"writer"`` assigns whole writers to
        splits, with sizes as near as that allows. ``"none"`` divides nothing: all digits are in ``train``.
        None means ``"none"`` for a folder of images if neither splits nor sizes are given, otherwise
        ``"digit"``.
    sizes : tuple of (str, int), or None
        Digits per class of each split; a mapping is accepted, too. None means the published sizes, or their
        proportions for a class of fewer than 1,358 digits. A folder of images is divided into four fifths
        for ``train`` and one for ``test``.
    """

    seed: int = integer(0, help="Random seed.")
    by: Literal["digit", "writer", "none"] | None = choice(
        None,
        ("digit", "writer", "none"),
        optional=True,
        name="--split-by",
        shown="digit",
        help="Divide by digit, by writer (all digits of a writer are in one split), or not at all (all "
        "digits are in train).",
    )
    sizes: tuple[tuple[str, int], ...] | None = text(
        name="--split-sizes",
        metavar="train=8,test=2",
        read=partial(read_split_counts, "--split-sizes"),
        help="Digits per class in each split, instead of the published numbers.",
    )

    def __post_init__(self) -> None:
        check_fields(self, "the division into splits")
        if self.sizes is None:
            return
        if self.by == "none":
            raise InputError(
                "split sizes are given for digits that are not divided; expected by='digit' or 'writer'",
                next="leave out sizes (--split-sizes), or change by (--split-by)",
            )
        sizes = split_counts(self.sizes, "sizes of the division into splits", SPLITS, MAX_DIGITS)
        object.__setattr__(self, "sizes", sizes)

    def to_dict(self) -> JsonDict:
        """Return JSON values."""
        sizes = dict(self.sizes or ())
        return {"seed": self.seed, "by": self.by or "digit", "sizes": sizes or None}
