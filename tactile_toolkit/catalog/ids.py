"""Ids as users give them: numbers, ranges of numbers, and texts."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TypeAlias

from tactile_toolkit.errors import InputError

_IDS = re.compile(r"(-?\d{1,20})(?:-(\d{1,20}))?", re.ASCII)

GivenId: TypeAlias = int | str | tuple[int, int]
"""An id, or the first and the last id of a range."""

IdChoice: TypeAlias = Sequence[GivenId]


def parse_ids(text: str) -> list[GivenId]:
    """Read ids such as ``3,17,40-60``: numbers, ranges, and other words unchanged.

    Ranges are not expanded, because most of their numbers may belong to no row. Raises InputError for an
    empty id.
    """
    return [_as_id(word.strip()) for word in text.split(",")]


def _as_id(word: str) -> GivenId:
    if not word:
        raise InputError("--ids has ''; expected ids such as 3,17,40-60")
    try:
        low, high = id_range(word)
    except InputError:
        return word
    given: GivenId = low
    if "-" in word[1:]:
        given = (low, high)
    # 007 is the number 7, but a different text.
    if id_text(given) == word:
        return given
    return word


def id_range(given: GivenId) -> tuple[int, int]:
    """Return the first and the last number of a given id; InputError for other text."""
    if not isinstance(given, str):
        if isinstance(given, tuple):
            return given
        return (given, given)
    match = _IDS.fullmatch(given)
    if match is None or int(match[2] or match[1]) < int(match[1]):
        raise InputError(
            f"--ids has {given!r}, and these ids are numbers; expected numbers and ranges such as 3,17,40-60"
        )
    return int(match[1]), int(match[2] or match[1])


def id_text(given: GivenId) -> str:
    """Return a given id as text: where ids are texts, ``2024-01`` is not a range."""
    if isinstance(given, tuple):
        return "-".join(map(str, given))
    return str(given)
