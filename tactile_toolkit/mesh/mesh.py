"""Triangle meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias, cast

import numpy as np

from tactile_toolkit.arithmetic import moved
from tactile_toolkit.array_types import AnyArray, Float64, Floating, Int32
from tactile_toolkit.errors import InputError

if TYPE_CHECKING:
    import manifold3d
    import trimesh

    from tactile_toolkit import read


MM_PER_M = 1000.0

Surface: TypeAlias = tuple[Float64, Int32]
"""Vertices and triangles, in any unit."""

MeshLike: TypeAlias = "Mesh | read.Record | trimesh.Trimesh"
"""Types that :func:`as_mesh` accepts."""


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

    def _corners_m(self) -> Float64:
        return self.vertices_m.astype(np.float64)[self.faces]

    def _signed_volumes_m3(self) -> Float64:
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = np.moveaxis(self._corners_m(), 0, 2)
        signed = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        return np.asarray(signed / 6.0)


def as_mesh(thing: MeshLike) -> Mesh:
    """Return a mesh unchanged; convert a record or a trimesh.Trimesh, which are in metres too.

    Raises InputError for other types.
    """
    if isinstance(thing, Mesh):
        return thing
    if hasattr(thing, "vertices_m") and hasattr(thing, "faces"):
        return Mesh(thing.vertices_m, thing.faces)
    # Recognised by its attributes: importing trimesh would take longer than most uses of this function.
    if hasattr(thing, "vertices") and hasattr(thing, "faces"):
        return Mesh.from_trimesh(cast("trimesh.Trimesh", thing))
    raise InputError(
        f"a {type(thing).__name__} holds no triangles; expected a Mesh, a record of a data set or a "
        "trimesh.Trimesh, in metres"
    )


def placed(surface: Surface, turn: Float64, shift: Float64) -> Surface:
    """Return a surface times a matrix (3, 3) from the right, and shifted; a mirrored one is turned back."""
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
