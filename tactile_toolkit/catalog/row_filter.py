"""Options of commands that choose rows of a data set; imports nothing heavy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

from tactile_toolkit.catalog.ids import IdChoice, parse_ids
from tactile_toolkit.checked_fields import check_fields, integer, switch, text
from tactile_toolkit.json_types import JsonDict
from tactile_toolkit.parsed_text import comma_separated

# Each is the default of all parameters and fields of its name: `dataclasses` notes the name in it.
SPLIT = text(metavar="NAME", help="Only this split; all by default.")
ONE_SPLIT = text(metavar="NAME", help="Split to open; required if there are several.")
REVISION = text(metavar="REV", help="Branch, tag or commit of a Hub data set.")
CONFIG = text(metavar="NAME", help="Configuration, if the card of the data set has several.")
INCOMPLETE = switch(False, help="Use the finished shards of an unfinished data set.")
IDS = text(name="--ids", metavar="3,17,40-60", read=parse_ids, help="Only the objects with these ids.")
LABELS = text(metavar="3,7", read=comma_separated, help="Only the objects of these classes.")
LIMIT = integer(None, 1, optional=True, help="Only the first N rows of each split.")
PER_CLASS = integer(None, 1, optional=True, help="Only the first N of each class, in each split.")


@dataclass(frozen=True, slots=True)
class RowFilter:
    """Options of commands that take some of the objects of a data set."""

    split: str | None = SPLIT
    ids: IdChoice | None = IDS
    labels: Sequence[str] | None = LABELS
    per_class: int | None = PER_CLASS
    limit: int | None = LIMIT

    def given(self) -> JsonDict:
        """Return the options by name; the split ``all`` becomes None."""
        named = {each.name: getattr(self, each.name) for each in fields(RowFilter)}
        return {**named, "split": None if self.split == "all" else self.split}


NO_FILTER = RowFilter()


@dataclass(frozen=True, slots=True)
class PreviewSpec(RowFilter):
    """Options of the previews of a data set of meshes.

    Without ``kinds`` a sheet is drawn; without ``split`` all splits; without ``ids`` the first ``per_class``
    rows of each class on a sheet, or the first row in a single picture. With ``labels`` only rows of these
    classes are taken. Finally, the first ``limit`` of each split are taken.
    """

    per_class: int = integer(10, 1, help="Objects of each class on a sheet.")
    kinds: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_fields(self, "the previews")
