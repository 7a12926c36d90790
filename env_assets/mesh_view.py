"""Meshes as environments use them: from a data set, files or memory, their height maps, and their fit."""

from __future__ import annotations

import contextlib
import logging
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from numbers import Real
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from tactile_toolkit.cache import MemoryCache
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.mesh import MM_PER_M, Mesh, MeshFile, MeshLike, SolidRecord, highest_values
from tactile_toolkit.read import LazySequence, RecordDataset
from tactile_toolkit.value_types import AnyArray, Bool, Float32, Float64, Floating, Int32

if TYPE_CHECKING:
    import trimesh


_LOG = logging.getLogger(__name__)

# Distance by which a scene may protrude from its cell: less than the gel of the sensor is pressed in.
_SLACK_MM = 1.0


@dataclass(frozen=True, eq=False)
class LazyMesh:
    """A record whose mesh is read on first use; ``name`` is that of its file."""

    id: int
    label: int
    read: Callable[[], trimesh.Trimesh]
    name: str = ""

    @property
    def mesh(self) -> trimesh.Trimesh:
        """The mesh, metres; the least recently used are evicted from memory."""
        return _MESHES.get_or_make(self, self.read)

    @property
    def vertices_m(self) -> Float32:
        """Vertices, shape (V, 3), metres."""
        return np.asarray(self.mesh.vertices, np.float32)

    @property
    def faces(self) -> Int32:
        """Triangles, shape (F, 3), counter-clockwise seen from outside."""
        return np.asarray(self.mesh.faces, np.int32)


MeshRecord = SolidRecord | LazyMesh
"""A mesh with its number, unique among the meshes of a split, and its class."""
_MESHES = MemoryCache[LazyMesh, "trimesh.Trimesh"](64)


@dataclass(frozen=True, eq=False)
class MeshView(LazySequence[MeshRecord, "MeshView"]):
    """A sequence of records of meshes, with their classes and measures.

    Attributes
    ----------
    records : sequence of MeshRecord
        The meshes.
    label_names : tuple of str
        Classes, in order.
    flat : bool
        Whether each mesh is turned onto its broadest side when it is read (``flat_turn``).
    """

    thing = "mesh"
    things = "meshes"

    records: Sequence[MeshRecord]
    label_names: tuple[str, ...]
    flat: bool = False

    @classmethod
    def of(cls, meshes: MeshView | RecordDataset[Any]) -> MeshView:
        """Return a view of a data set of meshes; a view as it is."""
        if isinstance(meshes, MeshView):
            return meshes
        return cls(meshes, tuple(meshes.label_names))

    def __len__(self) -> int:
        return len(self.records)

    def _item(self, index: int) -> MeshRecord:
        record = self.records[index]
        if self.flat:
            return LazyMesh(record.id, record.label, partial(_laid_flat, record))
        return record

    def _several(self, index: Any) -> MeshView:
        chosen: Sequence[MeshRecord]
        if isinstance(self.records, RecordDataset):
            chosen = self.records[index]
        else:
            chosen = [self.records[row] for row in self.checked_indices(index)]
        return MeshView(chosen, self.label_names, self.flat)

    def column(self, name: str) -> AnyArray:
        """Return one value of each record, shape (n,); reads no mesh of a data set."""
        if isinstance(self.records, RecordDataset):
            return self.records.column(name)
        return np.array([getattr(record, name) for record in self.records])

    @cached_property
    def volumes_m3(self) -> Float64:
        """Volume of each mesh, shape (n,), cubic metres; negative if the triangles face inwards."""
        if isinstance(self.records, RecordDataset):
            with contextlib.suppress(InputError):  # the published data sets store no volumes
                return np.asarray(self.records.column("volume_m3"), np.float64)
        return np.array([_volume_m3(record) for record in self.records], np.float64)

    @cached_property
    def bounds_m(self) -> Float64:
        """Lowest and highest corner of each mesh before it is turned, shape (n, 2, 3), metres."""
        bounds = [mesh_bounds_m(record.vertices_m, f"mesh {record.id}") for record in self.records]
        return np.array(bounds, np.float64).reshape(-1, 2, 3)


@dataclass(frozen=True, eq=False)
class PlannedView(MeshView):
    """Meshes of a data set that is not made yet: each is made on first use.

    ``finished`` returns the data set once it is made, otherwise None; ``make_all`` makes it. ``left`` is the
    number of meshes that were not made when it was planned, which take about ``left_s`` seconds on one core.
    """

    finished: Callable[[], RecordDataset[Any] | None] = lambda: None
    make_all: Callable[[], RecordDataset[Any] | None] = lambda: None
    left: int = 0
    left_s: float = 0.0


def mesh_bounds_m(vertices_m: Floating, set_name: str) -> Float64:
    """Return the lowest and highest corner of vertices, shape (2, 3), metres; InputError without vertices."""
    if not len(vertices_m):
        raise InputError(
            f"{set_name} has no vertices",
            next="make the data set again; `tactile verify --content` names all such meshes",
        )
    # Column by column: numpy reduces short rows slowly.
    return np.array([[reduce(column) for column in vertices_m.T] for reduce in (np.min, np.max)], np.float64)


def _volume_m3(record: MeshRecord) -> float:
    vertices_m = record.vertices_m
    faces = record.faces
    # numpy would raise an error of its own, or take the last vertex for -1.
    missing = faces[(faces < 0) | (faces >= len(vertices_m))]
    if len(missing):
        raise InputError(
            f"mesh {record.id} has triangles that name vertex {missing[0]}, but only {len(vertices_m):,} "
            "vertices",
            next="make the data set again; `tactile verify --content` names all such meshes",
        )
    return Mesh(vertices_m, faces).volume_m3


def flat_turn(mesh: trimesh.Trimesh) -> Float64:
    """Return the rotation, shape (3, 3), that turns the shortest side of the box around a mesh upright.

    The other side that lies more along x becomes x; the upper side stays up. The package
    does so itself with ``smallest_dimension_up``, but fails with scipy 1.17, whose rotations refuse the
    read-only corners of trimesh's boxes.
    """
    box = mesh.bounding_box_oriented.primitive
    short, *others = np.asarray(box.transform)[:3, :3].T[np.argsort(box.extents)]
    up = math.copysign(1.0, short[2]) * short
    # From the longest on: of two sides that lie alike, the package takes the longer one.
    along = max(reversed(others), key=lambda side: abs(side[0]))
    return np.stack([along, np.cross(up, along), up])


def _laid_flat(record: MeshRecord) -> trimesh.Trimesh:
    turned = record.mesh.copy()
    turned.vertices = turned.vertices @ flat_turn(record.mesh).T
    return turned


def mesh_files(path: str | PathLike[str], split: str, unit: str | None = None) -> MeshView | None:
    """Open a mesh file, or a folder of them, as the meshes of a split; None if there is no such file.

    Files, splits and classes are those of :func:`tactile_toolkit.mesh.MeshFile.find`; a folder without
    splits is the same for all. Ids count files in the order of their names. ``unit`` is as
    :func:`tactile_toolkit.mesh.read_mesh` takes it. InputError: the folder holds only another split.
    """
    mesh_set = MeshFile.find(path, unit)
    if mesh_set is None:
        return None
    files = mesh_set.splits.get(split, mesh_set.splits.get(""))
    if files is None:
        others = list(mesh_set.splits)
        root = mesh_set.splits[others[0]][0].root
        raise InputError(
            f"{str(root)!r} has no split {split!r}, only {' and '.join(map(repr, others))}",
            next=f"put meshes into a sub-folder {split!r}, or give a folder without splits, such as "
            f"'{root}/{others[0]}'",
        )
    records = [
        LazyMesh(number, file.label, partial(_mesh_of_file, file), file.path.name)
        for number, file in enumerate(files)
    ]
    return MeshView(records, mesh_set.class_names)


def _mesh_of_file(file: MeshFile) -> trimesh.Trimesh:
    part = file.read()
    for note in part.notes:
        _LOG.warning("%s: %s", file.path, note)
    return Mesh(np.asarray(part.vertices_m, np.float32), part.faces).to_trimesh()


def require_fitting_meshes(
    meshes: MeshView, kind: DatasetKind | None, set_name: str, cell_m: tuple[float, float]
) -> None:
    """Refuse meshes of other classes than the environment's, too large for its cell, or inside out.

    Reads all meshes once. ``cell_m`` is (width, depth), metres; ``kind`` is None if any kind will do, and
    ``set_name`` is the data set and its split in the user's words. Raises InputError.
    """
    if not len(meshes):
        raise InputError(f"{set_name} holds no mesh", next="choose another split, or generate it")
    labels = meshes.column("label")
    names = meshes.label_names
    if kind is not None and kind.published and names != kind.class_names:  # others may be called anything
        raise InputError(
            f"{set_name} has classes {', '.join(names) or 'without names'}; expected "
            f"{', '.join(kind.class_names)}",
            next="give a data set with those classes",
        )
    corners_mm = meshes.bounds_m * MM_PER_M
    cell_mm = np.array(cell_m) * MM_PER_M
    size_mm = corners_mm[:, 1] - corners_mm[:, 0]
    # Scenes are not moved: their size is twice their extent from the origin.
    if kind is not None and kind.name == "starstruck":
        size_mm = 2 * np.maximum(np.abs(corners_mm).max(axis=1) - _SLACK_MM, 0)
    # Turned onto the broadest side, the shortest one stands upright.
    if meshes.flat:
        size_mm = np.sort(size_mm, axis=1)[:, ::-1]
    size_mm = size_mm[:, :2]
    checks: tuple[tuple[AnyArray, str, AnyArray, str], ...] = (
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
            "make the data set again; `tactile verify --content` names all such meshes",
        ),
    )
    for fits, defect, values, step in checks:
        wrong = np.flatnonzero(~fits)  # comparisons with NaN are false, so it does not fit
        if len(wrong):
            row = int(wrong[0])
            named = f"mesh {meshes.column('id')[row]}"
            if name := getattr(meshes.records[row], "name", ""):  # of its file; the ids are ours
                named += f" ({name!r})"
            what = f"{named} of {set_name} {defect.format(values[row])}"
            raise InputError(f"{what} ({len(wrong):,} of {len(meshes):,} do not fit)", next=step)


@dataclass(frozen=True, slots=True, eq=False)
class HeightMap:
    """The top surface of a mesh, in the frame of the mesh.

    The pixels of a pitch are the same for all meshes: pixel (i, j) is the square from ``i * pitch`` to
    ``(i + 1) * pitch`` along x and from ``j * pitch`` to ``(j + 1) * pitch`` along y. A map has those that
    touch the mesh.

    Row 0 has the least y and column 0 the least x: ``heights_m[row, column]`` is the surface above the point
    ``(x_m[column], y_m[row])``, the centre of that pixel. (Pictures put row 0 on top: show
    ``heights_m[::-1]``, or give matplotlib ``origin="lower"``.) Above pixels whose centre lies outside the
    mesh, as seen from above, the height is NaN.

    Attributes
    ----------
    heights_m : ndarray of float32, shape (rows, columns)
        z of the highest point of the mesh above each pixel centre, metres; read-only.
    first_column, first_row : int
        Least i and j.
    pitch_m : float
        Side of a pixel, metres.
    """

    heights_m: Float32
    first_column: int
    first_row: int
    pitch_m: float

    @property
    def x_m(self) -> Float64:
        """Centre of each column along x, shape (columns,), metres."""
        return _centres_m(self.first_column, self.heights_m.shape[1], self.pitch_m)

    @property
    def y_m(self) -> Float64:
        """Centre of each row along y, shape (rows,), metres."""
        return _centres_m(self.first_row, self.heights_m.shape[0], self.pitch_m)

    @property
    def covered(self) -> Bool:
        """Mask of the pixel centres under the mesh, shape (rows, columns)."""
        return ~np.isnan(self.heights_m)

    def filled(self, outside_m: float = 0.0) -> Float32:
        """Return the heights with a number in place of NaN, such as the plate's; a new array."""
        return np.where(self.covered, self.heights_m, np.float32(outside_m))


def top_surface(mesh: MeshLike, pitch_m: float) -> HeightMap:
    """Turn a mesh into a height map.

    Exact at pixel centres: the height is that of the highest triangle above the centre. Triangles are closed:
    a centre on an edge or corner is covered. Vertical triangles cover nothing. The mesh has to be a solid,
    with triangles counter-clockwise seen from outside.

    Parameters
    ----------
    mesh : Mesh, record or trimesh.Trimesh
        In metres.
    pitch_m : float
        Side of a pixel, metres.

    Returns
    -------
    HeightMap
        As many pixels as touch the bounding box of the mesh.

    Raises
    ------
    InputError
        No mesh, none of its vertices or an infinite one; a pitch that is not positive, or too small.

    Examples
    --------
    >>> corners = np.array([[0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, 4]], np.float32)
    >>> faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)
    >>> top_surface(Mesh(corners, faces), 1.0).heights_m[0]
    array([3., 2., 1., 0.], dtype=float32)
    """
    if not _is_length(pitch_m):
        raise InputError(
            f"the pitch of a height map is {pitch_m!r} m; expected a positive length such as 0.0002"
        )
    mesh = Mesh.of(mesh)
    vertices_m = np.asarray(mesh.vertices_m)
    if not len(vertices_m) or not np.isfinite(vertices_m).all():
        raise InputError("a mesh with no vertices, or NaN or infinite ones, has no height map")
    low = vertices_m[:, :2].astype(np.float64).min(axis=0)
    high = vertices_m[:, :2].max(axis=0)
    # The errors of a tiny pitch, which is refused below.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        # Counted from the origin and not from the mesh: two meshes of one frame share their pixels.
        first, stop = np.floor(low / float(pitch_m)), np.ceil(high / float(pitch_m))
        columns, rows = np.maximum(stop - first, 1).tolist()
        x_m, y_m, z_m = vertices_m.T.astype(np.float64)
        # The centre of pixel (i, j) of the map is at column i, row j.
        pixels = x_m / pitch_m - (first[0] + 0.5), y_m / pitch_m - (first[1] + 0.5)
    heights_m = highest_values(np.stack([*pixels, z_m]), mesh.faces, (rows, columns))
    heights_m[np.isneginf(heights_m)] = np.nan
    heights_m.setflags(write=False)
    return HeightMap(heights_m, int(first[0]), int(first[1]), float(pitch_m))


def _is_length(value: object) -> bool:
    number: Any = value if isinstance(value, (Real, np.number)) else 0
    return bool(0 < number <= sys.float_info.max)


def _centres_m(first: int, count: int, pitch_m: float) -> Float64:
    return np.asarray((np.arange(first, first + count) + 0.5) * pitch_m)
