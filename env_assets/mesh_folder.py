"""Meshes that a user has as files: a folder of them stands for a data set."""

from __future__ import annotations

from dataclasses import dataclass, field
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from env_assets.mesh_view import MeshView
from tactile_toolkit.cache import MemoryCache
from tactile_toolkit.errors import InputError
from tactile_toolkit.gallery.items import natural_order
from tactile_toolkit.mesh.files import FORMATS, read_mesh
from tactile_toolkit.mesh.mesh import Mesh
from tactile_toolkit.store.files import expanded, is_there

_SPLITS = ("train", "test")
_KEPT = 64
"""As many as an ``AssetProvider`` keeps by default."""


@dataclass(frozen=True)
class MeshFile:
    """One mesh of a folder, read when it is first asked for; those used last stay in memory.

    Millimetres in the file (GLB: metres), metres here.
    """

    id: int
    label: int
    path: Path
    memory: MemoryCache[Path, tuple[Mesh, Any]] = field(repr=False, compare=False)

    @property
    def vertices_m(self) -> NDArray[np.float32]:
        """Vertices, shape (V, 3), float32, metres."""
        return np.asarray(self._read()[0].vertices_m, np.float32)

    @property
    def faces(self) -> NDArray[np.int32]:
        """Triangles, shape (F, 3), int32, counter-clockwise seen from outside."""
        return self._read()[0].faces

    @property
    def mesh(self) -> Any:
        """The mesh, a ``trimesh.Trimesh``, metres."""
        return self._read()[1]

    @property
    def volume_m3(self) -> float:
        """Volume, cubic metres."""
        return self._read()[0].volume_m3

    def _read(self) -> tuple[Mesh, Any]:
        def read() -> tuple[Mesh, Any]:
            import trimesh

            found = read_mesh(self.path)
            vertices_m = np.asarray(found.vertices_m, np.float32)
            # Not processed: trimesh would merge and drop vertices, of which volume and bounds were measured.
            return Mesh(vertices_m, found.faces), trimesh.Trimesh(vertices_m, found.faces, process=False)

        return self.memory.get_or_make(self.path, read)


def mesh_files(place: str | PathLike[str], split: str) -> MeshView | None:
    """Take a mesh file, or a folder of them, for the meshes of a split; None where it holds none.

    Sub-folders called ``train`` and ``test`` are splits; a folder without them is the same for both. Other
    sub-folders are classes; files that lie in none are a class each, named as they are. Ids count files in
    the order of their names. InputError: the folder holds another split alone, a class is there twice, or
    files lie next to classes.
    """
    root = expanded(fspath(place))
    if not is_there(root):
        return None
    if root.is_file() and root.suffix.lower() in FORMATS:
        return _as_meshes([root], [root.stem])
    if (root / split).is_dir():
        root = root / split
    elif others := [name for name in _SPLITS if mesh_files(root / name, split)]:
        raise InputError(
            f"{str(root)!r} has no split {split!r}, only {' and '.join(map(repr, others))}",
            next=f"put meshes into a sub-folder {split!r}, or give a folder without splits, such as "
            f"{str(root / others[0])!r}",
        )
    if not root.is_dir():
        return None
    loose = _meshes_in(root)
    folders = natural_order(each.name for each in root.iterdir() if each.is_dir())
    classes = {name: _meshes_in(root / name) for name in folders if not name.startswith(".")}
    classes = {name: files for name, files in classes.items() if files}
    if loose and classes:
        raise InputError(
            f"{str(root)!r} holds mesh files ({loose[0].name}) next to folders of them "
            f"({next(iter(classes))})",
            next="put each file into the folder of its class, or give a folder of files alone",
        )
    # Without folders, two files of one name, such as nut.stl and nut.ply, would be one class by accident.
    if not classes:
        return _as_meshes(loose, [file.stem for file in loose]) if loose else None
    files = [file for held in classes.values() for file in held]
    return _as_meshes(files, [file.parent.name for file in files], distinct=False)


def _meshes_in(folder: Path) -> list[Path]:
    # Hidden files may be half-written. In natural order (2 before 10) and not in that of the file system,
    # so that ids are the same on every machine.
    found = (file for file in folder.iterdir() if file.suffix.lower() in FORMATS and file.is_file())
    return [folder / name for name in natural_order(file.name for file in found if file.name[0] != ".")]


def _as_meshes(files: list[Path], classes: list[str], *, distinct: bool = True) -> MeshView:
    names = list(dict.fromkeys(classes))
    if distinct and len(names) < len(files):
        twice = next(name for name in names if classes.count(name) > 1)
        both = ", ".join(file.name for file, name in zip(files, classes, strict=True) if name == twice)
        raise InputError(
            f"{str(files[0].parent)!r} holds {both}: one class twice",
            next=f"keep one of them, or put both into a folder {twice!r}",
        )
    memory = MemoryCache[Path, tuple[Mesh, Any]](_KEPT)
    numbers = {name: number for number, name in enumerate(names)}
    records = [
        MeshFile(index, numbers[name], file, memory)
        for index, (file, name) in enumerate(zip(files, classes, strict=True))
    ]
    return MeshView(records, tuple(names))
