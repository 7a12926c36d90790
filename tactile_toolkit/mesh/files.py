"""Meshes in files: STL, 3MF, PLY, OBJ and GLB, checked as they come back from disk."""

from __future__ import annotations

import io
import json
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.bounds import require_unpackable
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh, MeshLike, as_mesh, joined
from tactile_toolkit.mesh.threemf import BuildItem, read_build, write_build
from tactile_toolkit.store.files import expanded, named_failures, write_file

FORMATS = (".stl", ".3mf", ".ply", ".obj", ".glb")
"""Millimetres in all of them (3MF: the unit that the file names), except GLB, which is metres."""


def read_mesh(path: str | Path) -> Mesh:
    """Read a mesh from a file.

    Parameters
    ----------
    path : str or Path
        A file with one of the endings in :data:`FORMATS`.

    Returns
    -------
    Mesh
        Metres, float64. Vertices with the same coordinates are merged, except in 3MF, whose faces have
        to name shared corners themselves.

    Raises
    ------
    InputError
        The file is missing, empty, cut short or not a mesh of its kind.
    """
    path = expanded(path)
    ending = file_ending(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); expected a mesh file") from error
    try:
        return unpack_mesh(data, ending)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def unpack_mesh(data: bytes, ending: str) -> Mesh:
    """Read a mesh from the content of a file; see :func:`read_mesh`."""
    if not data:
        raise InputError("the file is empty; expected a mesh", next="export or copy it again")
    try:
        if ending == ".3mf":
            built = [item.mesh for item in read_build(data)]
            vertices, faces = joined([(mesh.vertices_m, mesh.faces) for mesh in built])
        else:
            import trimesh

            if ending == ".stl":
                _require_whole_stl(data)
            _require_bounded(data, ending)
            # Materials would be pictures and further files; only the surface is wanted.
            scene = trimesh.load_scene(
                io.BytesIO(data), file_type=ending[1:], process=False, skip_materials=True
            )
            found = scene.to_mesh()
            vertices, faces = merge_equal_vertices(np.asarray(found.vertices, np.float64), found.faces)
    except (InputError, MemoryError):  # more than the limit
        raise
    except Exception as error:
        # Readers meet damaged files with whatever their parsing runs into, those of trimesh above all.
        story = str(error) or type(error).__name__
        raise InputError(
            f"not a readable {ending[1:].upper()} file ({story})", next="export the mesh again"
        ) from error
    if not len(faces):
        raise InputError("the file holds no triangle; expected a closed surface")
    return Mesh(vertices / (1.0 if ending in (".glb", ".3mf") else MM_PER_M), faces)


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
        The ending is unknown, or the mesh is not one.
    StorageError
        The file cannot be written.
    """
    path = Path(path)
    data = pack_mesh(as_mesh(mesh), file_ending(path))
    with named_failures(str(path)):
        path.parent.stat()  # a folder that is mistyped is refused, not made
        write_file(path, lambda stream: stream.write(data))


def pack_mesh(mesh: Mesh, ending: str, name: str = "") -> bytes:
    """Make the content of a mesh file; the same mesh always gives the same bytes.

    ``name`` is what slicers call the object, where the format holds names (3MF).
    """
    if ending == ".3mf":
        return write_build([BuildItem(name, mesh)])
    # glTF, whose binary form GLB is, fixes the metre; the others name no unit, and slicers take millimetres.
    if ending == ".glb":
        return _pack_glb(np.ascontiguousarray(mesh.vertices_m, "<f4"), mesh.faces)
    import trimesh

    packed = trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False).export(file_type=ending[1:])
    return packed.encode() if isinstance(packed, str) else bytes(packed)


def merge_equal_vertices(
    vertices: NDArray[np.float64], faces: NDArray[np.integer[Any]]
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Make one vertex of those with exactly the same coordinates, in the order in which they first appear."""
    # trimesh would merge within a tolerance, and numpy's unique rows take three times as long.
    rows = vertices + 0.0  # -0.0 and 0.0 are the same place
    order = np.lexsort(rows.T)
    in_order = rows[order]
    is_new = np.concatenate([[True], (in_order[1:] != in_order[:-1]).any(axis=1)])[: len(rows)]
    group = np.empty(len(rows), np.int64)
    group[order] = np.cumsum(is_new) - 1
    first = order[is_new]
    by_appearance = np.argsort(first)
    number = np.empty(len(first), np.int32)
    number[by_appearance] = np.arange(len(first), dtype=np.int32)
    return vertices[first[by_appearance]], number[group][faces]


def file_ending(path: Path) -> str:
    """Return the ending of a mesh file; InputError for one that is not known."""
    ending = path.suffix.lower()
    if ending not in FORMATS:
        found = f"files ending in {ending!r}" if ending else "files without an ending"
        raise InputError(f"{path}: {found} are not known; expected one of {', '.join(FORMATS)}")
    return ending


def _require_whole_stl(data: bytes) -> None:
    """Refuse a file that is cut short: trimesh takes what is left of it for the whole or for nothing."""
    triangles = int.from_bytes(data[80:84], "little")
    # By the length first: many programs begin binary files with "solid", too.
    is_text = data.lstrip()[:5].lower() == b"solid" and b"facet" in data[:4096]
    if len(data) == 84 + 50 * triangles or (is_text and b"endsolid" in data.rsplit(b"endfacet", 1)[-1]):
        return
    whole = "a text that ends with 'endsolid'" if is_text else f"those of {triangles:,} triangles"
    raise ValueError(f"{len(data):,} bytes; expected {whole}")


# --- what files state of themselves, held against their size before trimesh makes anything of it ------

# Memory that reading takes for each line of text or corner of a polygon, for each vertex or triangle that a
# file of bytes states, and for each value or corner that a GLB does.
_PER_LINE, _PER_ELEMENT, _PER_VALUE = 720, 240, 80
# Surfaces of one file: trimesh takes milliseconds for each.
_MOST_PARTS = 2_000
_DEEPEST = 64
# What ends a line for Python, and so for trimesh.
_LINE_END = re.compile(rb"\r\n|[\n\r\x0b\x0c\x1c-\x1e\x85]|\xe2\x80[\xa8\xa9]")


def _require_bounded(data: bytes, ending: str) -> None:
    """Refuse a file that would take far more memory or time than its size suggests.

    InputError beyond the limit, ValueError for too many surfaces.
    """
    lines = parts = 0
    if ending == ".glb":
        parts = _bound_glb(data)
    elif ending == ".ply":
        head, _, body = data.partition(b"end_header")
        stated = sum(abs(int(line.split()[2])) for line in head.splitlines() if line.startswith(b"element "))
        require_unpackable(_PER_ELEMENT * stated, f"{stated:,} vertices and triangles", len(data))
        if b"ascii" in head:
            lines = sum(1 for _ in _LINE_END.finditer(body))
    elif ending == ".obj":
        parts = data.count(b"usemtl ")
        # A polygon of n corners becomes n - 2 triangles.
        lines = sum(max(1, len(line.split()) - 3) for line in io.BytesIO(data.replace(b"\\\n", b" ")))
    elif parts := data.lower().count(b"endsolid"):
        lines = data.lower().count(b"vertex")
    require_unpackable(_PER_LINE * lines, f"text of {lines:,} lines and corners", len(data))
    if parts > _MOST_PARTS:
        raise ValueError(f"{parts:,} parts; expected one surface, or at most {_MOST_PARTS:,} parts")


def _bound_glb(data: bytes) -> int:
    """Return how many parts a file has; InputError where they would take more than the limit."""
    text = data[20 : 20 + int.from_bytes(data[12:16], "little")]
    entries = text.count(b"{") + text.count(b"[")
    require_unpackable(_PER_ELEMENT * entries, f"JSON of {entries:,} objects and lists", len(data))
    tree = json.loads(text)
    accessors, nodes = tree.get("accessors", []), tree.get("nodes", [])
    counts = [abs(each["count"]) for each in accessors]
    surfaces = [
        [
            sum(counts[each] for each in (*one["attributes"].values(), one.get("indices", 0)))
            for one in mesh["primitives"]
        ]
        for mesh in tree.get("meshes", [])
    ]
    # trimesh takes minutes for nodes that lie a thousand levels deep in others, or in a circle.
    level = set(range(len(nodes)))
    for _ in range(_DEEPEST):
        level = {child for at in level for child in nodes[at].get("children", [])}
    if level:
        raise ValueError(f"nodes more than {_DEEPEST} deep, or in a circle")
    edges = [root for scene in tree.get("scenes", []) for root in scene.get("nodes", [])]
    edges += [child for node in nodes for child in node.get("children", [])]
    # Each surface once, and once more wherever it is placed.
    placed = surfaces + [surfaces[nodes[at]["mesh"]] for at in edges if "mesh" in nodes[at]]
    # Several views, and accessors, of the same bytes are read several times; some have no bytes at all.
    values = sum(counts) + sum(map(sum, placed))
    view_bytes = sum(abs(view["byteLength"]) for view in tree.get("bufferViews", []))
    what = f"{values:,} values of vertices and triangles"
    require_unpackable(_PER_VALUE * values + view_bytes, what, len(data))
    return max(len(edges), len(nodes), sum(map(len, placed)))


def _pack_glb(vertices: NDArray[np.float32], faces: NDArray[np.int32]) -> bytes:
    """Pack a mesh into a binary glTF 2.0 file of one buffer."""
    corners, kind = faces.ravel().astype("<u2"), 5123  # how glTF calls uint16
    if len(vertices) > np.iinfo(np.uint16).max:
        corners, kind = faces.ravel().astype("<u4"), 5125
    buffer = vertices.tobytes() + corners.tobytes()
    # Both chunks end at multiples of four, this one with zeros and the JSON with blanks (glTF 2.0, section
    # 4.4.3).
    buffer += bytes(-len(buffer) % 4)
    low_high = {"min": vertices.min(axis=0).tolist(), "max": vertices.max(axis=0).tolist()}
    scene = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        # glTF takes the numbers of OpenGL: 5126 is float, 34962 and 34963 are buffers of vertices and of
        # indices.
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(vertices), "type": "VEC3", **low_high},
            {"bufferView": 1, "componentType": kind, "count": len(corners), "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": vertices.nbytes, "target": 34962},
            {"buffer": 0, "byteOffset": vertices.nbytes, "byteLength": corners.nbytes, "target": 34963},
        ],
        "buffers": [{"byteLength": len(buffer)}],
    }
    text = json.dumps(scene, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = (
        struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(buffer), b"BIN\0") + buffer
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
