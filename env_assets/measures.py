"""Measures of all meshes of a data set at once: each block of rows is decoded once, no record is made."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from env_assets.mesh_sets import PlainMeshes, Remembering
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.columns import FACES, VERTICES
from tactile_toolkit.mesh.mesh import Mesh
from tactile_toolkit.read.columns import RowGroup

__all__ = ["Measurable", "bounds_m", "mesh_bounds_m", "volumes_m3"]


Measurable = Remembering[Any] | PlainMeshes
"""Data sets of meshes that are measured all at once."""


def volumes_m3(meshes: Measurable) -> NDArray[np.float64]:
    """Return the volume of each mesh, shape (n,), cubic metres; negative where the triangles face inwards.

    Reads the column of volumes alone where there is one, and else vertices and faces, once for each data set
    that was opened.
    """
    # Records that a user has, whatever they say of themselves: their volumes are measured.
    if isinstance(meshes, PlainMeshes):
        return np.array([_volume_m3(mesh.vertices_m, mesh.faces, f"mesh {mesh.id}") for mesh in meshes])
    try:
        return np.asarray(meshes.column("volume_m3"), np.float64)
    except InputError:  # the published data sets store no volumes
        return meshes.measured("volumes of the meshes", ["id", VERTICES, FACES], _volumes_m3)


def bounds_m(meshes: Measurable) -> NDArray[np.float64]:
    """Return lowest and highest corner of each mesh, shape (n, 2, 3), metres; reads vertices alone."""
    if isinstance(meshes, PlainMeshes):
        return np.array([mesh_bounds_m(mesh.vertices_m, f"mesh {mesh.id}") for mesh in meshes])
    return meshes.measured("bounds of the meshes", ["id", VERTICES], _bounds_m)


def mesh_bounds_m(vertices_m: NDArray[np.floating[Any]], where: str) -> NDArray[np.float64]:
    """Return lowest and highest corner of some vertices, shape (2, 3), metres; InputError without any."""
    if not len(vertices_m):
        message = f"{where} has no vertices; next: run `validate` on the data set and generate it again"
        raise InputError(message)
    # Column by column: numpy reduces short rows slowly.
    return np.array([[reduce(column) for column in vertices_m.T] for reduce in (np.min, np.max)], np.float64)


def _volumes_m3(group: RowGroup) -> NDArray[np.float64]:
    vertices, faces = group.ragged(VERTICES), group.ragged(FACES)
    rows = range(len(vertices))
    return np.array([_volume_m3(vertices[row], faces[row], _row_of(group, row)) for row in rows], np.float64)


def _bounds_m(group: RowGroup) -> NDArray[np.float64]:
    vertices = group.ragged(VERTICES)
    rows = range(len(vertices))
    return np.array([mesh_bounds_m(vertices[row], _row_of(group, row)) for row in rows]).reshape(-1, 2, 3)


def _row_of(group: RowGroup, row: int) -> str:
    return f"mesh {group.flat('id')[row]} (row {group.first_row + row} of {group.path!r})"


def _volume_m3(vertices_m: NDArray[Any], faces: NDArray[Any], where: str) -> float:
    # Data may be anybody's: numpy would raise an error of its own, or for -1 take the last vertex.
    if len(faces) and not (faces.min() >= 0 and faces.max() < len(vertices_m)):
        missing = faces[(faces < 0) | (faces >= len(vertices_m))]
        message = (
            f"{where} has triangles that name vertex {missing[0]}, but only "
            f"{len(vertices_m):,} vertices; next: run `validate` on the data set and generate it again"
        )
        raise InputError(message)
    return float(Mesh(vertices_m, faces).volume_m3)
