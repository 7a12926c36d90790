"""Measures of all meshes of a data set at once: each block of rows is decoded once, no record is made."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dataset_store.errors import InputError
from dataset_store.mesh import Mesh
from dataset_store.mesh_columns import FACES, VERTICES
from dataset_store.rowgroups import RowGroup
from env_assets.mesh_memory import Remembering

__all__ = ["bounds_m", "mesh_bounds_m", "volumes_m3"]


def volumes_m3(meshes: Remembering) -> NDArray[np.float64]:
    """Return the volume of each mesh, shape (n,), cubic metres; negative where the triangles face inwards.

    Reads the column of volumes alone where there is one, and else vertices and faces, once for each data set
    that was opened.
    """
    try:
        return np.asarray(meshes.column("volume_m3"), np.float64)
    except InputError:  # the published data sets store no volumes
        return meshes.measured("volumes of the meshes", [VERTICES, FACES], _volumes_m3)


def bounds_m(meshes: Remembering) -> NDArray[np.float64]:
    """Return lowest and highest corner of each mesh, shape (n, 2, 3), metres; reads vertices alone."""
    return meshes.measured("bounds of the meshes", [VERTICES], _bounds_m)


def mesh_bounds_m(vertices_m: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return lowest and highest corner of some vertices, shape (2, 3), metres."""
    # Column by column: numpy reduces short rows slowly.
    return np.array([[reduce(column) for column in vertices_m.T] for reduce in (np.min, np.max)], np.float64)


def _volumes_m3(group: RowGroup) -> NDArray[np.float64]:
    vertices, faces = group.ragged(VERTICES), group.ragged(FACES)
    rows = range(len(vertices))
    return np.array([Mesh(vertices[row], faces[row]).volume_m3 for row in rows], np.float64)


def _bounds_m(group: RowGroup) -> NDArray[np.float64]:
    vertices = group.ragged(VERTICES)
    return np.array([mesh_bounds_m(vertices[row]) for row in range(len(vertices))]).reshape(-1, 2, 3)
