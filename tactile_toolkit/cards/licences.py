"""Licences of data sets: that of one, those of the rows of a merged one, and the strictest of several."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable
from typing import NamedTuple

from tactile_toolkit import places
from tactile_toolkit.cards import yaml_head
from tactile_toolkit.cards.owner import LICENCES
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import PublishedSet
from tactile_toolkit.wording import markdown_code

SOURCE_ID = "source_id"
LICENCE = "licence"
"""Columns of merged rows: the id of a row in its data set, and the licence of that."""
SOURCE_NAMES = ("source_set", "source")
"""Column of the data set of merged rows; the first if rows have a column ``source`` of their own."""
UNKNOWN = "unknown"
_OTHER = "other"
# Rows under these can be given under no other licence, as those with the conditions sa and nd.
_SHARE_ALIKE = ("odbl", "cdla-sharing", "gpl", "lgpl", "agpl", "gfdl", "mpl", "eupl")
_NO_CONDITIONS = ("cc0-1.0", "pddl", "unlicense")


class SourceRows(NamedTuple):
    """Rows of a data set that was merged: its name, its licence and their number."""

    source: str
    licence: str
    rows: int


def licence_of(place: places.Place) -> str:
    """Return the identifier of the licence that the card of a data set states; ``"unknown"`` without one."""
    stated: object = None
    repository = place.repository or place.download
    if place.folder is not None:
        stated = yaml_head.stored_head(place.folder).get("license")
    if repository is not None and not stated:
        known = PublishedSet.named(repository.repo_id)
        stated = getattr(repository, "licence", None) or (known and known.licence)
    if not isinstance(stated, str) or not stated.isprintable():
        return UNKNOWN
    return stated.lower().replace(" ", "-")


def inherited_options(sources: Iterable[places.Place]) -> dict[str, str]:
    """Return, for the specification of a copy, what its sources state.

    ``unfinished`` is how much of each unfinished one was finished, ``licence`` the licence of all; each is
    left out if there is none.
    """
    opened = list(sources)
    options: dict[str, str] = {}
    licence = strictest({licence_of(source) for source in opened})
    if licence != UNKNOWN:
        options[LICENCE] = licence
    counts = [source.unfinished for source in opened if source.unfinished]
    if counts:
        options["unfinished"] = ", ".join(counts)
    return options


def source_column(names: Collection[str]) -> str:
    """Return the column that states the data set of merged rows; empty if they were not merged."""
    if not {SOURCE_ID, LICENCE} <= {*names}:
        return ""
    return next((name for name in SOURCE_NAMES if name in names), "")


def rows_by_source(facts: yaml_head.FolderSummary) -> list[SourceRows]:
    """Return the sources of the rows of a merged data set; empty for all others."""
    source = source_column(facts.schema.names)
    if not source:
        return []
    rows = facts.table
    pairs = zip(rows.column(source).tolist(), rows.column(LICENCE).tolist(), strict=True)
    counts = Counter((name or "", licence or UNKNOWN) for name, licence in pairs)
    return [SourceRows(*pair, count) for pair, count in counts.items()]


def strictest(licences: Collection[str]) -> str:
    """Return the licence whose conditions hold those of all others; ``"other"`` if there is none."""
    chosen = [licence for licence in licences if all(allows(licence, other) for other in licences)]
    return max(chosen, key=LICENCES.index, default=_OTHER) if len(set(licences)) > 1 else next(iter(licences))


def allows(licence: str, stated: str) -> bool:
    """Return whether rows under the licence ``stated`` may be given under another."""
    if licence == stated:
        return True
    if not {licence, stated} <= set(LICENCES) - {_OTHER, UNKNOWN} or stated.startswith(_SHARE_ALIKE):
        return False
    conditions = set(stated.split("-")) & {"nc", "nd", "sa"}
    asks_for_names = licence not in _NO_CONDITIONS or stated in _NO_CONDITIONS
    return asks_for_names and conditions <= {"nc"} & set(licence.split("-"))


def require_strictest(licence: str, sources: Collection[SourceRows]) -> None:
    """Refuse a licence that hides a stricter one of the rows (InputError)."""
    hidden = next((source for source in sources if not allows(licence, source.licence)), None)
    if hidden is not None:
        raise InputError(
            f"is {licence}, and {hidden.rows:,} rows of {hidden.source!r} are under {hidden.licence!r}; "
            "expected a licence that keeps its conditions",
            next=f"leave it out, or state that of the source (`tactile card SOURCE --license {licence}`, if "
            "it is yours) and merge again",
            field="license",
        )


def licence_text(sources: Collection[SourceRows]) -> str:
    """Return the licence section of the card of a merged data set."""
    licence = strictest([source.licence for source in sources])
    text = f"Each row keeps the licence of its source (column `licence`). The strictest is {licence}."
    if licence == _OTHER:
        text = "Each row keeps the licence of its source (column `licence`); no single one holds for all."
    lines = [
        f"- {markdown_code(source.source)}: {source.licence}, {source.rows:,} rows" for source in sources
    ]
    return f"{text}\n\n" + "\n".join(lines)
