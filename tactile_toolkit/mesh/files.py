"""Meshes in files: STL, 3MF, PLY, OBJ and GLB, checked on reading."""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import IO
from xml.parsers import expat

import numpy as np

from tactile_toolkit import quantities, store, units
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.mesh import file_units, gltf, obj, ply, stl, threemf, threemf_writing, welding
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh, MeshLike, Surface, as_mesh, join_surfaces

FORMATS = (".stl", ".3mf", ".ply", ".obj", ".glb")
"""All are in millimetres, except GLB, which is in metres, and 3MF, which states its unit."""

# Readers of formats that state no unit.
_PLAIN: dict[str, Callable[[bytes], Surface]] = {
    ".stl": stl.read_stl,
    ".ply": ply.read_ply,
    ".obj": obj.read_obj,
}

_MAX_BYTES = 2 << 30  # an STL of 43 million triangles
_USUAL_UNIT = "mm"  # slicers assume it, too

# First bytes of files of some formats, and the ending that they should have.
_MARKS = {b"PK\3\4": ("a zip archive", ".3mf"), b"glTF": ("binary glTF", ".glb"), b"\x1f\x8b": ("gzip", "")}

# Parser errors whose messages state where a file is damaged.
_TELLING = (zipfile.BadZipFile, expat.ExpatError, json.JSONDecodeError)


def read_mesh(path: str | Path, *, unit: str | None = None, below: Path | None = None) -> Mesh:
    """Read a mesh from a file.

    Parameters
    ----------
    path : str or Path
        A file with one of the endings in :data:`FORMATS`.
    unit : "mm", "cm", "m" or "in", optional
        Unit of STL, PLY and OBJ files, which state none; millimetres by default.
    below : Path, optional
        Folder that links must not leave.

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
    path = store.expanded(path)
    ending = file_ending(path)
    try:
        return parse_mesh(file_content(path, below), ending, unit)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def parse_mesh(data: bytes, ending: str, unit: str | None) -> Mesh:
    """Read a mesh from the content of a file; raises as :func:`read_mesh`, without the name of the file."""
    file_units.require_unit(unit)
    mesh, stated = _unpacked(data, ending, unit)
    file_units.require_likely_size(float(np.ptp(mesh.bounds_m, axis=0).max()) * MM_PER_M, unit, stated)
    return mesh


def unit_of_file(path: Path, unit: str | None) -> str | None:
    """Return the unit by which a file is read; None for formats that state theirs."""
    if file_ending(path) in _PLAIN:
        return unit or _USUAL_UNIT
    return None


def file_content(path: Path, below: Path | None = None) -> bytes:
    """Return the content of a mesh file; InputError, without its name, if it cannot be read."""
    try:
        if below is not None:
            name = path.relative_to(below).as_posix()
            with store.open_folder(str(below)).open_inside(name) as stream:
                return _bounded(stream)
        with store.open_regular(path) as stream:
            return _bounded(stream)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror}); expected a mesh file") from error
    except IntegrityError as error:
        raise InputError("not a regular file; nothing was read from it") from error


def _bounded(stream: IO[bytes]) -> bytes:
    size = stream.seek(0, os.SEEK_END)
    if size > _MAX_BYTES:
        raise InputError(
            f"the file has {quantities.bytes_text(size)}; expected at most "
            f"{quantities.bytes_text(_MAX_BYTES)}",
            next="reduce the number of its triangles",
        )
    stream.seek(0)
    return stream.read()


def unpack_mesh(data: bytes, ending: str) -> Mesh:
    """Read a mesh of any size from the content of a file, in the unit that :data:`FORMATS` states."""
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
            stated, mesh = "m", welding.welded(*welding.merge_equal_vertices(*gltf.read_glb(data)))
        else:
            vertices, faces = welding.merge_equal_vertices(*_PLAIN[ending](data))
            mesh = welding.welded(vertices / (MM_PER_M / units.MM_PER_UNIT[unit or _USUAL_UNIT]), faces)
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
        A file with one of the endings in :data:`FORMATS`.
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
    data = pack_mesh(as_mesh(mesh), file_ending(path))
    with store.named_failures(str(path)):
        path.parent.stat()  # a mistyped folder is refused, not created
        store.write_file(path, lambda stream: stream.write(data))


def pack_mesh(mesh: Mesh, ending: str, name: str = "") -> bytes:
    """Return the content of a mesh file; equal meshes give equal bytes.

    ``name`` is the name that slicers show, in formats that store names (3MF).
    """
    if ending == ".3mf":
        return threemf_writing.write_build([threemf_writing.BuildItem(name, mesh)])
    # GLB is in metres by its specification; the others state no unit, and slicers assume millimetres.
    if ending == ".glb":
        return gltf.pack_glb(np.ascontiguousarray(mesh.vertices_m, "<f4"), mesh.faces)
    import trimesh  # takes a second to import

    packed = trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False).export(file_type=ending[1:])
    return packed.encode() if isinstance(packed, str) else bytes(packed)


def file_ending(path: Path) -> str:
    """Return the ending of a mesh file; InputError for an unknown one."""
    ending = path.suffix.lower()
    if ending not in FORMATS:
        found = f"files ending in {ending!r}" if ending else "files without an ending"
        raise InputError(f"{path}: {found} are not known; expected one of {', '.join(FORMATS)}")
    return ending
