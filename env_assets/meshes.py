"""Meshes in the one shape that environments use, of a data set, of files or in memory, and what must fit."""

from __future__ import annotations

import contextlib
import logging
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np

from tactile_toolkit import store
from tactile_toolkit.array_types import AnyArray, Float32, Float64, Floating, Int32
from tactile_toolkit.cache import MemoryCache
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.mesh import FORMATS, MM_PER_M, Mesh, read_mesh, require_unit
from tactile_toolkit.parsed_text import natural_key
from tactile_toolkit.read import RecordDataset, picks_several, positions

_LOG = logging.getLogger(__name__)
# Formats of objects that are not read.
_OTHER_FORMATS = (
    *(".gltf", ".dae", ".fbx", ".off", ".amf", ".wrl", ".x3d", ".3ds", ".blend"),
    *(".step", ".stp", ".iges", ".igs", ".usd", ".usda", ".usdc", ".usdz"),
)
_FIELDS = ("id", "label", "vertices_m", "faces", "mesh")
_SPLITS = ("train", "test")

# What a scene may stand out of its cell: less than the sensor's gel gives.
_SLACK_MM = 1.0


@dataclass(frozen=True, eq=False)
class LazyMesh:
    """A record whose mesh is read when it is asked for; ``name`` is how a user knows it."""

    id: int
    label: int
    read: Callable[[], Any]
    name: str = ""

    @property
    def mesh(self) -> Any:
        """The mesh, metres, a ``trimesh.Trimesh``; those used last stay in memory."""
        return _MESHES.get_or_make(self, self.read)

    @property
    def vertices_m(self) -> Float32:
        """Vertices, shape (V, 3), metres."""
        return np.asarray(self.mesh.vertices, np.float32)

    @property
    def faces(self) -> Int32:
        """Triangles, shape (F, 3), counter-clockwise seen from outside."""
        return np.asarray(self.mesh.faces, np.int32)


_MESHES = MemoryCache[LazyMesh, Any](64)


@dataclass(frozen=True, eq=False)
class MeshView(Sequence[Any]):
    """A sequence of records of meshes, with their classes and measures.

    Attributes
    ----------
    records : sequence
        Records as :meth:`env_assets.AssetSource.meshes` describes them.
    label_names : tuple of str
        Classes, in order.
    flat : bool
        Each mesh is turned onto its broadest side when it is read (:func:`flat_turn`).
    """

    records: Sequence[Any]
    label_names: tuple[str, ...]
    flat: bool = False

    @classmethod
    def of(cls, meshes: Any, label_names: Sequence[str] = ()) -> MeshView:
        """Return a view of a sequence of meshes.

        ``label_names`` are the classes of a sequence that does not name its own; numbers by default.
        InputError where it holds something else, or a label is not a number.
        """
        if isinstance(meshes, MeshView):
            return meshes
        if isinstance(meshes, RecordDataset) and hasattr(meshes.record_class, "mesh"):
            return cls(meshes, tuple(meshes.label_names))
        is_plain = isinstance(meshes, Sequence) and not isinstance(meshes, (str, bytes, RecordDataset))
        # Of the first alone: reading all fields of a lazy sequence would read all meshes.
        if not (is_plain and meshes and all(hasattr(meshes[0], name) for name in _FIELDS)):
            raise InputError(
                f"a data set of meshes was expected, found {type(meshes).__name__}",
                next="open one by `mnist3d.load`, or give a folder of meshes or a sequence of records with "
                "id, label, vertices_m, faces and mesh",
            )
        labels: list[Any] = [getattr(record, "label", None) for record in meshes]
        for row, label in enumerate(labels):
            if not isinstance(label, (int, np.integer)):
                raise InputError(
                    f"record {row} has label {label!r}; expected the number of its class, from 0 on"
                )
        names = tuple(getattr(meshes, "label_names", label_names))
        return cls(meshes, names or tuple(map(str, range(max(labels) + 1))))

    def __len__(self) -> int:
        return len(self.records)

    def __getitem__(self, key: Any) -> Any:
        """Return a record (int), or a view of some of them (slice, ints, mask)."""
        if not picks_several(key):
            record = self.records[operator.index(key)]
            return LazyMesh(record.id, record.label, partial(_laid_flat, record)) if self.flat else record
        if isinstance(self.records, RecordDataset):
            return MeshView(self.records[key], self.label_names, self.flat)
        chosen = [self.records[row] for row in positions(key, len(self)).tolist()]
        return MeshView(chosen, self.label_names, self.flat)

    def column(self, name: str) -> AnyArray:
        """Return one value of each record, shape (n,); of a data set no mesh is read."""
        if isinstance(self.records, RecordDataset):
            return self.records.column(name)
        return np.array([getattr(record, name) for record in self.records])

    @cached_property
    def volumes_m3(self) -> Float64:
        """Volume of each mesh, shape (n,), cubic metres; negative where the triangles face inwards."""
        if isinstance(self.records, RecordDataset):
            with contextlib.suppress(InputError):  # the published data sets store no volumes
                return np.asarray(self.records.column("volume_m3"), np.float64)
        return np.array([_volume_m3(record) for record in self.records], np.float64)

    @cached_property
    def bounds_m(self) -> Float64:
        """Lowest and highest corner of each mesh before it is turned, shape (n, 2, 3), metres."""
        bounds = [mesh_bounds_m(record.vertices_m, f"mesh {record.id}") for record in self.records]
        return np.array(bounds, np.float64).reshape(-1, 2, 3)


def mesh_bounds_m(vertices_m: Floating, where: str) -> Float64:
    """Return lowest and highest corner of some vertices, shape (2, 3), metres; InputError without any."""
    if not len(vertices_m):
        raise InputError(
            f"{where} has no vertices", next="run `validate` on the data set and generate it again"
        )
    # Column by column: numpy reduces short rows slowly.
    return np.array([[reduce(column) for column in vertices_m.T] for reduce in (np.min, np.max)], np.float64)


def _volume_m3(record: Any) -> float:
    vertices_m, faces = record.vertices_m, record.faces
    # Data may be of any origin: numpy would raise an error of its own, or for -1 take the last vertex.
    missing = faces[(faces < 0) | (faces >= len(vertices_m))]
    if len(missing):
        raise InputError(
            f"mesh {record.id} has triangles that name vertex {missing[0]}, but only {len(vertices_m):,} "
            "vertices",
            next="run `validate` on the data set and generate it again",
        )
    return Mesh(vertices_m, faces).volume_m3


def flat_turn(mesh: Any) -> Float64:
    """Return the rotation, shape (3, 3), that turns the shortest side of the box around a mesh upright.

    Of the other two sides, the one that lies more along x becomes x; what was above stays above. The package
    does so itself where ``smallest_dimension_up`` is set, and fails with scipy 1.17, whose rotations refuse
    the read-only corners of trimesh's boxes.
    """
    box = mesh.bounding_box_oriented.primitive
    short, *others = np.asarray(box.transform)[:3, :3].T[np.argsort(box.extents)]
    up = -short if short[2] < 0 else short
    # From the longest on: of two sides that lie alike, the package takes that one.
    along = max(reversed(others), key=lambda side: abs(side[0]))
    return np.stack([along, np.cross(up, along), up])


def _laid_flat(record: Any) -> Any:
    turned = record.mesh.copy()
    turned.vertices = turned.vertices @ flat_turn(record.mesh).T
    return turned


def mesh_files(place: str | PathLike[str], split: str, unit: str | None = None) -> MeshView | None:
    """Take a mesh file, or a folder of them, for the meshes of a split; None where it holds none.

    Sub-folders called ``train`` and ``test`` are splits; a folder without them is the same for both. Other
    sub-folders are classes; files that lie in none are a class each, named as they are. Ids count files in
    the order of their names. ``unit`` is as :func:`tactile_toolkit.mesh.read_mesh` takes it.
    InputError: the folder holds another split alone, or files lie next to classes.
    """
    require_unit(unit)
    root = store.expanded(fspath(place))
    if not store.path_exists(root):
        return None
    if not root.is_dir():
        read = partial(_mesh_of_file, unit=unit)
        return _view_of_files([root], [root.stem], read) if root.suffix.lower() in FORMATS else None
    read = partial(_mesh_of_file, unit=unit, below=root)
    if (root / split).is_dir():
        root = root / split
    elif others := [name for name in _SPLITS if mesh_files(root / name, split)]:
        raise InputError(
            f"{str(root)!r} has no split {split!r}, only {' and '.join(map(repr, others))}",
            next=f"put meshes into a sub-folder {split!r}, or give a folder without splits, such as "
            f"{str(root / others[0])!r}",
        )
    loose = _files_in(root)
    folders = (each.name for each in root.iterdir() if each.is_dir() and not store.is_hidden(each.name))
    sorted_files = [file for name in sorted(folders, key=natural_key) for file in _files_in(root / name)]
    if loose and sorted_files:
        raise InputError(
            f"{str(root)!r} holds mesh files ({loose[0].name}) next to folders of them "
            f"({sorted_files[0].parent.name})",
            next="put each file into the folder of its class, or give a folder of files alone",
        )
    classes = [file.parent.name for file in sorted_files] or [file.stem for file in loose]
    return _view_of_files(sorted_files or loose, classes, read) if classes else None


def _files_in(folder: Path) -> list[Path]:
    """Return the mesh files of a folder; a warning names meshes of formats that are not read."""
    # Hidden files may be half-written. In natural order (2 before 10) and not in that of the file system,
    # so that ids are the same on every machine.
    visible = (file for file in folder.iterdir() if not (file.is_dir() or store.is_hidden(file.name)))
    files = sorted(visible, key=lambda file: natural_key(file.name))
    found = [file for file in files if file.suffix.lower() in FORMATS]
    # A drawing may lie next to the mesh that was made of it.
    known = {file.stem for file in found}
    others = [each for each in files if each.suffix.lower() in _OTHER_FORMATS and each.stem not in known]
    for file in others if found else ():
        _LOG.warning("%s: left out; expected one of %s", file, ", ".join(FORMATS))
    return found


def _view_of_files(files: list[Path], classes: list[str], read: Callable[[Path], Any]) -> MeshView:
    numbers = {name: number for number, name in enumerate(dict.fromkeys(classes))}
    records = [
        LazyMesh(index, numbers[name], partial(read, file), file.name)
        for index, (file, name) in enumerate(zip(files, classes, strict=True))
    ]
    return MeshView(records, tuple(numbers))


def _mesh_of_file(path: Path, unit: str | None, below: Path | None = None) -> Any:
    found = read_mesh(path, unit=unit, below=below)
    for note in found.notes:
        _LOG.warning("%s: %s", path, note)
    return Mesh(np.asarray(found.vertices_m, np.float32), found.faces).to_trimesh()


def require_fitting_meshes(
    meshes: MeshView, kind: DatasetKind | None, where: str, cell_m: tuple[float, float]
) -> None:
    """Refuse meshes of other classes than the environment's, too large for its cell, or inside out.

    Reads all meshes once. ``cell_m`` is (width, depth), metres; ``kind`` is None where any will do,
    and ``where`` is the data set and its split in the user's words. Raises InputError.
    """
    if not len(meshes):
        raise InputError(f"{where} holds no mesh", next="choose another split, or generate it")
    labels, names = meshes.column("label"), meshes.label_names
    if kind is not None and kind.published and names != kind.class_names:  # others may be called anything
        raise InputError(
            f"{where} has classes {', '.join(names) or 'without names'}; expected "
            f"{', '.join(kind.class_names)}",
            next="give a data set with those classes",
        )
    corners_mm, cell_mm = meshes.bounds_m * MM_PER_M, np.array(cell_m) * MM_PER_M
    size_mm = corners_mm[:, 1] - corners_mm[:, 0]
    # Scenes are not moved: what they need about their origin.
    if kind is not None and kind.name == "starstruck":
        size_mm = 2 * np.maximum(np.abs(corners_mm).max(axis=1) - _SLACK_MM, 0)
    # Turned onto the broadest side, the shortest one stands upright, whichever of the others lies along x.
    size_mm = np.sort(size_mm, axis=1)[:, 1:] if meshes.flat else size_mm[:, :2]
    checks: tuple[tuple[Any, str, Any, str], ...] = (
        (
            (labels >= 0) & (labels < len(names)),
            f"has label {{}}, expected 0 to {len(names) - 1}",
            labels,
            "give a data set whose labels are numbers of its classes",
        ),
        (
            np.all(size_mm <= cell_mm, axis=1),
            f"needs {{0[0]:.1f}} x {{0[1]:.1f}} mm, the cell has {cell_mm[0]:.0f} x {cell_mm[1]:.0f} mm",
            size_mm,
            "see that vertices are metres and the origin of a scene is its middle, or choose a larger cell",
        ),
        (
            meshes.volumes_m3 > 0,
            "has a volume of {:.3g} m³, expected more than 0: its triangles face inwards, or it is open",
            meshes.volumes_m3,
            "run `validate` on the data set and generate it again",
        ),
    )
    for fits, found, values, step in checks:
        wrong = np.flatnonzero(~fits)  # NaN does not fit, as it compares false
        if len(wrong):
            row = int(wrong[0])
            # A user knows the files of a folder by their names; the ids are ours.
            name = getattr(meshes.records[row], "name", "")
            named = f"mesh {meshes.column('id')[row]}" + (f" ({name!r})" if name else "")
            what = f"{named} of {where} {found.format(values[row])}"
            raise InputError(f"{what} ({len(wrong):,} of {len(meshes):,} do not fit)", next=step)
