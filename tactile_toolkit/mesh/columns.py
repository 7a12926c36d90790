"""Mesh columns: how a data set of meshes is laid out, the published way.

The published data sets store a mesh as two flat columns whose names begin with ``mesh.``: readers hand every
such column to the mesh class, so that no other column may begin so (package tactile-mnist 0.13.0).
"""

from __future__ import annotations

from typing import Any

from tactile_toolkit.errors import InputError
from tactile_toolkit.read.columns import column_names
from tactile_toolkit.read.features import stored_class_names

VERTICES = "mesh.vertices"
"""Column of corner positions: ``list<float32[3]>``, metres."""

FACES = "mesh.faces"
"""Column of triangles: ``list<int32[3]>``, rows of the vertices."""


def class_names(schema: Any, default: tuple[str, ...], where: str = "") -> tuple[str, ...]:
    """Read the names of the classes from a schema; ``default`` where it names none.

    Raises IntegrityError, naming the data set, ``where``, for what does not describe features.
    """
    found = stored_class_names(schema, where)
    return default if found is None else found


def require_mesh_columns(schema: Any, name: str, made_by: str) -> None:
    """Refuse the data set ``name`` where it lacks a column of the published mesh layout.

    ``made_by`` is the command that writes such data sets, for the message of the InputError.
    """
    found = column_names(schema)
    missing = [column for column in ("id", "label", VERTICES, FACES) if column not in found]
    if missing:
        raise InputError(
            f"{name!r} is not a data set of meshes: column {missing[0]!r} is missing (found "
            f"{', '.join(found)})",
            next=f"name a data set such as one written by `{made_by}`",
        )
