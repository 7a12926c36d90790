"""Meshes in files: STL, 3MF, PLY, OBJ and GLB, checked as they come back from disk."""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any
from xml.parsers import expat

import numpy as np

from tactile_toolkit import spatial, store
from tactile_toolkit.array_types import Float64, Int32, Integers
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.mesh import file_units, gltf, threemf_writing
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh, MeshLike, Surface, as_mesh, joined
from tactile_toolkit.mesh.obj import read_obj
from tactile_toolkit.mesh.ply import read_ply
from tactile_toolkit.mesh.stl import read_stl
from tactile_toolkit.mesh.threemf import read_build
from tactile_toolkit.quantities import bytes_text
from tactile_toolkit.units import MM_PER_UNIT
from tactile_toolkit.wording import with_count

FORMATS = (".stl", ".3mf", ".ply", ".obj", ".glb")
"""All are in millimetres, except GLB, which is in metres, and 3MF, which states its unit."""

# Readers of formats that state no unit.
_PLAIN: dict[str, Callable[[bytes], Surface]] = {".stl": read_stl, ".ply": read_ply, ".obj": read_obj}

_MOST_BYTES = 2 << 30  # an STL of 43 million triangles
_USUAL_UNIT = "mm"  # slicers assume it, too

# Corners closer than this fraction of the size of the object are welded where that closes the surface.
_WELDED = 1e-5
# More corners in one place are not due to rounding; this bounds memory.
_NEIGHBOURS = 16

# How files of some formats begin, and the ending that they should have; few others begin so.
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
            with store.open_inside(
                store.open_folder(str(below)), path.relative_to(below).as_posix()
            ) as stream:
                return _bounded(stream)
        with store.open_regular(path) as stream:
            return _bounded(stream)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror}); expected a mesh file") from error
    except IntegrityError as error:
        raise InputError("not a regular file; nothing was read from it") from error


def _bounded(stream: IO[bytes]) -> bytes:
    size = stream.seek(0, os.SEEK_END)
    if size > _MOST_BYTES:
        raise InputError(
            f"the file has {bytes_text(size)}; expected at most {bytes_text(_MOST_BYTES)}",
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
            items, notes, stated = read_build(data)
            mesh = Mesh(*joined([(item.mesh.vertices_m, item.mesh.faces) for item in items]), notes)
        elif ending == ".glb":
            stated, mesh = "m", _welded(*merge_equal_vertices(*gltf.read_glb(data)))
        else:
            vertices, faces = merge_equal_vertices(*_PLAIN[ending](data))
            mesh = _welded(vertices / (MM_PER_M / MM_PER_UNIT[unit or _USUAL_UNIT]), faces)
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
    import trimesh

    packed = trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False).export(file_type=ending[1:])
    return packed.encode() if isinstance(packed, str) else bytes(packed)


def merge_equal_vertices(vertices: Float64, faces: Integers) -> Surface:
    """Merge vertices with equal coordinates, in order of first appearance."""
    # trimesh would merge within a tolerance; numpy's unique rows take three times as long.
    rows = vertices + 0.0  # -0.0 equals 0.0
    order = np.lexsort(rows.T)
    in_order = rows.take(order, axis=0)
    is_new = np.concatenate([[True], (in_order[1:] != in_order[:-1]).any(axis=1)])[: len(rows)]
    group = np.empty(len(rows), np.int64)
    group[order] = np.cumsum(is_new) - 1
    first = order[is_new]
    by_appearance = np.argsort(first)
    number = np.empty(len(first), np.int32)
    number[by_appearance] = np.arange(len(first), dtype=np.int32)
    return vertices.take(first[by_appearance], axis=0), number[group].take(faces)


def file_ending(path: Path) -> str:
    """Return the ending of a mesh file; InputError for an unknown one."""
    ending = path.suffix.lower()
    if ending not in FORMATS:
        found = f"files ending in {ending!r}" if ending else "files without an ending"
        raise InputError(f"{path}: {found} are not known; expected one of {', '.join(FORMATS)}")
    return ending


def _welded(vertices: Float64, faces: Int32) -> Mesh:
    """Weld corners that rounding has separated, where that closes the surface; metres."""
    if not len(faces) or not np.isfinite(vertices).all() or _is_closed(faces, len(vertices)):
        return Mesh(vertices, faces)
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    # Ends of edges that do not occur in both directions.
    ends = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    forth, back = (ends @ weights for weights in ((len(vertices), 1), (1, len(vertices))))
    torn = np.unique(ends[~(np.isin(forth, back) & np.isin(back, forth))])
    if len(torn) < 2:
        return Mesh(vertices, faces)
    reach_m = _WELDED * float(np.ptp(vertices, axis=0).max())
    tree, count = spatial.cKDTree(vertices[torn]), min(_NEIGHBOURS, len(torn))
    found: Any = tree.query(vertices[torn], count, distance_upper_bound=reach_m)
    row, column = np.nonzero(np.isfinite(found[0]))
    graph = coo_array((np.ones(len(row)), (row, found[1][row, column])), (len(torn), len(torn)))
    group = connected_components(graph, directed=False)[1]
    first = np.full(len(torn), len(vertices))
    np.minimum.at(first, group, torn)
    moved = np.arange(len(vertices))
    moved[torn] = first[group]
    corners = moved[faces]
    corners = corners[(corners != np.roll(corners, 1, axis=1)).all(axis=1)]
    if not len(corners) or not _is_closed(corners, len(vertices)):
        return Mesh(vertices, faces)
    used, corners_used = np.unique(corners, return_inverse=True)
    # One corner far away makes others near: what closes then is another object.
    if (np.abs(np.ptp(vertices[used], axis=0) - np.ptp(vertices, axis=0)) > 2 * reach_m).any():
        return Mesh(vertices, faces)
    welded = int((moved != np.arange(len(vertices))).sum())
    kept = corners_used.reshape(-1, 3).astype(np.int32)
    return Mesh(vertices[used], kept, (f"{with_count(welded, 'corners')} welded",))


def _is_closed(faces: Integers, count: int) -> bool:
    """Return whether each edge occurs equally often in both directions; wrong with probability 2^-64."""
    corners, following = np.ascontiguousarray(faces.T), [1, 2, 0]
    random = np.random.default_rng(0).integers(1 << 63, size=(2, count), dtype=np.uint64)
    one, other = (numbers.take(corners) for numbers in random)
    return bool((one * other[following]).sum() == (other * one[following]).sum())
