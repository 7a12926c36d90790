"""Mesh files and folders of them as data sets."""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import partial
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np

from env_assets.mesh_view import LazyMesh, MeshView
from tactile_toolkit import store
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import FORMATS, Mesh, read_mesh, require_unit
from tactile_toolkit.parsed_text import natural_key

_LOG = logging.getLogger(__name__)
_SPLITS = ("train", "test")
# Formats of meshes that are not read.
_OTHER_FORMATS = (
    *(".gltf", ".dae", ".fbx", ".off", ".amf", ".wrl", ".x3d", ".3ds", ".blend"),
    *(".step", ".stp", ".iges", ".igs", ".usd", ".usda", ".usdc", ".usdz"),
)


def mesh_files(place: str | PathLike[str], split: str, unit: str | None = None) -> MeshView | None:
    """Open a mesh file, or a folder of them, as the meshes of a split; None if there are none.

    Sub-folders called ``train`` and ``test`` are splits; a folder without them is the same for both. Other
    sub-folders are classes; files outside of them are a class each, called by their names. Ids count files in
    the order of their names. ``unit`` is as :func:`tactile_toolkit.mesh.read_mesh` takes it.
    InputError: the folder holds only another split, or files lie next to classes.
    """
    require_unit(unit)
    root = store.expanded(fspath(place))
    if not store.path_exists(root):
        return None
    if not root.is_dir():
        read = partial(_mesh_of_file, unit=unit)
        if root.suffix.lower() not in FORMATS:
            return None
        return _view_of_files([root], [root.stem], read)
    read = partial(_mesh_of_file, unit=unit, below=root)
    if (root / split).is_dir():
        root = root / split
    elif others := [name for name in _SPLITS if mesh_files(root / name, split)]:
        raise InputError(
            f"{str(root)!r} has no split {split!r}, only {' and '.join(map(repr, others))}",
            next=f"put meshes into a sub-folder {split!r}, or give a folder without splits, such as "
            f"{str(root / others[0])!r}",
        )
    loose = _files_in(root)
    folders = (each.name for each in root.iterdir() if each.is_dir() and not store.is_hidden(each.name))
    sorted_files = [file for name in sorted(folders, key=natural_key) for file in _files_in(root / name)]
    if loose and sorted_files:
        raise InputError(
            f"{str(root)!r} holds mesh files ({loose[0].name}) next to folders of them "
            f"({sorted_files[0].parent.name})",
            next="put each file into the folder of its class, or give a folder of files alone",
        )
    classes = [file.parent.name for file in sorted_files] or [file.stem for file in loose]
    if not classes:
        return None
    return _view_of_files(sorted_files or loose, classes, read)


def _files_in(folder: Path) -> list[Path]:
    """Return the mesh files of a folder; a warning names meshes of formats that are not read."""
    # Hidden files may be incomplete. In natural order (2 before 10), so that ids are the same on every
    # machine.
    visible = (file for file in folder.iterdir() if not (file.is_dir() or store.is_hidden(file.name)))
    files = sorted(visible, key=lambda file: natural_key(file.name))
    found = [file for file in files if file.suffix.lower() in FORMATS]
    # A drawing may lie next to the mesh that was made from it.
    known = {file.stem for file in found}
    others = [each for each in files if each.suffix.lower() in _OTHER_FORMATS and each.stem not in known]
    for file in others if found else ():
        _LOG.warning("%s: left out; expected one of %s", file, ", ".join(FORMATS))
    return found


def _view_of_files(files: list[Path], classes: list[str], read: Callable[[Path], Any]) -> MeshView:
    numbers = {name: number for number, name in enumerate(dict.fromkeys(classes))}
    records = [
        LazyMesh(index, numbers[name], partial(read, file), file.name)
        for index, (file, name) in enumerate(zip(files, classes, strict=True))
    ]
    return MeshView(records, tuple(numbers))


def _mesh_of_file(path: Path, unit: str | None, below: Path | None = None) -> Any:
    found = read_mesh(path, unit=unit, below=below)
    for note in found.notes:
        _LOG.warning("%s: %s", path, note)
    return Mesh(np.asarray(found.vertices_m, np.float32), found.faces).to_trimesh()
