"""Checking each row of a data set, in several processes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Generic, NamedTuple, TypeVar

from tactile_toolkit import mesh, places, read, run
from tactile_toolkit.kind import DatasetKind

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class CheckedRow(Generic[T]):
    """The result of the check of one row, with its number in the file, and its id if it has one.

    ``found`` is the result, or None if ``null_field`` is null.
    """

    split: str
    file: str
    row: int
    id: int | None
    found: T | None
    null_field: str = ""


def shards_to_check(
    name: places.Name | places.Place, split: str | None, kind: DatasetKind
) -> list[tuple[str, read.Shard]]:
    """Return the files of a data set of meshes of a kind, each with its split.

    Raises InputError if there is none, IntegrityError if a shard is damaged or missing, or if the data set is
    unfinished: a check of the rest must not look like one of all.
    """
    place = places.open_place(name).require(kind, "validate").require_complete(split)
    shards = [(each, shard) for each in place.chosen_splits(split) for shard in place.shards(each, kind=kind)]
    for _, shard in shards:
        mesh.require_mesh_columns(shard.schema, place.name, kind.made_by)
    return shards


class _Part(NamedTuple):
    """The first rows of a row group, and its number among all."""

    number: int
    split: str
    shard: read.Shard
    group: int
    rows: int


def check_rows(
    shards: Sequence[tuple[str, read.Shard]],
    check: Callable[[read.Row], T],
    columns: Sequence[str],
    limit: int | None = None,
    workers: int = 1,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> list[CheckedRow[T]]:
    """Check rows in several processes and return the results, in the order of the rows.

    ``check``, which must be picklable, takes each row in which none of ``columns`` is null at any depth. With
    ``limit`` only the first rows of each split are checked. ``on_progress`` gets the number of checked rows
    and the total.
    """
    parts: list[_Part] = []
    left = dict.fromkeys((split for split, _ in shards), limit or math.inf)
    for split, shard in shards:
        for group, (start, stop) in enumerate(pairwise(shard.group_starts)):
            rows = int(min(stop - start, left[split]))
            left[split] -= rows
            if rows:
                parts.append(_Part(len(parts), split, shard, group, rows))
    total, done = sum(part.rows for part in parts), 0
    results: dict[int, list[CheckedRow[T]]] = {}
    for number, found in run.runner_for(workers).run(partial(_check_part, check, tuple(columns)), parts):
        results[number] = found
        done += len(found)
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
            found = None if index in nulls else check(read.Row(block, index))
            row, null_field = block.first_row + index, nulls.get(index, "")
            checked.append(CheckedRow(part.split, file, row, known_id, found, null_field))
        if len(checked) == part.rows:
            break
    return part.number, checked
