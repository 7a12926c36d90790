"""Solids that are touched: those of a data set, mesh files, and meshes in memory."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from typing import TypeAlias

import numpy as np

from tactile_sim.sets.touch_table import TouchTable
from tactile_toolkit import mesh, places, read, touch
from tactile_toolkit.errors import InputError, IntegrityError, ItemError
from tactile_toolkit.value_types import AnyArray, Int64, JsonDict, JsonObject

Meshes: TypeAlias = "Mapping[str, mesh.MeshLike | Sequence[mesh.MeshLike]]"
"""Meshes in memory by the name of their class: one each, or several."""
_TRAIN = "train"  # split of solids without a stated split
_SHOWN_IDS = 5

Records: TypeAlias = "mesh.SolidDataset[mesh.SolidRecord]"
"""Solids of a data set."""

Solids: TypeAlias = "Records | GivenSolids"
"""Solids of a split, of either source."""

Opener: TypeAlias = Callable[[places.Name], places.Place]
"""Opens a data set by its name."""


@dataclass(frozen=True)
class _ListedFile:
    """A mesh file, identified by its content when it was listed."""

    file: mesh.MeshFile
    sha256: str

    @property
    def path(self) -> str:
        return str(self.file.path)

    def read(self) -> mesh.Mesh:
        content = self.file.content()
        if hashlib.sha256(content).hexdigest() != self.sha256:
            raise IntegrityError(
                f"{self.path!r} was replaced or changed during the run", next="run the command again"
            )
        return self.file.parse(content)


@dataclass(frozen=True)
class GivenSolid:
    """One solid, read on access.

    ``name`` is the file inside its folder, or class and number; ``facts`` are JSON values for the manifest.
    """

    id: int
    label: int
    name: str
    source: _ListedFile | mesh.Mesh = field(repr=False)
    facts: JsonObject = field(repr=False)

    def mesh(self) -> mesh.Mesh:
        """Read the mesh, metres; ItemError if it cannot be read, or is larger than the cell."""
        solid = self.source
        if isinstance(solid, _ListedFile):
            try:
                solid = solid.read()
            except InputError as error:
                raise ItemError(mesh.PrintReport.UNREADABLE, str(error)) from error
        if solid.array_problem is None:  # meshes without faces have no size, and bound no solid
            _require_within_cell(solid)
        return solid


@dataclass(frozen=True)
class GivenSolids:
    """The solids of a split, with the attributes of a data set of solids that touches are made by."""

    solids: tuple[GivenSolid, ...]
    label_names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.solids)

    def __getitem__(self, row: int) -> GivenSolid:
        """Return a solid."""
        return self.solids[row]

    @property
    def ids(self) -> Int64:
        """Number of each solid, shape (len,)."""
        return self.column("id")

    @property
    def object_ids(self) -> Int64:
        """Number of each solid, shape (len,)."""
        return self.ids

    @property
    def labels(self) -> Int64:
        """Class of each solid, shape (len,)."""
        return self.column("label")

    def column(self, name: str) -> AnyArray:
        """Return an integer of each solid, shape (len,)."""
        return np.array([getattr(solid, name) for solid in self.solids], np.int64)

    @property
    def files(self) -> tuple[_ListedFile, ...]:
        """The files, each with its ``path``."""
        return tuple(solid.source for solid in self.solids if isinstance(solid.source, _ListedFile))

    def fingerprints(self) -> list[JsonDict]:
        """Return JSON values that identify the solids, in the order of their numbers."""
        return [{"file": solid.name, "rows": 1, "id": solid.id, **solid.facts} for solid in self.solids]


def given_solids(
    source: str | PathLike[str] | Meshes, unit: str | None = None
) -> dict[str, GivenSolids] | None:
    """Open mesh files or meshes by split; None for a data set.

    Solids are numbered in the order of their names, those of all splits together. ``unit`` is that of STL,
    PLY and OBJ files, as :func:`tactile_toolkit.mesh.read_mesh` takes it.

    Raises
    ------
    InputError
        A file cannot be opened, a mesh is not valid, or a unit is given for meshes in memory.
    """
    if isinstance(source, Mapping):
        mesh.refuse_unit(unit, "meshes in memory")
        return _in_memory(source)
    mesh_files = mesh.MeshFile.find(source, unit)
    if mesh_files is None:
        return None
    listed = ((split or _TRAIN, file) for split, files in mesh_files.splits.items() for file in files)
    solids: dict[str, list[GivenSolid]] = {}
    for number, (split, file) in enumerate(listed):
        try:
            content = hashlib.sha256(file.content()).hexdigest()
        except InputError as error:
            raise InputError(f"{file.path}: {error}") from error
        facts: JsonDict = {"sha256": content}
        if file.assumed_unit is not None:
            facts["unit"] = file.assumed_unit
        # Absolute, because the file is read later.
        kept = replace(file, path=file.path.absolute(), root=file.root and file.root.absolute())
        solid = GivenSolid(number, file.label, file.name, _ListedFile(kept, content), facts)
        solids.setdefault(split, []).append(solid)
    return {split: GivenSolids(tuple(of_split), mesh_files.class_names) for split, of_split in solids.items()}


def _in_memory(meshes: Meshes) -> dict[str, GivenSolids]:
    solids: list[GivenSolid] = []
    for label, (name, class_meshes) in enumerate(meshes.items()):
        if not isinstance(name, str) or not name:
            raise InputError(f"a class of the meshes is called {name!r}; expected a text")
        several = class_meshes if isinstance(class_meshes, (list, tuple)) else [class_meshes]
        for number, mesh_like in enumerate(several):
            parsed = mesh.Mesh.of(mesh_like)
            # A copy, because the mesh may change while touches are made.
            held = mesh.Mesh(np.array(parsed.vertices_m, np.float64), np.array(parsed.faces, np.int32))
            facts = {"sha256": _digest(held)}
            solids.append(GivenSolid(len(solids), label, f"{name}/{number}", held, facts))
    if not solids:
        raise InputError("no meshes were given; expected at least one, by the name of its class")
    return {_TRAIN: GivenSolids(tuple(solids), tuple(meshes))}


def _digest(held: mesh.Mesh) -> str:
    content = hashlib.sha256(repr((held.vertices_m.shape, held.faces.shape)).encode())
    content.update(np.ascontiguousarray(held.vertices_m, "<f8").tobytes())
    content.update(np.ascontiguousarray(held.faces, "<i4").tobytes())
    return content.hexdigest()


def _require_within_cell(solid: mesh.Mesh) -> None:
    sides_m = np.ptp(solid.vertices_m, axis=0)[:2]
    if (sides_m > touch.CELL_M).any():
        width_mm, depth_mm = 1e3 * sides_m
        raise ItemError(
            "too-large",
            f"it is {width_mm:.4g} x {depth_mm:.4g} mm as seen from above; expected at most "
            f"{1e3 * touch.CELL_M[0]:g} x {1e3 * touch.CELL_M[1]:g} mm, the cell; next: check its unit, or "
            "scale it",
        )


def solids_of(
    source: places.Name | places.Place | Meshes, unit: str | None, open_place: Opener, operation: str
) -> tuple[str, Mapping[str, Solids], str]:
    """Return name and splits of a data set, mesh files or meshes, and a note if it is unfinished.

    ``operation`` is the command that touches them, such as ``"generate"``, for messages.
    """
    if isinstance(source, places.Place):
        dataset = source
    else:
        splits = given_solids(source, unit)
        if splits is not None:
            return "the source", splits, ""
        assert not isinstance(source, Mapping), "meshes in memory are given solids"
        dataset = open_place(source)
    mesh.refuse_unit(unit, dataset.name)
    dataset.require_meshes(f"tactile-sim {operation}").require_complete()
    return dataset.name, {split: open_split(dataset, split) for split in dataset.splits}, dataset.unfinished


def open_split(dataset: places.Place, split: str) -> Records:
    """Open a split of a data set of solids; InputError for a source without meshes."""
    shards = dataset.shards(split)
    names = mesh.SolidDataset.classes_of(shards, dataset.name, "mnist3d generate", touch.CLASS_NAMES)
    return mesh.SolidDataset(read.ShardedTable(shards), label_names=names)


def content_fingerprint(shard: read.Shard) -> JsonDict:
    """Return JSON values that identify a file by all of its bytes, for sources of moderate size."""
    with shard.stored() as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()  # type: ignore[arg-type]
    return {"file": shard.path.rpartition("/")[2], "rows": len(shard), "sha256": digest}


def fingerprints(solids: Solids) -> list[JsonDict]:
    """Return JSON values that identify the solids of a split."""
    if isinstance(solids, GivenSolids):
        return solids.fingerprints()
    return list(map(content_fingerprint, solids.files))


def title(solid: mesh.SolidRecord | GivenSolid) -> str:
    """Return the name of a solid in messages."""
    if isinstance(solid, GivenSolid):
        return f"object {solid.id} ({solid.name})"
    return f"object {solid.id}"


def mesh_of(solid: mesh.SolidRecord | GivenSolid) -> mesh.Mesh:
    """Return the mesh of a solid; InputError if its file cannot be used."""
    if isinstance(solid, GivenSolid):
        return solid.mesh()
    return mesh.Mesh.of(solid)


def require_known_objects(name: str, splits: Mapping[str, Solids], table: TouchTable) -> None:
    """Refuse given touches of objects that no split holds (InputError)."""
    if table.object_id is None:
        return
    known = np.concatenate([solids.column("id") for solids in splits.values()])
    unknown = np.setdiff1d(table.object_id, known)
    if len(unknown):
        shown = ", ".join([*map(str, unknown[:_SHOWN_IDS]), "..."][: len(unknown)])
        raise InputError(
            f"touches of objects {shown} are given, but {name} holds no such id", next="correct `object_id`"
        )
