"""Rows of a data set, chosen by split, id and class, or checked in several processes; and their files."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from tactile_toolkit import checked_fields, mesh, places, read, run, store
from tactile_toolkit.catalog.row_options import IdChoice, IdOrRange, id_range, id_text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.read import record
from tactile_toolkit.store.manifest import DATA_FOLDER, damaged_error
from tactile_toolkit.value_types import Bool, Int64

D = TypeVar("D", bound=read.RecordDataset[Any])
# Rows with ids, object_ids, labels and label_names, such as a RecordDataset.
C = TypeVar("C", bound=Any)
T = TypeVar("T")


def open_splits(
    source: places.Place, split: str | None, load: Callable[[places.Place, str], D], item_nouns: str
) -> dict[str, D]:
    """Open one split of a data set, or all of them; those without rows are left out.

    ``load`` opens a split; ``item_nouns`` says in messages what the rows are, such as ``"digits"``. Raises
    InputError if the split does not exist or is empty, IntegrityError if it is not finished.
    """
    source.require_complete(split)
    chosen = source.chosen_splits(split)
    opened = {name: load(source, name) for name in chosen}
    filled = {name: rows for name, rows in opened.items() if len(rows)}
    if not filled:
        raise InputError(
            f"{', '.join(chosen)} of {source.name!r}: no {item_nouns}",
            next="generate some, or choose another split",
        )
    return filled


def choose_rows(
    datasets: Iterable[tuple[str, C]],
    *,
    ids: IdChoice | None = None,
    labels: Sequence[str] | None = None,
    per_class: int | None = None,
    limit: int | None = None,
) -> list[tuple[str, C, Int64]]:
    """Choose rows of splits, each with its name; return those with their positions, in order.

    The object of a row must have one of these ``ids`` and one of these classes. A pair of ids means all
    numbers from its first to its last; a text is also the id of a row, such as a round of touches. Among
    these rows, the first ``per_class`` of each class are taken, then the first ``limit`` of each split.
    Raises InputError if an id, a range or a class matches no row, or no row is left.
    """
    asked = list(checked_fields.to_builtin(() if ids is None else ids))
    is_met = np.zeros(len(asked), bool)
    choices = []
    for split, rows in datasets:
        is_chosen = np.ones(len(rows), bool)
        if ids is not None:
            inside = np.zeros((len(asked), len(rows)), bool)
            for number, asked_id in enumerate(asked):
                inside[number] = _with_id(rows, asked_id)
            is_chosen = np.any(inside, axis=0)
            is_met = is_met | np.any(inside, axis=1)
        if labels is not None:
            classes = list(rows.label_names)
            unknown = [label for label in labels if label not in classes]
            if unknown:
                known = ", ".join(classes) or "none: it has no labels"
                raise InputError(f"no class {unknown[0]!r} in split {split!r}; expected one of {known}")
            is_chosen &= np.isin(rows.labels, [classes.index(label) for label in labels])
        chosen = np.flatnonzero(is_chosen)
        if per_class is not None:
            kinds = rows.labels[chosen]
            kept = [chosen[kinds == label][:per_class] for label in np.unique(kinds)]
            chosen = np.sort(np.concatenate([chosen[:0], *kept]))
        choices.append((split, rows, chosen[:limit]))
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


def _with_id(rows: Any, choice: IdOrRange) -> Bool:
    """Return a mask of the rows with a given id, or one in a given range: of the object, or of the row."""
    values = rows.object_ids
    if isinstance(choice, str) and rows.ids.dtype.kind not in "iuf":
        values = rows.ids
    if values.dtype.kind not in "iuf":
        return np.asarray(values == id_text(choice), bool)
    low, high = id_range(choice)
    return np.asarray((values >= low) & (values <= high))


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


def shards_to_check(
    name: places.Name | places.Place, split: str | None, kind: DatasetKind
) -> list[tuple[str, read.Shard]]:
    """Return the files of a data set of meshes of a kind, each with its split.

    Raises InputError if there is none, IntegrityError if a shard is damaged or missing, or if the data set is
    unfinished: a check of the rest must not look like one of all.
    """
    source = (
        places.open_place(name)
        .require(kind, f"{kind.made_by.partition(' ')[0]} validate")
        .require_complete(split)
    )
    shards = [
        (split_name, shard)
        for split_name in source.chosen_splits(split)
        for shard in source.shards(split_name, kind=kind)
    ]
    for _, shard in shards:
        mesh.require_mesh_columns(shard.schema, source.name, kind.made_by)
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
    total = sum(part.rows for part in parts)
    done = 0
    results: dict[int, list[CheckedRow[T]]] = {}
    for number, checked in run.runner_for(workers).run(partial(_check_part, check, tuple(columns)), parts):
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
        nulls = record.null_fields(block.table, columns)
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
        raise damaged_error(address, problem) from error


def manifest_beside(path: str) -> store.Manifest | None:
    """Return the manifest of the data set folder of a file; None if there is none."""
    data, _ = store.split_uri(path)
    folder, name = store.split_uri(data.address())
    if name == DATA_FOLDER:
        return store.manifest_so_far(folder)
    return None


def short_name(name: str) -> str:
    """Return the name of a data set without its parent folders, which a published page must not show."""
    path = store.local_path(name)
    if path is None:
        return name.rstrip("/").rpartition("/")[2]
    return path.resolve().name if path.exists() else name
