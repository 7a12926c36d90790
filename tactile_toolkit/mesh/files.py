"""Meshes in files: STL, 3MF, PLY, OBJ and GLB, checked as they come back from disk."""

from __future__ import annotations

import contextlib
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np

from tactile_toolkit.errors import InputError, StorageError
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh, as_mesh
from tactile_toolkit.mesh.threemf import read_threemf, write_threemf
from tactile_toolkit.store.folder import temporary_name

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tactile_toolkit.mesh.mesh import MeshLike

__all__ = [
    "BROKEN_FILE",
    "FORMATS",
    "merge_equal_vertices",
    "pack_mesh",
    "read_mesh",
    "read_stl",
    "write_mesh",
    "write_stl",
]

_HEADER_BYTES = 84
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_stl(data: bytes) -> NDArray[np.float64]:
    """Read a binary or ASCII file.

    Parameters
    ----------
    data : bytes
        The file.

    Returns
    -------
    ndarray of float64, shape (F, 3, 3)
        Corners of each triangle in the unit of the file.

    Raises
    ------
    ValueError
        The file is cut short or is no STL.
    """
    if len(data) >= _HEADER_BYTES:
        count = int.from_bytes(data[80:_HEADER_BYTES], "little")
        if len(data) == _HEADER_BYTES + count * _TRIANGLE.itemsize:
            triangles = np.frombuffer(data, _TRIANGLE, count, _HEADER_BYTES)
            return np.asarray(triangles["corners"], dtype=np.float64)
    if data.lstrip()[:5].lower() == b"solid" and b"facet" in data[:4096]:
        return _read_ascii(data)
    if len(data) < _HEADER_BYTES:
        message = f"{len(data)} bytes; an STL file has at least {_HEADER_BYTES}"
        raise ValueError(message)
    expected = _HEADER_BYTES + count * _TRIANGLE.itemsize
    message = f"{len(data)} bytes; a binary STL file of {count} triangles has {expected}"
    raise ValueError(message)


def write_stl(corners_mm: NDArray[np.float64]) -> bytes:
    """Pack triangles into a binary file.

    Parameters
    ----------
    corners_mm : ndarray of float64, shape (F, 3, 3)
        Corners of each triangle, counter-clockwise seen from outside.

    Returns
    -------
    bytes
    """
    normals = np.cross(corners_mm[:, 1] - corners_mm[:, 0], corners_mm[:, 2] - corners_mm[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    triangles = np.zeros(len(corners_mm), _TRIANGLE)
    triangles["normal"] = normals / np.where(lengths > 0, lengths, 1)
    triangles["corners"] = corners_mm
    return b"millimetres".ljust(80) + len(corners_mm).to_bytes(4, "little") + triangles.tobytes()


def _read_ascii(data: bytes) -> NDArray[np.float64]:
    words = data.split()
    if not words[-1:] or b"endsolid" not in words[-64:]:
        message = "the text ends without 'endsolid'"
        raise ValueError(message)
    numbers = [words[i + 1 : i + 4] for i, word in enumerate(words) if word == b"vertex"]
    corners = np.array(numbers, dtype=np.float64).reshape(-1, 3)
    if len(corners) % 3:
        message = f"{len(corners)} corners do not make whole triangles"
        raise ValueError(message)
    return corners.reshape(-1, 3, 3)


FORMATS = (".stl", ".3mf", ".ply", ".obj", ".glb")
"""Millimetres in all of them (3MF: the unit that the file names), except GLB, which is metres."""

BROKEN_FILE = (
    *(ValueError, KeyError, IndexError, TypeError, EOFError),
    *(zipfile.BadZipFile, ElementTree.ParseError),
)
"""What parsing a damaged file raises."""


def read_mesh(path: str | Path) -> Mesh:
    """Read a mesh from a file.

    Parameters
    ----------
    path : str or Path
        A file with one of the endings in :data:`FORMATS`.

    Returns
    -------
    Mesh
        Metres, float64. Vertices at the very same place are merged, except in 3MF, whose faces have to name
        shared corners themselves.

    Raises
    ------
    InputError
        The file is missing, empty, cut short or no mesh of its kind.
    """
    path = Path(path)
    ending = _ending(path)
    data = _bytes_of(path)
    try:
        vertices, faces = _parse(data, ending)
    except BROKEN_FILE as error:
        message = (
            f"{path}: no readable {ending[1:].upper()} file ({_story(error)}); next: export the mesh again"
        )
        raise InputError(message) from error
    if not len(faces):
        message = f"{path}: the file holds no triangle; expected a closed surface"
        raise InputError(message)
    return Mesh(vertices / (1.0 if ending == ".glb" else MM_PER_M), faces)


def write_mesh(path: str | Path, mesh: MeshLike) -> None:
    """Write a mesh to a file; a file that could not be finished is not left behind.

    Parameters
    ----------
    path : str or Path
        A file with one of the endings in :data:`FORMATS`.
    mesh : Mesh, record of a data set, or trimesh.Trimesh
        In metres.

    Raises
    ------
    InputError
        The ending is unknown, or the mesh is none.
    StorageError
        The file cannot be written.
    """
    path = Path(path)
    data = pack_mesh(as_mesh(mesh), _ending(path))
    partial = path.with_name(temporary_name(path.name))
    try:
        partial.write_bytes(data)
        partial.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):  # where a folder of the path is none, there is nothing to remove
            partial.unlink(missing_ok=True)
        message = (
            f"{path}: cannot be written ({error.strerror}); next: choose a folder with room and permission"
        )
        raise StorageError(message) from error


def pack_mesh(mesh: Mesh, ending: str, name: str = "") -> bytes:
    """Make the content of a mesh file; the same mesh always gives the same bytes.

    Parameters
    ----------
    mesh : Mesh
        In metres.
    ending : str
        One of :data:`FORMATS`.
    name : str
        What slicers call the object, where the format holds names (3MF).

    Returns
    -------
    bytes
    """
    vertices_mm = np.asarray(mesh.vertices_m, dtype=np.float64) * MM_PER_M
    if ending == ".stl":
        return write_stl(vertices_mm[mesh.faces])
    if ending == ".3mf":
        return write_threemf(vertices_mm, mesh.faces, name)
    import trimesh

    vertices = mesh.vertices_m if ending == ".glb" else vertices_mm
    packed = trimesh.Trimesh(vertices, mesh.faces, process=False).export(file_type=ending[1:])
    return packed.encode() if isinstance(packed, str) else bytes(packed)


def merge_equal_vertices(
    vertices: NDArray[np.floating[Any]], faces: NDArray[np.integer[Any]]
) -> tuple[NDArray[np.floating[Any]], NDArray[np.int32]]:
    """Make one vertex of those at exactly the same place.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)
    faces : ndarray of int, shape (F, 3)

    Returns
    -------
    vertices : ndarray, shape (U, 3)
        In the order in which they first appear.
    faces : ndarray of int32, shape (F, 3)
    """
    _, first, inverse = np.unique(vertices + 0.0, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    place = np.empty(len(first), dtype=np.int32)
    place[order] = np.arange(len(first), dtype=np.int32)
    return vertices[first[order]], place[inverse.reshape(-1)][faces]


def _ending(path: Path) -> str:
    ending = path.suffix.lower()
    if ending not in FORMATS:
        message = f"{path}: files ending in {ending!r} are not known; expected one of {', '.join(FORMATS)}"
        raise InputError(message)
    return ending


def _bytes_of(path: Path) -> bytes:
    try:
        data = path.read_bytes()
    except OSError as error:
        message = f"{path}: cannot be read ({error.strerror}); expected a mesh file"
        raise InputError(message) from error
    if not data:
        message = f"{path}: the file is empty; expected a mesh; next: export or copy it again"
        raise InputError(message)
    return data


def _parse(data: bytes, ending: str) -> tuple[NDArray[np.floating[Any]], NDArray[np.int32]]:
    if ending == ".3mf":
        return read_threemf(data)
    if ending == ".stl":
        vertices = read_stl(data).reshape(-1, 3)
        return merge_equal_vertices(vertices, np.arange(len(vertices), dtype=np.int32).reshape(-1, 3))
    return merge_equal_vertices(*_parse_with_trimesh(data, ending))


def _parse_with_trimesh(data: bytes, ending: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    import io

    import trimesh

    try:
        scene = trimesh.load_scene(io.BytesIO(data), file_type=ending[1:], process=False)
        mesh = scene.to_mesh()
    except Exception as error:
        # The loaders of trimesh meet damaged files with whatever their parsing runs into.
        raise ValueError(_story(error)) from error
    return np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)


def _story(error: BaseException) -> str:
    return str(error) or type(error).__name__
