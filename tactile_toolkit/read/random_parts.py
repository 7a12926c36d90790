"""Random orders and divisions that depend only on a seed and a number of items."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.array_types import Int64
from tactile_toolkit.checked_fields import checked_integer, is_integer
from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import with_count

# 0.7 + 0.2 + 0.1 is 0.9999999999999999.
_ROUNDING = 1e-9


def random_order(seed: int, length: int) -> Int64:
    """Return the numbers from 0 to below a length in random order."""
    return np.argsort(_random_bits(seed, length), kind="stable")


def random_parts(parts: Sequence[float], length: int, seed: int, labels: Int64 | None = None) -> list[Int64]:
    """Divide items at random; returns the numbers of the items of each part, in random order.

    With ``labels``, shape (length,), each class is divided in the same proportions, up to about one item.
    Raises InputError for impossible sizes.
    """
    ends = _part_ends(parts, length)
    order = random_order(seed, length)
    if labels is None:
        return np.split(order, ends)[: len(ends)]
    # Each class is spread evenly over 0 to 1, with its own offset, so that a cut anywhere divides all classes
    # in the same proportions, up to one item.
    labels = labels[order]
    classes, counts = np.unique(labels, return_counts=True)
    # Bits after those of the order, which does not depend on whether classes are used.
    starts = _random_bits(seed, length + len(classes))[length:] / 2.0**64
    spread = np.empty(length)
    for label, count, start in zip(classes, counts, starts, strict=True):
        spread[labels == label] = (np.arange(count) + start) / count
    part_of = np.empty(length, np.int64)
    part_of[np.argsort(spread, kind="stable")] = np.searchsorted(ends, np.arange(length), "right")
    return [order[part_of == part] for part in range(len(ends))]


def _random_bits(seed: int, count: int) -> NDArray[np.uint64]:
    """Return random bits of the stream of PCG64, which numpy guarantees, unlike its shuffles."""
    return np.asarray(np.random.PCG64(checked_integer(seed, "seed")).random_raw(count), np.uint64)


def _part_ends(parts: Sequence[float], length: int) -> list[int]:
    """Return the end of each part, including the remaining one; InputError for impossible sizes."""
    numbers, shares = is_integer(*parts), all(isinstance(part, float) and 0 <= part <= 1 for part in parts)
    total, whole = (sum(parts), length) if numbers or shares else (0, 0)
    whole = whole if numbers else 1
    if not parts or not (numbers or shares) or total > whole + _ROUNDING or min(parts) < 0:
        asked = ", ".join(map(repr, parts)) or "nothing"
        raise InputError(
            f"a split into {asked} was asked for; expected shares such as 0.8, 0.2 that add up to at most 1, "
            f"or integers that add up to at most {with_count(length, 'rows')}"
        )
    if numbers:
        ends = np.cumsum(parts).tolist()
    else:
        ends = np.minimum(np.round(np.cumsum(parts) * length), length).astype(int).tolist()
    return ends if total >= whole - _ROUNDING else [*ends, length]
