"""Proving the stored scenes of a whole data set."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from starstruck_gen.checking import check_scene, inspect_scene
from starstruck_gen.dataset import SceneRecord
from starstruck_gen.rows import CLASS_NAMES
from starstruck_gen.shapes import Proportions
from starstruck_gen.solid import own_kinds, register_shape
from tactile_toolkit.catalog.locate import find_shards, splits_of, splits_to_check
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.columns import FACES, VERTICES, class_names, require_mesh_columns
from tactile_toolkit.read.columns import column_names, null_fields
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.parquet import RowGroup, Shard
from tactile_toolkit.run.processes import runner_for

__all__ = ["Checked", "Failure", "check_scene", "validate_folder"]

_COLUMNS = (
    *("id", "label", VERTICES, FACES),
    *("star_count", "distractor_count", "placements", "seed", "attempts", "restarts"),
)

_NO_ID = -1

_SHOWN = 20


@dataclass(frozen=True, slots=True)
class Failure:
    """A scene that breaks a promise.

    Attributes
    ----------
    split : str
        Its split.
    id : int
        Its id.
    problem : str
        What was found and what was expected.
    """

    split: str
    id: int
    problem: str


@dataclass(frozen=True, slots=True)
class Checked:
    """Everything found in one data set.

    Attributes
    ----------
    path : str
        As given.
    checked : int
        How many scenes were checked.
    bodies, stars : int
        How many bodies stand in the sound ones, and how many of them are declared stars; the published data
        set declares none.
    failures : tuple of Failure
        Scenes that break a promise.
    declared : bool
        Whether the data set declares what stands where.
    """

    path: str
    checked: int
    bodies: int
    stars: int
    failures: tuple[Failure, ...]
    declared: bool = True

    @property
    def failed(self) -> int:
        """How many scenes break a promise."""
        return len(self.failures)

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "path": self.path,
            "checked": self.checked,
            "failed": self.failed,
            "bodies": self.bodies,
            "stars": self.stars,
            "declared": self.declared,
            "failures": [{"split": f.split, "id": f.id, "problem": f.problem} for f in self.failures],
        }

    def table(self) -> tuple[Sequence[str], Sequence[Sequence[object]], str]:
        """Return header, rows and title of a table of the scenes that fail."""
        title = f"{self.path}: {self.checked:,} checked, {self.failed:,} failed"
        shown = [(failure.split, failure.id, failure.problem) for failure in self.failures[:_SHOWN]]
        return ("split", "scene", "finding"), shown, title


def validate_folder(
    path: str | os.PathLike[str],
    split: str | None = None,
    limit: int | None = None,
    workers: int = 1,
    *,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Checked:
    """Prove the scenes of a data set as they are read back from disk.

    Parameters
    ----------
    path : str or path-like
        Data set folder, or a Parquet file.
    split : str, optional
        Only this split.
    limit : int, optional
        Only the first so many rows of each split.
    workers : int
        Processes that check.
    on_progress : callable
        Told scenes done and in all.

    Raises
    ------
    InputError
        The path does not exist, or holds no data set of scenes.
    IntegrityError
        A shard is damaged, or the run that makes the data set is not finished.
    """
    path = os.fspath(path)
    parts = [part for name in _splits(path, split) for part in _parts(path, name, limit)]
    total, done = sum(part.rows for part in parts), 0
    results: dict[_Part, _Found] = {}
    for part, found in runner_for(workers).run(_check_part, parts):
        results[part] = found
        done += part.rows
        on_progress(done, total)
    ordered = [results[part] for part in parts]
    return Checked(
        path,
        total,
        sum(found.bodies for found in ordered),
        sum(found.stars for found in ordered),
        tuple(failure for found in ordered for failure in found.failures),
        any("placements" in column_names(part.shard.schema) for part in parts),
    )


@dataclass(frozen=True, slots=True)
class _Part:
    """A block of rows to check: small and picklable."""

    split: str
    shard: Shard
    group: int
    rows: int
    kinds: tuple[type[Proportions], ...]


@dataclass(frozen=True, slots=True)
class _Found:
    bodies: int
    stars: int
    failures: tuple[Failure, ...]


def _check_part(part: _Part) -> tuple[_Part, _Found]:
    for kind in part.kinds:
        register_shape(kind)
    names = class_names(part.shard.schema, CLASS_NAMES)
    bodies = stars = 0
    failures = []
    for scene_id, checked in islice(_checked_rows(part, names), part.rows):
        if isinstance(checked, str):
            failures.append(Failure(part.split, scene_id, checked))
            continue
        bodies += checked[0]
        stars += checked[1]
    return part, _Found(bodies, stars, tuple(failures))


def _checked_rows(part: _Part, names: Sequence[str]) -> Iterator[tuple[int, str | tuple[int, int]]]:
    """Yield the id of each row with what is wrong with it, or how many bodies and declared stars it has."""
    import pyarrow as pa

    first_row = part.shard.group_starts[part.group]
    for block in part.shard.blocks(part.group):
        nulls = null_fields(block.table, _COLUMNS)
        whole = [row for row in range(len(block.table)) if row not in nulls]
        # One null spoils its whole column; without such rows the others can be read.
        readable = (
            RowGroup(block.table.take(pa.array(whole, pa.int64())).combine_chunks()) if nulls else block
        )
        places = {row: place for place, row in enumerate(whole)}
        for row in range(len(block.table)):
            if row in nulls:
                found = f"field {nulls[row]!r} of row {first_row + row} is null; expected a value"
                yield _id_of(block, row), found
            else:
                yield _id_of(block, row), _checked_row(SceneRecord(Row(readable, places[row])), names)
        first_row += len(block.table)


def _checked_row(record: SceneRecord, names: Sequence[str]) -> str | tuple[int, int]:
    try:
        problem, bodies = inspect_scene(record, names)
        return problem or (bodies, record.star_count if record.has_placements else 0)
    except (TypeError, ValueError, OverflowError) as error:
        # Columns of other types than those of a data set of scenes.
        return f"cannot be read as a scene: {error}"


def _id_of(block: RowGroup, row: int) -> int:
    scene_id = block.arrow("id")[row].as_py()
    return scene_id if isinstance(scene_id, int) else _NO_ID


def _splits(path: str, split: str | None) -> Sequence[str]:
    if split is not None:
        return [split]
    if Path(path).is_file():
        return splits_of(path)
    if not Path(path).is_dir():
        message = f"{path!r} does not exist; expected a data set folder or a Parquet file"
        raise InputError(message)
    return splits_to_check(path)


def _parts(path: str, split: str, limit: int | None) -> Iterator[_Part]:
    left = limit
    for shard in find_shards(path, split):
        require_mesh_columns(shard.schema, path, "starstruck generate")
        for group in range(shard.metadata.num_row_groups):
            rows = shard.metadata.row_group(group).num_rows
            take = rows if left is None else min(rows, left)
            if take:
                yield _Part(split, shard, group, take, own_kinds())
            left = None if left is None else left - take
