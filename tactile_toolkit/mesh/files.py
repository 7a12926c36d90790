"""Meshes in files: STL, 3MF, PLY, OBJ and GLB, checked on reading."""

from __future__ import annotations

import json
import logging
import os
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from os import PathLike, fspath
from pathlib import Path
from typing import IO, ClassVar
from xml.parsers import expat

import numpy as np

from tactile_toolkit import store, wording
from tactile_toolkit.columns import units
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.mesh import gltf, mesh_options, plain_formats, threemf
from tactile_toolkit.mesh.mesh import (
    MM_PER_M,
    Mesh,
    MeshLike,
    Surface,
    join_surfaces,
    merge_equal_vertices,
    welded,
)
from tactile_toolkit.store.files import named_failures, readable, write_file

# Readers of formats that state no unit.
_PLAIN: dict[str, Callable[[bytes], Surface]] = {
    ".stl": plain_formats.read_stl,
    ".ply": plain_formats.read_ply,
    ".obj": plain_formats.read_obj,
}
_MAX_BYTES = 2 << 30  # an STL of 43 million triangles
_USUAL_UNIT = "mm"  # slicers assume it, too

# First bytes of files of some formats, and the ending that they should have.
_MARKS = {b"PK\3\4": ("a zip archive", ".3mf"), b"glTF": ("binary glTF", ".glb"), b"\x1f\x8b": ("gzip", "")}

# Parser errors whose messages state where a file is damaged.
_TELLING = (zipfile.BadZipFile, expat.ExpatError, json.JSONDecodeError)
_LOG = logging.getLogger(__name__)
_SPLITS = ("train", "test")

# Formats of meshes that are not read.
_OTHER_FORMATS = (
    *(".gltf", ".dae", ".fbx", ".off", ".amf", ".wrl", ".x3d", ".3ds", ".blend"),
    *(".step", ".stp", ".iges", ".igs", ".usd", ".usda", ".usdc", ".usdz"),
)


@dataclass(frozen=True, slots=True)
class MeshFile:
    """A mesh file.

    Attributes
    ----------
    path : Path
        The file, with one of the endings in :attr:`FORMATS`.
    unit : str or None
        Unit in which STL, PLY and OBJ files are read; millimetres by default.
    root : Path or None
        Folder that links must not leave.
    label : int
        Number of its class among those of the folder.
    """

    FORMATS: ClassVar = (".stl", ".3mf", ".ply", ".obj", ".glb")
    """All are in millimetres, except GLB, which is in metres, and 3MF, which states its unit."""

    path: Path
    unit: str | None = None
    root: Path | None = None
    label: int = 0

    @classmethod
    def find(cls, path: str | PathLike[str], unit: str | None = None) -> MeshFiles | None:
        """List a mesh file, or a folder of them; None for a data set, or if there are none.

        Sub-folders called ``train`` and ``test`` are splits. Other sub-folders are classes; a file outside
        them is a class of its own, called by its name. ``unit`` is as :func:`read_mesh` takes it. InputError
        if there is no such unit, or if there are files next to classes, or files or classes next to splits.
        """
        mesh_options.require_unit(unit)
        root = store.expanded(fspath(path))
        with readable(str(root)):
            if not store.path_exists(root):
                return None
            if root.is_dir():
                return _in_folder(root, unit)
        if root.suffix.lower() not in cls.FORMATS:
            return None
        return MeshFiles({"": (cls(root, unit),)}, (root.stem,))

    @property
    def ending(self) -> str:
        """Ending of the name, in lower case; InputError for an unknown one."""
        ending = self.path.suffix.lower()
        if ending in self.FORMATS:
            return ending
        problem = f"files ending in {ending!r} are not known" if ending else "files have an ending"
        if self.path.is_dir():
            problem = "it is a folder"
        elif not self.path.exists():
            problem = "there is no such file"
        raise InputError(
            f"{self.path}: {problem}; expected a file ending in {', '.join(self.FORMATS)}",
            next="give the path of a mesh file",
        )

    @property
    def name(self) -> str:
        """Path of the file inside its folder, with slashes."""
        if self.root is None:
            return self.path.name
        return self.path.relative_to(self.root).as_posix()

    @property
    def assumed_unit(self) -> str | None:
        """Unit by which the file is read; None for formats that state theirs."""
        if self.ending in _PLAIN:
            return self.unit or _USUAL_UNIT
        return None

    def content(self) -> bytes:
        """Return the bytes of the file; InputError, without its name, if it cannot be read."""
        try:
            if self.root is not None:
                with store.open_folder(str(self.root)).open_inside(self.name) as stream:
                    return _bounded(stream)
            with store.open_regular(self.path) as stream:
                return _bounded(stream)
        except OSError as error:
            raise InputError(f"cannot be read ({error.strerror}); expected a mesh file") from error
        except IntegrityError as error:
            raise InputError("not a regular file; nothing was read from it") from error

    def parse(self, content: bytes) -> Mesh:
        """Read the mesh from the bytes; raises as :func:`read_mesh`, without the name of the file."""
        mesh_options.require_unit(self.unit)
        mesh, stated = _unpacked(content, self.ending, self.unit)
        size_mm = float(np.ptp(mesh.bounds_m, axis=0).max()) * MM_PER_M
        mesh_options.require_likely_size(size_mm, self.unit, stated)
        if self.unit is None and stated is None:
            notes = mesh_options.size_notes(size_mm, mesh.volume_m3 * MM_PER_M**3)
            mesh = replace(mesh, notes=(*mesh.notes, *notes))
        return mesh

    def read(self) -> Mesh:
        """Read the mesh as :func:`read_mesh` does."""
        _ = self.ending  # refuses unknown formats before the file is read
        try:
            return self.parse(self.content())
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from error


def read_mesh(path: str | Path, *, unit: str | None = None) -> Mesh:
    """Read a mesh from a file.

    Parameters
    ----------
    path : str or Path
        A file with one of the endings in :attr:`MeshFile.FORMATS`.
    unit : "mm", "cm", "m" or "in", optional
        Unit of STL, PLY and OBJ files, which state none; millimetres by default.

    Returns
    -------
    Mesh
        Metres, float64, z up. Vertices with equal coordinates are merged, except in 3MF, where faces must
        share corners by number; vertices closer than 1e-5 of the size of the object are welded where that
        closes the surface. Its ``notes`` say what was welded or left out.

    Raises
    ------
    InputError
        The file is missing, empty, truncated or not a mesh of its format, or needs an unsupported feature;
        or the object is smaller than 1 mm or larger than 1 m, and no unit was given.
    """
    return MeshFile(store.expanded(path), unit).read()


def _bounded(stream: IO[bytes]) -> bytes:
    size = stream.seek(0, os.SEEK_END)
    if size > _MAX_BYTES:
        raise InputError(
            f"the file has {wording.bytes_text(size)}; expected at most {wording.bytes_text(_MAX_BYTES)}",
            next="reduce the number of its triangles",
        )
    stream.seek(0)
    return stream.read()


def unpack_mesh(data: bytes, ending: str) -> Mesh:
    """Read a mesh of any size from the content of a file, in the unit of :attr:`MeshFile.FORMATS`."""
    return _unpacked(data, ending, None)[0]


def _unpacked(data: bytes, ending: str, unit: str | None) -> tuple[Mesh, str | None]:
    """Return the mesh of a file, and the unit that the file states."""
    if not data:
        raise InputError("the file is empty; expected a mesh", next="export or copy it again")
    for mark, (content, right_ending) in _MARKS.items():
        if data.startswith(mark) and ending != right_ending:
            raise InputError(
                f"its content is {content}; expected {ending[1:].upper()}",
                next="unpack it, or give it the ending of its format",
            )
    stated: str | None = None
    try:
        if ending == ".3mf":
            items, notes, stated = threemf.read_build(data)
            mesh = Mesh(*join_surfaces([(item.mesh.vertices_m, item.mesh.faces) for item in items]), notes)
        elif ending == ".glb":
            stated = "m"
            mesh = welded(*merge_equal_vertices(*gltf.read_glb(data)))
        else:
            vertices, faces = merge_equal_vertices(*_PLAIN[ending](data))
            mesh = welded(vertices / (MM_PER_M / units.MM_PER_UNIT[unit or _USUAL_UNIT]), faces)
    except (InputError, MemoryError):  # more than the limit
        raise
    except Exception as error:
        # Parsers raise errors of many types for damaged files.
        story = f" ({error})" * isinstance(error, _TELLING)
        raise InputError(
            f"not a readable {ending[1:].upper()} file{story}", next="export the mesh again"
        ) from error
    if not len(mesh.faces):
        raise InputError("the file holds no triangle; expected a closed surface")
    return mesh, stated


def write_mesh(path: str | Path, mesh: MeshLike) -> None:
    """Write a mesh to a file; no partial file is left behind.

    Parameters
    ----------
    path : str or Path
        A file with one of the endings in :attr:`MeshFile.FORMATS`.
    mesh : Mesh, record of a data set, or trimesh.Trimesh
        In metres.

    Raises
    ------
    InputError
        The ending is unknown, or the mesh is not one.
    StorageError
        The file cannot be written.
    """
    path = Path(path)
    data = pack_mesh(Mesh.of(mesh), MeshFile(path).ending)
    with named_failures(str(path)):
        path.parent.stat()  # a mistyped folder is refused, not created
        write_file(path, lambda stream: stream.write(data))


def pack_mesh(mesh: Mesh, ending: str, name: str = "") -> bytes:
    """Return the content of a mesh file; equal meshes give equal bytes.

    ``name`` is the name that slicers show, in formats that store names (3MF).
    """
    if ending == ".3mf":
        return threemf.write_build([threemf.BuildItem(name, mesh)])
    # GLB is in metres by its specification; the others state no unit, and slicers assume millimetres.
    if ending == ".glb":
        return gltf.pack_glb(np.ascontiguousarray(mesh.vertices_m, "<f4"), mesh.faces)
    if ending == ".stl":
        return plain_formats.pack_stl(mesh.vertices_mm[mesh.faces])
    import trimesh  # takes a second to import

    packed = trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False).export(file_type=ending[1:])
    return packed.encode() if isinstance(packed, str) else bytes(packed)


@dataclass(frozen=True, slots=True)
class MeshFiles:
    """Mesh files, numbered in the natural order of their names (2 before 10).

    Attributes
    ----------
    splits : dict of str to tuple of MeshFile
        Files of each split; of the split ``""`` if the place has none.
    class_names : tuple of str
        All classes, in order; those of several splits are numbered together.
    """

    splits: dict[str, tuple[MeshFile, ...]]
    class_names: tuple[str, ...]


def _in_folder(root: Path, unit: str | None) -> MeshFiles | None:
    has_rows = any(next(root.glob(pattern), None) for pattern in ("*.parquet", "*/*.parquet"))
    if has_rows or store.Manifest.so_far(store.open_folder(str(root))) is not None:
        return None  # a data set
    here = _classes_of(root, besides=_SPLITS)
    splits = {name: _classes_of(root / name) for name in _SPLITS if (root / name).is_dir()}
    splits = {name: names_by_file for name, names_by_file in splits.items() if names_by_file}
    if splits and here:
        raise InputError(
            f"{str(root)!r} holds {next(iter(here)).relative_to(root).as_posix()} next to the splits "
            f"{' and '.join(splits)}",
            next="put it into the folder of a split",
        )
    splits = splits or {"": here}
    names = list(dict.fromkeys(name for names_by_file in splits.values() for name in names_by_file.values()))
    if not names:
        return None
    if len(splits) > 1:
        names.sort(key=wording.natural_key)
    files = {
        split: tuple(MeshFile(path, unit, root, names.index(name)) for path, name in names_by_file.items())
        for split, names_by_file in splits.items()
    }
    return MeshFiles(files, tuple(names))


def _classes_of(root: Path, besides: tuple[str, ...] = ()) -> dict[Path, str]:
    """Return the class of each mesh file of a folder, in order."""
    loose = _files_in(root)
    folders = (entry.name for entry in root.iterdir() if entry.is_dir() and not store.is_hidden(entry.name))
    names = sorted((name for name in folders if name not in besides), key=wording.natural_key)
    in_folders = {file: name for name in names for file in _files_in(root / name)}
    if loose and in_folders:
        raise InputError(
            f"{str(root)!r} holds mesh files ({loose[0].name}) next to folders of them "
            f"({next(iter(in_folders.values()))})",
            next="put each file into the folder of its class, or give a folder with only files",
        )
    return in_folders or {file: file.stem for file in loose}


def _files_in(folder: Path) -> list[Path]:
    """Return the mesh files of a folder; a warning names meshes of formats that are not read."""
    meshes = list(_sorted_by_name(folder, MeshFile.FORMATS))
    # A drawing may lie next to the mesh that was made from it.
    known = {file.stem for file in meshes}
    others = [file for file in _sorted_by_name(folder, _OTHER_FORMATS) if file.stem not in known]
    if meshes:
        for file in others:
            _LOG.warning("%s: left out; expected one of %s", file, ", ".join(MeshFile.FORMATS))
    return meshes


def _sorted_by_name(folder: Path, endings: tuple[str, ...]) -> Iterator[Path]:
    # Hidden files may be incomplete. In natural order, so that numbers are the same on every machine.
    for file in sorted(folder.iterdir(), key=lambda path: wording.natural_key(path.name)):
        if file.suffix.lower() in endings and not (store.is_hidden(file.name) or file.is_dir()):
            yield file
