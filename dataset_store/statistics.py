"""Counts that shards report and that add up: numbers, lists of numbers, and mappings of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import zip_longest
from typing import Any

__all__ = ["add_up"]


def add_up(parts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Add the counts of several shards, key by key; lists add place by place, a missing place counts 0.

    Parameters
    ----------
    parts : sequence of mapping
        Numbers, lists of numbers, or mappings of them by name.

    Returns
    -------
    dict
        With the keys of all parts, in the order in which they are met first.
    """
    names = dict.fromkeys(name for part in parts for name in part)
    return {name: _sum([part[name] for part in parts if name in part]) for name in names}


def _sum(values: Sequence[Any]) -> Any:
    if isinstance(values[0], Mapping):
        return add_up(values)
    if isinstance(values[0], Sequence):
        return [sum(places) for places in zip_longest(*values, fillvalue=0)]
    return sum(values)
