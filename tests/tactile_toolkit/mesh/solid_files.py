"""Solids in mesh files that tests make."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh, PrintReport, read_mesh


def outcome_of(path: Path, unit: str | None = None) -> float | str:
    """Return the volume of a solid, mm³, or why there is none."""
    try:
        report = PrintReport.of(read_mesh(path, unit=unit))
    except InputError as error:
        return str(error)
    return report.volume_mm3 if report.is_solid else f"{report.problem}: {report.detail}"


def box(x_mm: float, y_mm: float, z_mm: float) -> Mesh:
    return Mesh.from_trimesh(trimesh.creation.box((x_mm / 1e3, y_mm / 1e3, z_mm / 1e3)))


def cube(side_mm: float = 20.0) -> Mesh:
    return box(side_mm, side_mm, side_mm)


def surface_of(solid: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and faces of a solid of manifold3d."""
    arrays = solid.to_mesh64()
    return np.array(arrays.vert_properties)[:, :3], np.array(arrays.tri_verts).astype(np.int64)


def turned(vertices: np.ndarray, seed: int) -> np.ndarray:
    """Return vertices rotated at random."""
    rotation, lengths = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    rotation = rotation * np.sign(np.diag(lengths))
    return np.asarray(vertices @ (rotation * np.sign(np.linalg.det(rotation))))
