"""Solids in mesh files that tests make."""

from __future__ import annotations

from pathlib import Path

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


def cube(side: float = 20.0) -> Mesh:
    return Mesh.from_trimesh(trimesh.creation.box((side / 1000,) * 3))
