"""Checking every row of a data set as it is read back from disk, whoever wrote it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Generic, TypeVar

from tactile_toolkit.catalog.locate import find_shards, folder_named, splits_of, splits_to_check
from tactile_toolkit.mesh.columns import require_mesh_columns
from tactile_toolkit.read.columns import null_fields
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.run.processes import runner_for

T = TypeVar("T")


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


@dataclass(frozen=True, slots=True)
class RowsToCheck:
    """The first rows of one row group: small and picklable."""

    split: str
    shard: Shard
    group: int
    rows: int


def shards_to_check(path: str, split: str | None, made_by: str) -> list[tuple[str, Shard]]:
    """Return the files of a data set of meshes, each with its split; ``made_by`` writes such data sets.

    Raises InputError where there is none, IntegrityError where a shard is damaged or missing.
    """
    if split is not None:
        splits: tuple[str, ...] = (split,)
    else:
        splits = splits_of(path) if folder_named(path) is None else splits_to_check(path)
    shards = [(name, shard) for name in splits for shard in find_shards(path, name)]
    for _, shard in shards:
        require_mesh_columns(shard.schema, path, made_by)
    return shards


def check_rows(
    shards: Sequence[tuple[str, Shard]],
    check: Callable[[Row], T],
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
    parts = list(_parts(shards, limit))
    total, done = sum(part.rows for part in parts), 0
    results: dict[tuple[str, int], list[CheckedRow[T]]] = {}
    for part, found in runner_for(workers).run(_CheckPart(check, tuple(columns)), parts):
        results[part.shard.path, part.group] = found
        done += part.rows
        on_progress(done, total)
    return [row for part in parts for row in results[part.shard.path, part.group]]


def _parts(shards: Sequence[tuple[str, Shard]], limit: int | None) -> Iterator[RowsToCheck]:
    left: dict[str, int] = {}
    for split, shard in shards:
        for group, (start, stop) in enumerate(zip(shard.group_starts, shard.group_starts[1:], strict=False)):
            rows = stop - start if limit is None else min(stop - start, left.get(split, limit))
            if limit is not None:
                left[split] = left.get(split, limit) - rows
            if rows:
                yield RowsToCheck(split, shard, group, rows)


@dataclass(frozen=True, slots=True)
class _CheckPart(Generic[T]):
    check: Callable[[Row], T]
    columns: tuple[str, ...]

    def __call__(self, part: RowsToCheck) -> tuple[RowsToCheck, list[CheckedRow[T]]]:
        return part, list(islice(self._rows(part), part.rows))

    def _rows(self, part: RowsToCheck) -> Iterator[CheckedRow[T]]:
        file = Path(part.shard.path).name
        for block in part.shard.blocks(part.group):
            nulls = null_fields(block.table, self.columns)
            for index, row_id in enumerate(block.table["id"].to_pylist()):
                # In data sets of others it may be null, or a text.
                known_id = row_id if isinstance(row_id, int) else None
                null_field = nulls.get(index, "")
                found = None if null_field else self.check(Row(block, index))
                yield CheckedRow(part.split, file, block.first_row + index, known_id, found, null_field)
