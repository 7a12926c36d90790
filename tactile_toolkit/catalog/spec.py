"""Which rows of a data set are taken, as commands have options of it; imported with nothing heavy."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeAlias

from tactile_toolkit.checked_fields import check_fields, integer, switch, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.parsed_text import comma_separated

_IDS = re.compile(r"(-?\d{1,20})(?:-(\d{1,20}))?", re.ASCII)

GivenId: TypeAlias = int | str | tuple[int, int]
"""An id, or the first and the last id of a range."""

IdChoice: TypeAlias = Sequence[GivenId]


def parse_ids(text: str) -> list[GivenId]:
    """Read ids such as ``3,17,40-60``: numbers, ranges, and words as they are.

    Ranges stay ranges, as the ids of a split are scattered: most numbers of a range belong to no row. Raises
    InputError for an id of no characters.
    """
    return [_as_id(word.strip()) for word in text.split(",")]


def _as_id(word: str) -> GivenId:
    if not word:
        raise InputError("--ids has ''; expected ids such as 3,17,40-60")
    try:
        low, high = id_range(word)
    except InputError:
        return word
    given = (low, high) if "-" in word[1:] else low
    # 007 is the number 7, but another text.
    return given if id_text(given) == word else word


def id_range(given: GivenId) -> tuple[int, int]:
    """Return the first and the last of the numbers that a given id stands for; InputError for other text."""
    if not isinstance(given, str):
        return given if isinstance(given, tuple) else (given, given)
    match = _IDS.fullmatch(given)
    low, high = (int(match[1]), int(match[2] or match[1])) if match is not None else (0, -1)
    if high < low:
        raise InputError(
            f"--ids has {given!r}, and these ids are numbers; expected numbers and ranges such as 3,17,40-60"
        )
    return low, high


def id_text(given: GivenId) -> str:
    """Return the text that a given id is where ids are text: ``2024-01`` is not a range there."""
    return "-".join(map(str, given)) if isinstance(given, tuple) else str(given)


# Each is the default of parameters, and of fields of groups, of one name: `dataclasses` notes it in them.
SPLIT = text(metavar="NAME", help="Only this split; all by default.")
ONE_SPLIT = text(metavar="NAME", help="Split to open; required if there are several.")
REVISION = text(metavar="REV", help="Branch, tag or commit of a Hub data set.")
CONFIG = text(metavar="NAME", help="Configuration, of a data set whose card has several.")
INCOMPLETE = switch(False, help="Take the finished shards of a data set whose run is not finished.")
IDS = text(name="--ids", metavar="3,17,40-60", read=parse_ids, help="Only the objects with these ids.")
LABELS = text(metavar="3,7", read=comma_separated, help="Only the objects of these classes.")
LIMIT = integer(None, 1, optional=True, help="Only the first N rows of each split.")
PER_CLASS = integer(None, 1, optional=True, help="Only the first N of each class, in each split.")


@dataclass(frozen=True, slots=True)
class RowFilter:
    """Options of all commands that take some of the objects of a data set."""

    split: str | None = SPLIT
    ids: IdChoice | None = IDS
    labels: Sequence[str] | None = LABELS
    per_class: int | None = PER_CLASS
    limit: int | None = LIMIT

    def given(self) -> dict[str, Any]:
        """Return what was asked for, by name; a split only where it is not ``all``."""
        named = {each.name: getattr(self, each.name) for each in fields(RowFilter)}
        return {**named, "split": None if self.split == "all" else self.split}


NO_FILTER = RowFilter()


@dataclass(frozen=True, slots=True)
class PreviewSpec(RowFilter):
    """Which pictures of a data set of meshes to draw.

    Without kinds a sheet; without a split all of them; without ids the first ``per_class`` rows of each class
    on a sheet, and the first row where one is shown alone. With ``labels`` only rows of these classes. Of all
    these, the first ``limit`` of each split.
    """

    per_class: int = integer(10, 1, help="Objects of each class on a sheet.")
    kinds: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_fields(self, "the previews")
