"""What mesh files state of themselves, held against their size before trimesh makes anything of it."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

from tactile_toolkit.bounds import require_unpackable

# Memory that reading takes for each vertex or triangle, and for each line of text or corner of a polygon.
_PER_ELEMENT, _PER_LINE = 240, 720
_MOST_PARTS = 2_000
"""Surfaces of one file: trimesh takes milliseconds for each."""
_DEEPEST = 64
_MOST_PLY_HEADER_BYTES = 1 << 14
# What ends a line for Python, and so for trimesh.
_LINE_END = re.compile(rb"\r\n|[\n\r\x0b\x0c\x1c-\x1e\x85]|\xe2\x80[\xa8\xa9]")
_BYTES_OF = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_NUMBERS_OF = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


def require_bounded(data: bytes, ending: str) -> None:
    """Refuse a file that would take far more memory or time than its size suggests.

    InputError beyond the limit, ValueError where a file states what it does not hold.
    """
    {".glb": _bound_glb, ".ply": _bound_ply, ".obj": _bound_obj, ".stl": _bound_stl}[ending](data)


def _require_few(parts: int) -> None:
    if parts > _MOST_PARTS:
        raise ValueError(f"{parts:,} parts; expected one surface, or at most {_MOST_PARTS:,} parts")


def _require_lines(lines: int, size_bytes: int) -> None:
    require_unpackable(_PER_LINE * lines, f"text of {lines:,} lines and corners", size_bytes)


def _bound_stl(data: bytes) -> None:
    solids = data.lower().count(b"endsolid")
    _require_few(solids)
    if solids:
        _require_lines(data.lower().count(b"vertex"), len(data))


def _bound_obj(data: bytes) -> None:
    _require_few(data.count(b"usemtl "))
    # A polygon of n corners becomes n - 2 triangles.
    corners = sum(max(1, len(line.split()) - 3) for line in io.BytesIO(data.replace(b"\\\n", b" ")))
    _require_lines(corners, len(data))


def _bound_ply(data: bytes) -> None:
    head, _, body = data.partition(b"end_header")
    if len(head) > _MOST_PLY_HEADER_BYTES:
        raise ValueError(f"a header of {len(head):,} bytes; expected at most {_MOST_PLY_HEADER_BYTES:,}")
    stated = sum(abs(int(line.split()[2])) for line in head.splitlines() if line.startswith(b"element "))
    if b"ascii" in head:
        lines = sum(1 for _ in _LINE_END.finditer(body))
        if stated > lines + 1:
            raise ValueError(f"{lines:,} lines; its header states {stated:,}")
        _require_lines(lines, len(data))
    else:
        require_unpackable(_PER_ELEMENT * stated, f"{stated:,} vertices and triangles", len(data))


def _bound_glb(data: bytes) -> None:
    text = data[20 : 20 + int.from_bytes(data[12:16], "little")]
    entries = text.count(b"{") + text.count(b"[")
    require_unpackable(_PER_ELEMENT * entries, f"JSON of {entries:,} objects and lists", len(data))
    tree = json.loads(text)
    accessors, meshes, nodes = (tree.get(name, []) for name in ("accessors", "meshes", "nodes"))
    views = sum(abs(view["byteLength"]) for view in tree.get("bufferViews", []))
    held = sum(
        abs(each["count"]) * _BYTES_OF[each["componentType"]] * _NUMBERS_OF[each["type"]]
        for each in accessors
    )
    # Several views, and accessors, of the same bytes are usual; bytes of which none are stored are not.
    for what, size_bytes in (("views", views), ("accessors", held)):
        if size_bytes > 4 * len(data):
            raise ValueError(f"{what} of {size_bytes:,} bytes; the file has {len(data):,}")
    sizes = [[_primitive_size(each, accessors) for each in mesh["primitives"]] for mesh in meshes]
    _require_shallow(nodes)
    edges = [root for scene in tree.get("scenes", []) for root in scene.get("nodes", [])]
    edges += [child for node in nodes for child in node.get("children", [])]
    # Each surface once, and once more wherever it is placed.
    placed = sizes + [sizes[nodes[at]["mesh"]] for at in edges if "mesh" in nodes[at]]
    _require_few(max(len(edges), len(nodes), sum(map(len, placed))))
    elements = sum(map(sum, placed))
    require_unpackable(_PER_ELEMENT * elements, f"{elements:,} vertices and triangles", len(data))


def _primitive_size(primitive: Mapping[str, Any], accessors: Any) -> int:
    """Return how many vertices and triangles one surface has."""
    vertices = abs(accessors[primitive["attributes"]["POSITION"]]["count"])
    corners = abs(accessors[primitive["indices"]]["count"]) if "indices" in primitive else vertices
    # Colours and other values of vertices are read too, and take less.
    values = sum(abs(accessors[each]["count"]) for each in primitive["attributes"].values())
    # Of a strip each corner makes a triangle.
    return int(
        vertices + (values - vertices) // 8 + (corners // 3 if primitive.get("mode", 4) == 4 else corners)
    )


def _require_shallow(nodes: Sequence[Mapping[str, Any]]) -> None:
    """Refuse nodes that lie deep in others, or in a circle: trimesh takes minutes for a thousand levels."""
    level = set(range(len(nodes)))
    for _ in range(_DEEPEST):
        level = {child for at in level for child in nodes[at].get("children", [])}
    if level:
        raise ValueError(f"nodes more than {_DEEPEST} deep, or in a circle")
