"""Proving stored scenes the long way: from their triangles, with manifold3d."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from dataset_store.errors import InputError
from dataset_store.mesh import Mesh
from dataset_store.mesh_columns import class_names, require_mesh_columns
from dataset_store.places import available_splits, find_shards
from dataset_store.records import Row
from dataset_store.rowgroups import Shard
from dataset_store.runner import runner_for
from dataset_store.soundness import judge
from dataset_store.storage import DataFolder
from starstruck_gen.dataset import SceneRecord
from starstruck_gen.rows import CLASS_NAMES
from starstruck_gen.shapes import outline
from starstruck_gen.stamping import stamp

__all__ = ["Checked", "Failure", "check_scene", "validate_folder"]

_VOLUME_TOLERANCE = 1e-9
"""Relative difference of two volumes that double precision explains."""

_PLACE_TOLERANCE_M = 1e-7
"""How far a stored corner may lie from the declared object: other processors round in other ways."""

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
    """

    path: str
    checked: int
    bodies: int
    stars: int
    failures: tuple[Failure, ...]

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
            "failures": [{"split": f.split, "id": f.id, "problem": f.problem} for f in self.failures],
        }

    def table(self) -> tuple[Sequence[str], Sequence[Sequence[object]], str]:
        """Return header, rows and title of a table of the scenes that fail."""
        title = f"{self.path}: {self.checked:,} checked, {self.failed:,} failed"
        shown = [(failure.split, failure.id, failure.problem) for failure in self.failures[:_SHOWN]]
        return ("split", "scene", "finding"), shown, title


def check_scene(record: SceneRecord, names: Sequence[str] = CLASS_NAMES) -> str | None:
    """Prove one stored scene.

    The triangles bound solids; the volumes of the solids add up to that of their union, so that none overlap;
    they stand on z = 0; there is one for each declared object, and it is that object; there are as many stars
    as the class says.

    Parameters
    ----------
    record : SceneRecord
        The scene. One without declared objects (the published data set) is held to its solids alone.
    names : sequence of str
        Names of the classes.

    Returns
    -------
    str or None
        What is wrong; None when all holds.
    """
    return _check(record, names)[0]


def _check(record: SceneRecord, names: Sequence[str]) -> tuple[str | None, int]:
    """Return what is wrong with a scene and how many bodies it has."""
    mesh = Mesh(record.vertices_m, record.faces)
    verdict = judge(mesh)
    if verdict.problem is not None:
        return f"{verdict.problem}: {verdict.detail}", verdict.bodies
    problem = (
        _overlapping(verdict.manifold)
        or _afloat(mesh)
        or _undeclared(mesh, verdict.bodies, record)
        or _miscounted(record, names)
    )
    return problem, verdict.bodies


def validate_folder(
    path: str,
    split: str | None = None,
    limit: int | None = None,
    workers: int = 1,
    *,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Checked:
    """Prove the scenes of a data set as they are read back from disk.

    Parameters
    ----------
    path : str
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
        A shard is damaged.
    """
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
    )


def _overlapping(manifold: Any) -> str | None:
    import manifold3d

    bodies = manifold.decompose()
    apart_mm3 = sum(body.volume() for body in bodies)
    union_mm3 = manifold3d.Manifold.batch_boolean(bodies, manifold3d.OpType.Add).volume()
    if abs(apart_mm3 - union_mm3) <= _VOLUME_TOLERANCE * apart_mm3:
        return None
    return (
        f"bodies overlap: their volumes add up to {apart_mm3:.6f} mm^3, their union has {union_mm3:.6f} mm^3"
    )


def _afloat(mesh: Mesh) -> str | None:
    lowest_m = float(mesh.bounds_m[0, 2])
    return None if lowest_m == 0.0 else f"the lowest point is at z = {lowest_m} m; expected 0"


def _undeclared(mesh: Mesh, bodies: int, record: SceneRecord) -> str | None:
    if not record.has_placements:
        return None
    strange = _strange(record)
    if strange is not None:
        return strange
    if bodies != len(record.placements):
        return f"{bodies} bodies stand there, {len(record.placements)} objects are declared"
    declared = stamp([record.placements])[0]
    same = declared.vertices_m.shape == mesh.vertices_m.shape and np.array_equal(declared.faces, mesh.faces)
    if same and np.abs(declared.vertices_m - mesh.vertices_m).max() <= _PLACE_TOLERANCE_M:
        return None
    return "the mesh is not that of the declared objects"


def _strange(record: SceneRecord) -> str | None:
    """Return what is wrong with a declared shape that nobody can draw."""
    try:
        for placement in record.placements:
            outline(placement.shape)
    except InputError as error:
        return f"an object is declared that cannot be: {error}"
    return None


def _miscounted(record: SceneRecord, names: Sequence[str]) -> str | None:
    declared = record.star_count
    if not 0 <= record.label < len(names) or names[record.label] != str(declared):
        return f"{declared} stars are declared, the class is {record.label} of {', '.join(names)}"
    if not record.has_placements:
        return None
    stars = sum(placement.is_star for placement in record.placements)
    others = len(record.placements) - stars
    if stars != declared or others != record.distractor_count:
        expected = f"{declared} and {record.distractor_count}"
        return f"{stars} stars and {others} others stand there, {expected} are declared"
    return None


@dataclass(frozen=True, slots=True)
class _Part:
    """A block of rows to check: small and picklable."""

    split: str
    shard: Shard
    group: int
    rows: int


@dataclass(frozen=True, slots=True)
class _Found:
    bodies: int
    stars: int
    failures: tuple[Failure, ...]


def _check_part(part: _Part) -> tuple[_Part, _Found]:
    names = class_names(part.shard.schema, CLASS_NAMES)
    bodies = stars = 0
    failures = []
    for record in islice(_records(part), part.rows):
        problem, found = _check(record, names)
        if problem is not None:
            failures.append(Failure(part.split, record.id, problem))
            continue
        bodies += found
        stars += record.star_count if record.has_placements else 0
    return part, _Found(bodies, stars, tuple(failures))


def _records(part: _Part) -> Iterator[SceneRecord]:
    for block in part.shard.blocks(part.group):
        yield from (SceneRecord(Row(block, row)) for row in range(len(block.table)))


def _splits(path: str, split: str | None) -> Sequence[str]:
    if split is not None or Path(path).is_file():
        return [split or "train"]
    if not Path(path).is_dir():
        message = f"{path!r} does not exist; expected a data set folder or a Parquet file"
        raise InputError(message)
    found = available_splits(DataFolder(path))
    if not found:
        message = (
            f"{path!r} holds no data set (no manifest and no Parquet files); next: name a generated folder"
        )
        raise InputError(message)
    return found


def _parts(path: str, split: str, limit: int | None) -> Iterator[_Part]:
    left = limit
    for shard in find_shards(path, split):
        require_mesh_columns(shard.schema, path, "starstruck generate")
        for group in range(shard.metadata.num_row_groups):
            rows = shard.metadata.row_group(group).num_rows
            take = rows if left is None else min(rows, left)
            if take:
                yield _Part(split, shard, group, take)
            left = None if left is None else left - take
