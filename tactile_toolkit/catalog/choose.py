"""Which rows of a data set are shown or checked: by split, by id, or the first of each class."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from tactile_toolkit import mesh, places, read, run, store
from tactile_toolkit.array_types import AnyArray, Bool, Int64
from tactile_toolkit.catalog.spec import GivenId, IdChoice, id_range, id_text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind

T = TypeVar("T")
D = TypeVar("D", bound=read.RecordDataset[Any])


def open_splits(
    place: places.Place, split: str | None, load: Callable[[places.Place, str], D], things: str
) -> dict[str, D]:
    """Open one split of a data set, or all of them; those without rows are left out.

    ``load`` opens a split; ``things`` is what the rows are, for messages, such as ``"digits"``. InputError
    where the split does not exist, or is empty; IntegrityError where it is not finished.
    """
    place.require_complete(split)
    chosen = place.splits if split is None else (split,)
    opened = {each: load(place, each) for each in chosen}
    filled = {each: rows for each, rows in opened.items() if len(rows)}
    if not filled:
        raise InputError(
            f"{', '.join(chosen)} of {place.name!r}: no {things}",
            next="generate some, or choose another split",
        )
    return filled


def choose_rows(
    datasets: Iterable[tuple[str, D]],
    *,
    ids: IdChoice | None = None,
    labels: Sequence[str] | None = None,
    per_class: int | None = None,
    limit: int | None = None,
) -> list[tuple[str, D, Int64]]:
    """Choose rows of splits, each with its name; return those with their positions, in order.

    Only rows with these ``ids`` (of numbers, a pair stands for all from its first to its last that are there;
    of texts, for the text ``first-last``), of these classes, of these the first ``per_class`` of each class,
    and of what is left the first ``limit`` of each split. Raises InputError where an id or a class is not
    there, no id of a range is, or nothing is left.
    """
    asked = list(ids or ())
    seen, found = np.zeros(len(asked), bool), []
    for split, rows in datasets:
        wanted = np.ones(len(rows), bool)
        if ids is not None:
            inside, values = np.zeros((len(asked), len(rows)), bool), rows.ids
            for number, each in enumerate(asked):
                inside[number] = _with_id(values, each)
            wanted, seen = np.any(inside, axis=0), seen | np.any(inside, axis=1)
        if labels is not None:
            classes = list(rows.label_names)
            unknown = [label for label in labels if label not in classes]
            if unknown:
                raise InputError(
                    f"no class {unknown[0]!r} in split {split!r}; expected one of {', '.join(classes)}"
                )
            wanted &= np.isin(rows.labels, [classes.index(label) for label in labels])
        chosen = np.flatnonzero(wanted)
        if per_class is not None:
            kinds = rows.labels[chosen]
            kept = [chosen[kinds == label][:per_class] for label in np.unique(kinds)]
            chosen = np.sort(np.concatenate([chosen[:0], *kept]))
        found.append((split, rows, chosen[:limit]))
    absent = [asked[index] for index in np.flatnonzero(~seen)]
    if absent:
        what = f"id {id_text(absent[0])}"
        if isinstance(absent[0], tuple) and absent[0][0] != absent[0][1]:
            what = f"an id from {absent[0][0]} to {absent[0][1]}"
        raise InputError(
            f"no object with {what} in what was chosen",
            next="look at the ids of the split, or name another --split",
        )
    if not any(len(chosen) for _, _, chosen in found):
        raise InputError(
            "no object is chosen; expected rows of the split with the ids and classes that were asked for"
        )
    return found


def _with_id(values: AnyArray, given: GivenId) -> Bool:
    """Return which ids, numbers or texts, are a given one or within a given range."""
    if values.dtype.kind not in "iuf":
        return np.asarray(values == id_text(given), bool)
    low, high = id_range(given)
    return np.asarray((values >= low) & (values <= high))


def short_name(name: str) -> str:
    """Return a data set's name without the folders that it lies in: a site may be given to others."""
    if store.is_remote(name):
        return name.rstrip("/").rpartition("/")[2]
    place = store.expanded(store.normalize_uri(name))
    return place.resolve().name if place.exists() else name


@dataclass(frozen=True, slots=True)
class CheckedRow(Generic[T]):
    """What was found about one row, by its number in a file, and by its id where it has one.

    ``found`` is what the check returned, or None where ``null_field`` is null.
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

    Raises InputError where there is none, IntegrityError where a shard is damaged or missing, or the run that
    makes the data set is under way or was interrupted: a check of the rest would pass for one of all.
    """
    place = places.open_place(name).require(kind, "validate").require_complete(split)
    splits = place.splits if split is None else (split,)
    shards = [(each, shard) for each in splits for shard in place.shards(each)]
    for _, shard in shards:
        mesh.require_mesh_columns(shard.schema, place.name, kind.made_by)
    return shards


def check_rows(
    shards: Sequence[tuple[str, read.Shard]],
    check: Callable[[read.Row], T],
    columns: Sequence[str],
    limit: int | None = None,
    workers: int = 1,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> list[CheckedRow[T]]:
    """Check rows in processes and return what was found, in the order of the rows.

    ``check``, which has to be picklable, is given each row in which none of ``columns`` is null at any depth;
    only the first ``limit`` rows of each split, where given. ``on_progress`` is called with rows done and in
    all.
    """
    parts: list[tuple[int, str, read.Shard, int, int]] = []
    left = dict.fromkeys((split for split, _ in shards), math.inf if limit is None else limit)
    for split, shard in shards:
        for group, (start, stop) in enumerate(pairwise(shard.group_starts)):
            rows = int(min(stop - start, left[split]))
            left[split] -= rows
            if rows:
                parts.append((len(parts), split, shard, group, rows))
    total, done = sum(rows for *_, rows in parts), 0
    results: dict[int, list[CheckedRow[T]]] = {}
    for number, found in run.runner_for(workers).run(partial(_check_part, check, tuple(columns)), parts):
        results[number] = found
        done += len(found)
        on_progress(done, total)
    return [row for number in sorted(results) for row in results[number]]


def _check_part(
    check: Callable[[read.Row], T], columns: Sequence[str], part: tuple[int, str, read.Shard, int, int]
) -> tuple[int, list[CheckedRow[T]]]:
    """Check the first rows of a row group; return its number with what was found."""
    number, split, shard, group, rows = part
    file = Path(shard.path).name
    checked: list[CheckedRow[T]] = []
    for block in shard.blocks(group):
        nulls = read.null_fields(block.table, columns)
        for index, row_id in enumerate(block.table["id"].to_pylist()[: rows - len(checked)]):
            # In data sets of others it may be null, or a text.
            known_id = read.whole_number(row_id)
            found = None if index in nulls else check(read.Row(block, index))
            row, null_field = block.first_row + index, nulls.get(index, "")
            checked.append(CheckedRow(split, file, row, known_id, found, null_field))
        if len(checked) == rows:
            break
    return number, checked
