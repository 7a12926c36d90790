"""Meshes of many scenes at once: the solids of the shapes are moved to where they stand in one step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starstruck_gen.placement import Placement
from starstruck_gen.solid import Prism, prism
from tactile_toolkit.mesh.mesh import Mesh
from tactile_toolkit.read.columns import RaggedColumn

__all__ = ["SceneMeshes", "stamp"]


@dataclass(frozen=True, slots=True, eq=False)
class SceneMeshes:
    """The meshes of a batch of scenes.

    Attributes
    ----------
    vertices_m : RaggedColumn
        Row i: vertices of scene i, shape (V_i, 3), float32, metres, as they are stored.
    faces : RaggedColumn
        Row i: triangles of scene i, shape (F_i, 3), int32, numbered within the scene.
    """

    vertices_m: RaggedColumn
    faces: RaggedColumn

    def __len__(self) -> int:
        return len(self.vertices_m)

    def __getitem__(self, index: int) -> Mesh:
        """Return the mesh of one scene: views, no copies."""
        return Mesh(self.vertices_m[index], self.faces[index])


def stamp(layouts: Sequence[Sequence[Placement]]) -> SceneMeshes:
    """Make the meshes of a batch of scenes.

    Each object is one solid of its own, in order of the placements, standing on z = 0; see
    :class:`starstruck_gen.Placement` for the frame. A scene's mesh does not depend on what else is
    in the batch.

    Parameters
    ----------
    layouts : sequence of sequence of Placement
        Objects of each scene.

    Returns
    -------
    SceneMeshes
    """
    placements = [placement for layout in layouts for placement in layout]
    prisms = [prism(placement.shape) for placement in placements]
    corner_ends = np.cumsum([0, *(len(made.corners) for made in prisms)])
    face_ends = np.cumsum([0, *(len(made.faces) for made in prisms)])
    # The first object of each scene; one more entry closes the last scene.
    firsts = np.cumsum([0, *map(len, layouts)])
    vertices = _vertices(placements, prisms, np.diff(corner_ends))
    # Faces are numbered within their scene, not within the batch.
    shifts = 2 * (corner_ends[:-1] - np.repeat(corner_ends[firsts[:-1]], np.diff(firsts)))
    faces = _joined([made.faces for made in prisms], 3, np.int32)
    faces = faces + np.repeat(shifts.astype(np.int32), np.diff(face_ends))[:, None]
    return SceneMeshes(
        RaggedColumn(vertices, 2 * corner_ends[firsts]), RaggedColumn(faces, face_ends[firsts])
    )


def _vertices(
    placements: Sequence[Placement], prisms: Sequence[Prism], counts: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Turn, scale and move the corners of all objects, each standing twice: on the plate and above it."""
    # numpy's own cosine may round differently from one processor to the next and by the length of the array;
    # the same bytes in any batch need the C library's.
    poses = [
        (x, y, math.cos(angle) * radius, math.sin(angle) * radius, height)
        for _, x, y, angle, radius, height in placements
    ]
    x, y, c, s, height = np.repeat(np.array(poses, dtype=np.float64).reshape(-1, 5).T, counts, axis=1)
    corners = _joined([made.corners for made in prisms], 2, np.float64)
    vertices = np.zeros((len(corners), 2, 3), dtype=np.float32)
    vertices[:, :, 0] = (c * corners[:, 0] - s * corners[:, 1] + x)[:, None]
    vertices[:, :, 1] = (s * corners[:, 0] + c * corners[:, 1] + y)[:, None]
    vertices[:, 1, 2] = height
    return vertices.reshape(-1, 3)


def _joined(parts: list[NDArray[Any]], width: int, dtype: type[np.generic]) -> NDArray[Any]:
    return np.concatenate(parts) if parts else np.zeros((0, width), dtype)
