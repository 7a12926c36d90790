"""Mesh files and folders of them as data sets."""

from __future__ import annotations

import logging
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from env_assets.mesh_view import LazyMesh, MeshView
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh, find_mesh_files, read_mesh, require_unit

if TYPE_CHECKING:
    import trimesh

_LOG = logging.getLogger(__name__)


def mesh_files(place: str | PathLike[str], split: str, unit: str | None = None) -> MeshView | None:
    """Open a mesh file, or a folder of them, as the meshes of a split; None if there is no such file.

    Files, splits and classes are those of :func:`tactile_toolkit.mesh.find_mesh_files`; a folder without
    splits is the same for all. Ids count files in the order of their names. ``unit`` is as
    :func:`tactile_toolkit.mesh.read_mesh` takes it. InputError: the folder holds only another split.
    """
    require_unit(unit)
    found = find_mesh_files(place)
    if found is None:
        return None
    files = found.splits.get(split, found.splits.get(""))
    if files is None:
        others = list(found.splits)
        raise InputError(
            f"{str(found.root)!r} has no split {split!r}, only {' and '.join(map(repr, others))}",
            next=f"put meshes into a sub-folder {split!r}, or give a folder without splits, such as "
            f"'{found.root}/{others[0]}'",
        )
    read = partial(_mesh_of_file, unit=unit, below=found.root)
    records = [
        LazyMesh(number, found.class_names.index(found.classes[file]), partial(read, file), file.name)
        for number, file in enumerate(files)
    ]
    return MeshView(records, found.class_names)


def _mesh_of_file(path: Path, unit: str | None, below: Path | None = None) -> trimesh.Trimesh:
    found = read_mesh(path, unit=unit, below=below)
    for note in found.notes:
        _LOG.warning("%s: %s", path, note)
    return Mesh(np.asarray(found.vertices_m, np.float32), found.faces).to_trimesh()
