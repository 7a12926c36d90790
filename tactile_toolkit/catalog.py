"""Rows of data sets: the options by which they are chosen, the choice, and checks in several processes.

Commands import this module for their options: libraries are imported where rows are chosen or checked.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, Generic, NamedTuple, TypeAlias, TypeVar

from tactile_toolkit import checked_fields, mesh, places, read, run, store
from tactile_toolkit.checked_fields import check_fields, integer, is_integer, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.value_types import Bool, Int64, JsonDict, JsonValue
from tactile_toolkit.wording import comma_separated

_IDS = re.compile(r"(-?\d{1,20})(?:-(\d{1,20}))?", re.ASCII)
IdOrRange: TypeAlias = int | str | tuple[int, int]
"""An id, or the first and the last id of a range."""
IdChoice: TypeAlias = Sequence[IdOrRange]

_ROWS = "Rows"  # panel of the help
_ROW_OPTIONS: dict[str, Callable[..., checked_fields.Declared]] = {
    "split": partial(text, metavar="NAME", help="Only this split; all by default."),
    "limit": partial(integer, None, 1, optional=True, help="Only the first N rows of each split."),
    "per_class": partial(
        integer, None, 1, optional=True, help="Only the first N of each class, in each split."
    ),
}


def row_option(field: str, **option: JsonValue) -> checked_fields.Declared:
    """Declare one of the options ``split``, ``limit`` and ``per_class``, by which rows are chosen.

    ``option`` are further facts, as of :class:`~tactile_toolkit.checked_fields.OptionText`.
    """
    return _ROW_OPTIONS[field](panel=_ROWS, **option)


# Rows with ids, object_ids, labels and label_names, such as a RecordDataset.
C = TypeVar("C", bound=Any)
T = TypeVar("T")


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


@dataclass(frozen=True, slots=True)
class RowFilter:
    """Options of commands that take some of the objects of a data set."""

    ALL: ClassVar[RowFilter]
    """Takes all objects."""

    split: str | None = row_option("split")
    ids: IdChoice | None = text(
        name="--ids",
        metavar="3,17,40-60",
        panel=_ROWS,
        read=parse_ids,
        help="Only the objects with these ids.",
    )
    labels: Sequence[str] | None = text(
        metavar="3,7", panel=_ROWS, read=comma_separated, help="Only the objects of these classes."
    )
    per_class: int | None = row_option("per_class")
    limit: int | None = row_option("limit")

    @property
    def only_split(self) -> str | None:
        """The only split; None for all."""
        return None if self.split == "all" else self.split

    def given(self) -> JsonDict:
        """Return the options that restrict the choice, by name."""
        named = {option.name: getattr(self, option.name) for option in fields(RowFilter)}
        named["split"] = self.only_split
        return {name: value for name, value in named.items() if value is not None}

    def open(self, source: places.Place, kind: DatasetKind) -> list[tuple[str, Any, Int64]]:
        """Open the splits of a data set and choose rows by :meth:`choose`; splits without rows are left out.

        Raises InputError if the split does not exist or is empty, IntegrityError if it is not finished.
        """
        source.require_complete(self.only_split)
        chosen = source.chosen_splits(self.only_split)
        opened = {name: kind.load(source, name) for name in chosen}
        filled = {name: rows for name, rows in opened.items() if len(rows)}
        if not filled:
            raise InputError(
                f"{', '.join(chosen)} of {source.name!r}: no {kind.nouns}",
                next="generate some, or choose another split",
            )
        return self.choose(filled.items())

    def choose(self, datasets: Iterable[tuple[str, C]]) -> list[tuple[str, C, Int64]]:
        """Choose rows of splits, each with its name; return those with their positions, in order.

        The object of a row must have one of the ids and one of the classes. A pair of ids means all
        numbers from its first to its last; a text is also the id of a row, such as a round of touches. Among
        these rows, the first ``per_class`` of each class are taken, then the first ``limit`` of each split.
        Raises InputError if an id, a range or a class matches no row, or no row is left.
        """
        import numpy as np

        asked = list(checked_fields.to_builtin(() if self.ids is None else self.ids))
        is_met = np.zeros(len(asked), bool)
        choices = []
        for split, rows in datasets:
            is_chosen = np.ones(len(rows), bool)
            if self.ids is not None:
                inside = np.zeros((len(asked), len(rows)), bool)
                for number, asked_id in enumerate(asked):
                    inside[number] = _with_id(rows, asked_id)
                is_chosen = np.any(inside, axis=0)
                is_met = is_met | np.any(inside, axis=1)
            if self.labels is not None:
                classes = list(rows.label_names)
                unknown = [label for label in self.labels if label not in classes]
                if unknown:
                    known = ", ".join(classes) or "none: it has no labels"
                    raise InputError(f"no class {unknown[0]!r} in split {split!r}; expected one of {known}")
                is_chosen &= np.isin(rows.labels, [classes.index(label) for label in self.labels])
            chosen = np.flatnonzero(is_chosen)
            if self.per_class is not None:
                kinds = rows.labels[chosen]
                kept = [chosen[kinds == label][: self.per_class] for label in np.unique(kinds)]
                chosen = np.sort(np.concatenate([chosen[:0], *kept]))
            choices.append((split, rows, chosen[: self.limit]))
        absent = [asked[index] for index in np.flatnonzero(~is_met)]
        if absent:
            what = f"id {id_text(absent[0])}"
            if isinstance(absent[0], tuple) and absent[0][0] != absent[0][1]:
                what = f"an id from {absent[0][0]} to {absent[0][1]}"
            raise InputError(
                f"no object with {what} in what was chosen",
                next="check the ids of the split, or name another --split",
            )
        if not any(len(chosen) for _, _, chosen in choices):
            raise InputError(
                "no object is chosen; expected rows of the split with the ids and classes that were asked for"
            )
        return choices


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


def _with_id(rows: Any, choice: IdOrRange) -> Bool:
    """Return a mask of the rows with a given id, or one in a given range: of the object, or of the row."""
    values = rows.object_ids
    if isinstance(choice, str) and rows.ids.dtype.kind not in "iuf":
        values = rows.ids
    if values.dtype.kind not in "iuf":
        is_match: Bool = values == id_text(choice)
        return is_match
    low, high = id_range(choice)
    is_inside: Bool = (values >= low) & (values <= high)
    return is_inside


@dataclass(frozen=True, slots=True)
class CheckedRow(Generic[T]):
    """The result of the check of one row, with its number in the file, and its id if it has one.

    ``result`` is None if ``null_field`` is null.
    """

    split: str
    file: str
    row: int
    id: int | None
    result: T | None
    null_field: str = ""


class _Part(NamedTuple):
    """The first rows of a row group, and its number among all."""

    number: int
    split: str
    shard: read.Shard
    group: int
    rows: int


def check_rows(
    source: places.Place,
    split: str | None,
    kind: DatasetKind,
    check: Callable[[read.Row], T],
    limit: int | None,
    workers: int,
    on_progress: Callable[[int, int], None],
    columns: Sequence[str] = (),
) -> list[CheckedRow[T]]:
    """Check rows of a data set of meshes of a kind in several processes; return the results in their order.

    ``check``, which must be picklable, takes each row in which no column of a mesh, and none of ``columns``,
    is null at any depth. With ``limit`` only the first rows of each split are checked. ``on_progress`` gets
    the number of checked rows and the total.

    Raises InputError if there is no row of the kind, IntegrityError if a shard is damaged or missing, or if
    the data set is unfinished: a check of the rest must not look like one of all.
    """
    source.require(kind, f"{kind.made_by.partition(' ')[0]} validate").require_complete(split)
    of_splits = {name: source.shards(name, kind=kind) for name in source.chosen_splits(split)}
    shards = [(name, shard) for name, of_split in of_splits.items() for shard in of_split]
    for _, shard in shards:
        mesh.require_mesh_columns(shard.schema, source.name, kind.made_by)
    parts: list[_Part] = []
    left = dict.fromkeys(of_splits, limit or math.inf)
    for name, shard in shards:
        for group, (start, stop) in enumerate(pairwise(shard.group_starts)):
            rows = int(min(stop - start, left[name]))
            left[name] -= rows
            if rows:
                parts.append(_Part(len(parts), name, shard, group, rows))
    total = sum(part.rows for part in parts)
    done = 0
    results: dict[int, list[CheckedRow[T]]] = {}
    for number, checked in run.runner_for(workers).run(
        partial(_check_part, check, (*mesh.MESH_COLUMNS, *columns)), parts
    ):
        results[number] = checked
        done += len(checked)
        on_progress(done, total)
    return [row for number in sorted(results) for row in results[number]]


def _check_part(
    check: Callable[[read.Row], T], columns: Sequence[str], part: _Part
) -> tuple[int, list[CheckedRow[T]]]:
    """Check the first rows of a row group; return its number and the results."""
    file = Path(part.shard.path).name
    checked: list[CheckedRow[T]] = []
    for block in part.shard.blocks(part.group):
        nulls = read.null_fields(block.table, columns)
        for index, row_id in enumerate(block.table["id"].to_pylist()[: part.rows - len(checked)]):
            # In data sets of others an id may be null, or a text.
            known_id = read.whole_number(row_id)
            result = None if index in nulls else check(read.Row(block, index))
            row = block.first_row + index
            null_field = nulls.get(index, "")
            checked.append(CheckedRow(part.split, file, row, known_id, result, null_field))
        if len(checked) == part.rows:
            break
    return part.number, checked


@contextmanager
def specification_read(address: str) -> Iterator[None]:
    """Raise IntegrityError for a manifest whose specification has an unexpected form."""
    try:
        yield
    except (KeyError, TypeError, AttributeError) as error:
        problem = f"its specification is not that of this kind of data set ({type(error).__name__}: {error})"
        raise store.damaged_error(address, problem) from error


def short_name(name: str) -> str:
    """Return the name of a data set without its parent folders, which a published page must not show."""
    path = store.local_path(name)
    if path is None:
        return name.rstrip("/").rpartition("/")[2]
    return path.resolve().name if path.exists() else name
