"""Triangle meshes, and merging of their vertices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias, cast

import numpy as np

from tactile_toolkit.arithmetic import moved
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import AnyArray, Float64, Floating, Int32, Integers
from tactile_toolkit.wording import with_count

if TYPE_CHECKING:
    import manifold3d
    import trimesh

    from tactile_toolkit import read

MM_PER_M = 1000.0

Surface: TypeAlias = tuple[Float64, Int32]
"""Vertices and triangles, in any unit."""

MeshLike: TypeAlias = "Mesh | read.Record | trimesh.Trimesh"
"""Types that :meth:`Mesh.of` accepts."""

# Corners closer than this fraction of the size of the object are welded where that closes the surface.
_WELDED = 1e-5

# More corners in one place are not due to rounding; this bounds memory.
_NEIGHBOURS = 16


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Mesh:
    """Triangles in space.

    Attributes
    ----------
    vertices_m : ndarray of float32 or float64, shape (V, 3)
        Corner positions in metres, z away from the plate; each kind of data set states its frame.
    faces : ndarray of int32, shape (F, 3)
        Rows of ``vertices_m``, counter-clockwise when seen from outside.
    notes : tuple of str
        What reading a file changed or left out.
    """

    vertices_m: Floating
    faces: Int32
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        # As trimesh prints its own.
        return f"<Mesh(vertices_m.shape={self.vertices_m.shape}, faces.shape={self.faces.shape})>"

    @property
    def array_problem(self) -> tuple[str, str] | None:
        """Problem of the arrays, or None: a word of :data:`.solid_check.PROBLEMS`, and a sentence."""
        vertices, faces = self.vertices_m, self.faces
        if vertices.ndim != 2 or faces.ndim != 2 or vertices.shape[1] != 3 or faces.shape[1] != 3:
            shapes = f"vertices {vertices.shape}, faces {faces.shape}"
            return "bad-shape", f"{shapes}; expected (V, 3) and (F, 3)"
        if not len(vertices) or not len(faces):
            problem = f"{with_count(len(vertices), 'vertices')} and {with_count(len(faces), 'faces')}"
            return "empty", f"{problem}; expected a closed surface"
        if not np.isfinite(vertices).all():
            bad = int((~np.isfinite(vertices)).any(axis=1).sum())
            return "not-finite", f"{bad:,} of {len(vertices):,} vertices: NaN or infinite"
        if faces.min() < 0 or faces.max() >= len(vertices):
            problem = f"faces name vertices {faces.min()} to {faces.max()}"
            return "index-out-of-range", f"{problem}; there are 0 to {len(vertices) - 1}"
        return None

    @classmethod
    def of(cls, thing: MeshLike) -> Mesh:
        """Return a mesh unchanged; convert a record or a trimesh.Trimesh, which are in metres too.

        Raises InputError for other types.
        """
        if isinstance(thing, Mesh):
            return thing
        if hasattr(thing, "vertices_m") and hasattr(thing, "faces"):
            return Mesh(thing.vertices_m, thing.faces)
        # Recognised by its attributes: importing trimesh would take longer than most uses of this function.
        if hasattr(thing, "vertices") and hasattr(thing, "faces"):
            return cls.from_trimesh(cast("trimesh.Trimesh", thing))
        raise InputError(
            f"a {type(thing).__name__} holds no triangles; expected a Mesh, a record of a data set or a "
            "trimesh.Trimesh, in metres"
        )

    @property
    def volume_m3(self) -> float:
        """Enclosed volume in cubic metres; negative when the mesh is inside out."""
        return float(self._signed_volumes_m3().sum())

    @property
    def center_mass_m(self) -> Float64:
        """Centre of mass of the evenly filled solid, shape (3,), metres."""
        signed = self._signed_volumes_m3()
        middles = self._corners_m().sum(axis=1) / 4.0
        return np.asarray((signed[:, None] * middles).sum(axis=0) / signed.sum(), dtype=np.float64)

    @property
    def bounds_m(self) -> Float64:
        """Lowest and highest corner of the bounding box, shape (2, 3), metres."""
        return np.stack([self.vertices_m.min(axis=0), self.vertices_m.max(axis=0)]).astype(np.float64)

    @property
    def vertices_mm(self) -> Float64:
        """The vertices in millimetres, float64."""
        return np.ascontiguousarray(self.vertices_m, dtype=np.float64) * MM_PER_M

    def to_trimesh(self) -> trimesh.Trimesh:
        """Convert to trimesh; no vertex is merged, moved or dropped.

        Returns
        -------
        trimesh.Trimesh
            In metres.
        """
        import trimesh  # takes a second to import

        return trimesh.Trimesh(vertices=self.vertices_m, faces=self.faces, process=False)

    @classmethod
    def from_trimesh(cls, mesh: trimesh.Trimesh) -> Mesh:
        """Convert from trimesh; no vertex is merged, moved or dropped.

        Parameters
        ----------
        mesh : trimesh.Trimesh
            In metres.

        Returns
        -------
        Mesh
            Float64.
        """
        return cls(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32))

    def to_manifold(self) -> manifold3d.Manifold:
        """Convert to manifold3d in double precision.

        Returns
        -------
        manifold3d.Manifold
            In millimetres. Empty for a mesh that does not bound a solid; its ``status()`` says why.
        """
        import manifold3d  # few meshes are checked

        # Mesh64, because manifold3d merges vertices that are equal in single precision.
        return manifold3d.Manifold(manifold3d.Mesh64(self.vertices_mm, self.faces.astype(np.uint64)))

    @classmethod
    def from_manifold(cls, solid: manifold3d.Manifold) -> Mesh:
        """Convert the surface of a manifold3d.Manifold in millimetres; float64."""
        arrays = solid.to_mesh64()
        vertices_mm = np.asarray(arrays.vert_properties, np.float64)[:, :3]
        return cls(vertices_mm / MM_PER_M, np.asarray(arrays.tri_verts).astype(np.int32))

    def merged(self) -> Mesh:
        """Merge vertices with equal coordinates, in order of first appearance; float64."""
        return Mesh(*merge_equal_vertices(np.asarray(self.vertices_m, np.float64), self.faces))

    def on_plate(self, scale: float = 1.0) -> Mesh:
        """Place the mesh on a plate without rotation: only its height above the plate changes.

        Vertices with equal coordinates are merged, as solids need; ``scale`` multiplies all lengths, about
        the origin.
        """
        part = Mesh(np.asarray(self.vertices_m, np.float64) * scale, np.asarray(self.faces, np.int32))
        count = len(part.vertices_m)
        # Faces with invalid vertex numbers are left to the check of the solid.
        if part.faces.size and part.faces.min() >= 0 and part.faces.max() < count:
            part = part.merged()
        if count:
            part.vertices_m[:, 2] -= part.vertices_m[:, 2].min()
        return part

    def crossing_mm(self, bodies: int) -> Float64 | None:
        """Return a point, shape (3,), where one of this number of bodies crosses itself, or None."""
        # numba takes half a second to import.
        from tactile_toolkit.mesh.crossings import self_crossing

        return self_crossing(self.vertices_mm, self.faces.astype(np.int64), bodies)

    def _corners_m(self) -> Float64:
        return self.vertices_m.astype(np.float64)[self.faces]

    def _signed_volumes_m3(self) -> Float64:
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = np.moveaxis(self._corners_m(), 0, 2)
        signed = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        return np.asarray(signed / 6.0)


def placed(surface: Surface, turn: Float64, shift: Float64) -> Surface:
    """Return a surface times a matrix (3, 3) from the right, and shifted; a mirror reverses the faces."""
    vertices, faces = surface
    if np.linalg.det(turn) < 0:
        faces = faces[:, ::-1]
    return moved(vertices, turn) + shift, faces


def join_surfaces(surfaces: Sequence[tuple[AnyArray, AnyArray]]) -> Surface:
    """Join several surfaces into one."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in surfaces)])
    faces = [corners + np.int32(start) for (_, corners), start in zip(surfaces, starts, strict=False)]
    return (
        np.concatenate([np.zeros((0, 3)), *(vertices for vertices, _ in surfaces)]),
        np.concatenate([np.zeros((0, 3), np.int32), *faces]).astype(np.int32),
    )


def merge_equal_vertices(vertices: Float64, faces: Integers) -> Surface:
    """Merge vertices with equal coordinates, in order of first appearance."""
    # trimesh would merge within a tolerance; numpy's unique rows take three times as long.
    rows = vertices + 0.0  # -0.0 equals 0.0
    order = np.lexsort(rows.T)
    in_order = rows.take(order, axis=0)
    is_new = np.concatenate([[True], (in_order[1:] != in_order[:-1]).any(axis=1)])[: len(rows)]
    group = np.empty(len(rows), np.int64)
    group[order] = np.cumsum(is_new) - 1
    first = order[is_new]
    by_appearance = np.argsort(first)
    number = np.empty(len(first), np.int32)
    number[by_appearance] = np.arange(len(first), dtype=np.int32)
    return vertices.take(first[by_appearance], axis=0), number[group].take(faces)


def welded(vertices: Float64, faces: Int32) -> Mesh:
    """Weld corners that rounding has separated, where that closes the surface; metres."""
    if not len(faces) or not np.isfinite(vertices).all() or _is_closed(faces, len(vertices)):
        return Mesh(vertices, faces)
    # Few meshes need these, and they take 0.3 s to import.
    from scipy.sparse import coo_array, csgraph
    from scipy.spatial import cKDTree

    # Ends of edges that do not occur in both directions.
    ends = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    forth, back = (ends @ weights for weights in ((len(vertices), 1), (1, len(vertices))))
    torn = np.unique(ends[~(np.isin(forth, back) & np.isin(back, forth))])
    if len(torn) < 2:
        return Mesh(vertices, faces)
    reach_m = _WELDED * float(np.ptp(vertices, axis=0).max())
    tree = cKDTree(vertices[torn])
    count = min(_NEIGHBOURS, len(torn))
    away_m, near = map(np.asarray, tree.query(vertices[torn], count, distance_upper_bound=reach_m))
    row, column = np.nonzero(np.isfinite(away_m))
    graph = coo_array((np.ones(len(row)), (row, near[row, column])), (len(torn), len(torn)))
    group = csgraph.connected_components(graph, directed=False)[1]
    first = np.full(len(torn), len(vertices))
    np.minimum.at(first, group, torn)
    numbers = np.arange(len(vertices))
    numbers[torn] = first[group]
    corners = numbers[faces]
    corners = corners[(corners != np.roll(corners, 1, axis=1)).all(axis=1)]
    if not len(corners) or not _is_closed(corners, len(vertices)):
        return Mesh(vertices, faces)
    used, corners_used = np.unique(corners, return_inverse=True)
    # A single distant corner would make others count as near, and weld unrelated parts.
    if (np.abs(np.ptp(vertices[used], axis=0) - np.ptp(vertices, axis=0)) > 2 * reach_m).any():
        return Mesh(vertices, faces)
    count = int((numbers != np.arange(len(vertices))).sum())
    kept = corners_used.reshape(-1, 3).astype(np.int32)
    return Mesh(vertices[used], kept, (f"{with_count(count, 'corners')} welded",))


def _is_closed(faces: Integers, count: int) -> bool:
    """Return whether each edge occurs equally often in both directions; wrong with probability 2^-64."""
    corners = np.ascontiguousarray(faces.T)
    following = [1, 2, 0]
    random = np.random.default_rng(0).integers(1 << 63, size=(2, count), dtype=np.uint64)
    starts, ends = (numbers.take(corners) for numbers in random)
    return bool((starts * ends[following]).sum() == (ends * starts[following]).sum())
