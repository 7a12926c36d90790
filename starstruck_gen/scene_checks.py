"""Checks of the stored scenes of a data set."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from starstruck_gen import scene, scene_dataset
from starstruck_gen.kind import KIND
from tactile_toolkit import catalog, places, read
from tactile_toolkit.errors import ToolkitError
from tactile_toolkit.mesh import MM_PER_M, Mesh, check_manifold
from tactile_toolkit.value_types import JsonDict
from tactile_toolkit.wording import with_count

if TYPE_CHECKING:
    import manifold3d

_COLUMNS = ("star_count", "distractor_count", "placements", "seed", "attempts", "restarts")
# Id of rows whose id is null, as JSON and tables need a number.
_NO_ID = -1
_SHOWN = 20
# Largest distance of a stored corner from the declared object: processors round differently.
_PLACE_TOLERANCE_M = 1e-7


@dataclass(frozen=True, slots=True)
class InvalidScene:
    """An invalid scene: where it is, what was found and what was expected."""

    split: str
    id: int
    problem: str


@dataclass(frozen=True, slots=True)
class CheckedScenes:
    """Results for one data set: the number of checked scenes, and the invalid ones.

    The valid scenes have ``bodies`` solids, ``stars`` of which are declared stars. The published data set is
    not ``declared``: it does not store placements.
    """

    path: str
    checked: int
    bodies: int
    stars: int
    failures: tuple[InvalidScene, ...]
    declared: bool = True
    unreadable: ClassVar[tuple[str, ...]] = ()

    @property
    def failed(self) -> int:
        """Number of invalid scenes."""
        return len(self.failures)

    def to_dict(self) -> JsonDict:
        """Return JSON values."""
        return {
            **asdict(self),
            "failures": [asdict(failure) for failure in self.failures],
            "failed": self.failed,
        }

    def advice(self) -> Sequence[str]:
        """Return nothing: scenes are not printed."""
        return ()

    def table(self) -> tuple[Sequence[str], Sequence[Sequence[object]], str]:
        """Return header, rows and title of a table of invalid scenes."""
        solids = with_count(self.bodies, "solids")
        if self.declared:
            solids = f"{solids}, {self.stars:,} of them stars"
        else:
            solids = f"{solids}; the data set does not declare which of them are stars"
        title = f"{self.path}: {self.checked:,} checked, {self.failed:,} failed; {solids}"
        shown = [(failure.split, failure.id, failure.problem) for failure in self.failures[:_SHOWN]]
        return ("split", "scene", "finding"), shown, title


def check_content(
    source: places.Name | places.Place,
    split: str | None = None,
    limit: int | None = None,
    workers: int = 1,
    *,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> CheckedScenes:
    """Check the scenes of a data set, or of a Parquet file, as they are read back from disk.

    ``split`` selects one split, ``limit`` the first rows of each; ``on_progress`` is called with the numbers
    of scenes done and in total. Raises InputError if there is no data set of scenes, and IntegrityError if a
    shard is damaged or the run that makes the data set is not finished.
    """
    opened = places.open_place(source)
    rows = catalog.check_rows(opened, split, KIND, _check_row, limit, workers, on_progress, _COLUMNS)
    failures = []
    bodies = 0
    stars = 0
    declares = False
    for row in rows:
        null = f"field {row.null_field!r} of row {row.row} is null; expected a value"
        problem, standing, declared = row.result or (null, 0, None)
        declares |= declared is not None
        if problem is None:
            bodies += standing
            stars += declared or 0
        else:
            number = _NO_ID if row.id is None else row.id
            failures.append(InvalidScene(row.split, number, problem))
    return CheckedScenes(opened.name, len(rows), bodies, stars, tuple(failures), declares)


def _check_row(row: read.Row) -> tuple[str | None, int, int | None]:
    """Return the problem of a scene (or None), its number of bodies, and its stars if they are declared."""
    record = scene_dataset.SceneRecord(row)
    stars = 0 if record.has_placements else None
    try:
        problem, bodies = check_scene(record, _class_names(row.path))
        if stars is not None:
            stars = record.star_count
        return problem, bodies, stars
    except (ToolkitError, TypeError, ValueError, OverflowError) as error:
        # Columns of other types, and unknown shapes.
        return f"cannot be read as a scene: {error}", 0, stars


@lru_cache(1)
def _class_names(path: str) -> tuple[str, ...]:
    stated = read.Shard(path).class_names
    return KIND.class_names if stated is None else stated


def check_scene(
    record: scene_dataset.SceneRecord, names: Sequence[str] = KIND.class_names
) -> tuple[str | None, int]:
    """Check a stored scene from its triangles; return its problem (or None) and its number of bodies.

    The triangles bound solids that do not overlap (:mod:`tactile_toolkit.mesh.solid_check`) and stand on
    z = 0. Each declared object has one solid, which is that object. The number of stars is that of the class.
    For a scene without declared objects (the published data set), only the solids and the class are checked.
    """
    mesh = Mesh(record.vertices_m, record.faces)
    verdict = check_manifold(mesh)
    if verdict.problem is not None:
        return f"{verdict.problem}: {verdict.detail}", verdict.bodies
    problem = _check_on_plate(mesh, verdict.manifold.decompose())
    if record.has_placements:
        problem = problem or _check_placements(mesh, verdict.bodies, record)
    return problem or _check_star_count(record, names), verdict.bodies


def _check_on_plate(mesh: Mesh, bodies: Sequence[manifold3d.Manifold]) -> str | None:
    mesh_m = float(mesh.bounds_m[0, 2])
    if mesh_m != 0.0:
        return f"the lowest point of the mesh is at z = {mesh_m:g} m; expected 0"
    # Bodies of negative volume are voids inside others.
    lowest_m = [body.bounding_box()[2] / MM_PER_M for body in bodies if body.volume() > 0]
    for number, each_m in enumerate(lowest_m, 1):
        if each_m > _PLACE_TOLERANCE_M:
            what = f"body {number} of {len(lowest_m)}"
            return f"the lowest point of {what} is at z = {each_m:g} m; expected 0"
    return None


def _check_placements(mesh: Mesh, bodies: int, record: scene_dataset.SceneRecord) -> str | None:
    declared = scene.build_meshes([record.placements])[0]
    if bodies != len(record.placements):
        return f"found {with_count(bodies, 'solids')}; expected {len(record.placements)}, one for each object"
    same = declared.vertices_m.shape == mesh.vertices_m.shape and np.array_equal(declared.faces, mesh.faces)
    if not same or not np.abs(declared.vertices_m - mesh.vertices_m).max() <= _PLACE_TOLERANCE_M:
        return "the mesh is not that of the declared objects"
    # Caps may face into their prism, which the check of the whole can miss in a solid of many triangles.
    corners = mesh.vertices_m.astype(np.float64)[mesh.faces]
    level = (corners[:, :, 2] == corners[:, :1, 2]).all(axis=1)
    a, b, c = np.moveaxis(corners[level], 1, 0)
    doubled = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    wrong = int((np.where(a[:, 2] > 0, doubled, -doubled) <= 0).sum())
    if wrong:
        return f"found {with_count(wrong, 'triangles')} of flat faces turned over or without area"
    return None


def _check_star_count(record: scene_dataset.SceneRecord, names: Sequence[str]) -> str | None:
    declared = record.star_count
    if not 0 <= record.label < len(names) or names[record.label] != str(declared):
        stated = with_count(declared, "stars")
        return f"star_count states {stated}; the label is {record.label}, an index into {', '.join(names)}"
    if record.has_placements:
        stars = sum(placement.is_star for placement in record.placements)
        others = len(record.placements) - stars
        if (stars, others) != (declared, record.distractor_count):
            expected = f"{declared} and {record.distractor_count}"
            return f"found {with_count(stars, 'stars')} and {others} other objects; expected {expected}"
    return None
