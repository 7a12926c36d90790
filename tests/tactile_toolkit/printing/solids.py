"""Solids to print, made by manifold3d."""

from __future__ import annotations

from typing import Any

import manifold3d
import numpy as np

from tactile_toolkit.mesh import Mesh
from tactile_toolkit.printing.file_export import PrintObject


def mesh_of(manifold: Any) -> Mesh:
    arrays = manifold.to_mesh64()
    return Mesh(
        np.array(arrays.vert_properties[:, :3], np.float64) / 1e3, np.array(arrays.tri_verts, np.int32)
    )


def prism(corners_mm: list[tuple[float, float]], height_mm: float = 5.0) -> Mesh:
    return mesh_of(manifold3d.CrossSection([np.array(corners_mm, float)]).extrude(height_mm))


def box(width_mm: float, depth_mm: float, height_mm: float = 5.0) -> Mesh:
    return mesh_of(manifold3d.Manifold.cube((width_mm, depth_mm, height_mm)))


def ell(side_mm: float, arm_mm: float) -> Mesh:
    s, a = side_mm, arm_mm
    return prism([(0, 0), (s, 0), (s, a), (a, a), (a, s), (0, s)])


def ring(outer_mm: float, inner_mm: float) -> Mesh:
    outer, inner = (manifold3d.CrossSection.circle(radius, 48) for radius in (outer_mm, inner_mm))
    return mesh_of((outer - inner).extrude(5.0))


def open_box(width_mm: float, depth_mm: float) -> Mesh:
    whole = box(width_mm, depth_mm)
    return Mesh(whole.vertices_m, whole.faces[1:])


def named(meshes: list[Mesh], split: str = "test") -> list[PrintObject]:
    return [
        PrintObject(f"{split}-{number % 3}-{number:05d}", split, str(number % 3), number, mesh_getter(mesh))
        for number, mesh in enumerate(meshes)
    ]


class mesh_getter:  # noqa: N801  (picklable, unlike a lambda)
    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh

    def __call__(self) -> Mesh:
        return self.mesh
