"""The meshes of a batch of scenes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from starstruck_gen.placement import Placement
from starstruck_gen.shapes import prisms
from tactile_toolkit import mesh, read
from tactile_toolkit.array_types import Int64


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

    vertices_m: read.RaggedColumn
    faces: read.RaggedColumn

    def __len__(self) -> int:
        return len(self.vertices_m)

    def __getitem__(self, index: int) -> mesh.Mesh:
        """Return the mesh of one scene: views, no copies."""
        return mesh.Mesh(self.vertices_m[index], self.faces[index])


def build_meshes(layouts: Sequence[Sequence[Placement]]) -> SceneMeshes:
    """Make the meshes of a batch of scenes.

    Each object is a separate solid on z = 0, in the order of the placements; see
    :class:`starstruck_gen.Placement` for the frame. The mesh of a scene does not depend on the other scenes
    of the batch.

    Parameters
    ----------
    layouts : sequence of sequence of Placement
        Objects of each scene.

    Returns
    -------
    SceneMeshes
    """
    from starstruck_gen.compiled_vertices import standing_vertices  # numba takes 0.5 s to import

    outlines = [prisms(tuple([placement.shape for placement in layout])) for layout in layouts]
    poses = np.array([placement[1:] for layout in layouts for placement in layout], np.float64)
    parts = outlines or [prisms(())]  # there may be no layout
    corners = np.concatenate([made.corners for made in parts])
    corner_counts = np.concatenate([made.corner_counts for made in parts])
    faces = np.concatenate([made.faces for made in parts])
    vertices = standing_vertices(poses.reshape(-1, 5), corners, corner_counts)
    return SceneMeshes(
        read.RaggedColumn(vertices, _offsets([2 * len(made.corners) for made in outlines])),
        read.RaggedColumn(faces, _offsets([len(made.faces) for made in outlines])),
    )


def _offsets(counts: list[int]) -> Int64:
    return np.array([0, *accumulate(counts)], dtype=np.int64)
