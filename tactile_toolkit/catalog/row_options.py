"""Options of commands that choose rows of a data set; imports nothing heavy."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import ClassVar, TypeAlias

from tactile_toolkit.checked_fields import check_fields, integer, is_integer, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import JsonDict
from tactile_toolkit.wording import comma_separated

_IDS = re.compile(r"(-?\d{1,20})(?:-(\d{1,20}))?", re.ASCII)
IdOrRange: TypeAlias = int | str | tuple[int, int]
"""An id, or the first and the last id of a range."""
IdChoice: TypeAlias = Sequence[IdOrRange]


def parse_ids(text: str) -> list[IdOrRange]:
    """Read ids such as ``3,17,40-60``: numbers, ranges, and other words unchanged.

    Ranges are not expanded, because most of their numbers may belong to no row. Raises InputError for an
    empty id.
    """
    return [_as_id(word.strip()) for word in text.split(",")]


def _as_id(word: str) -> IdOrRange:
    if not word:
        raise InputError("has ''; expected ids such as 3,17,40-60", field="ids")
    try:
        low, high = id_range(word)
    except InputError:
        return word
    choice: IdOrRange = low
    if "-" in word[1:]:
        choice = (low, high)
    # 007 is the number 7, but a different text.
    if id_text(choice) == word:
        return choice
    return word


def id_range(choice: IdOrRange) -> tuple[int, int]:
    """Return the first and the last number of an id or a range; InputError for other text."""
    if not isinstance(choice, str):
        ends = choice if isinstance(choice, tuple) else (choice, choice)
        if len(ends) != 2 or not is_integer(*ends):
            raise InputError(
                f"has {choice!r}; expected integers, texts, or pairs of the first and the last integer",
                field="ids",
            )
        return ends
    match = _IDS.fullmatch(choice)
    if match is None or int(match[2] or match[1]) < int(match[1]):
        raise InputError(
            f"has {choice!r}, and these ids are numbers; expected numbers and ranges such as 3,17,40-60",
            field="ids",
        )
    return int(match[1]), int(match[2] or match[1])


def id_text(choice: IdOrRange) -> str:
    """Return an id or a range as text: where ids are texts, ``2024-01`` is not a range."""
    if isinstance(choice, tuple):
        return "-".join(map(str, choice))
    return str(choice)


ROWS = "Rows"
"""Panel of the help for options that choose rows."""
# Each is the default of all parameters and fields of its name: `dataclasses` notes the name in it.
SPLIT = text(metavar="NAME", panel=ROWS, help="Only this split; all by default.")
LIMIT = integer(None, 1, optional=True, panel=ROWS, help="Only the first N rows of each split.")
PER_CLASS = integer(None, 1, optional=True, panel=ROWS, help="Only the first N of each class, in each split.")


@dataclass(frozen=True, slots=True)
class RowFilter:
    """Options of commands that take some of the objects of a data set."""

    ALL: ClassVar[RowFilter]
    """Takes all objects."""

    split: str | None = SPLIT
    ids: IdChoice | None = text(
        name="--ids",
        metavar="3,17,40-60",
        panel=ROWS,
        read=parse_ids,
        help="Only the objects with these ids.",
    )
    labels: Sequence[str] | None = text(
        metavar="3,7", panel=ROWS, read=comma_separated, help="Only the objects of these classes."
    )
    per_class: int | None = PER_CLASS
    limit: int | None = LIMIT

    def given(self) -> JsonDict:
        """Return the options by name; the split ``all`` becomes None."""
        named = {option.name: getattr(self, option.name) for option in fields(RowFilter)}
        return {**named, "split": None if self.split == "all" else self.split}


RowFilter.ALL = RowFilter()


@dataclass(frozen=True, slots=True)
class PreviewSpec(RowFilter):
    """Options of the previews of a data set of meshes.

    Without ``kinds`` a sheet is drawn; without ``split`` all splits; without ``ids`` the first ``per_class``
    rows of each class on a sheet, or the first row in a single picture. With ``labels`` only rows of these
    classes are taken. Finally, the first ``limit`` of each split are taken.
    """

    per_class: int = integer(10, 1)
    kinds: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_fields(self, "the previews")
