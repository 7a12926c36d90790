"""PLY files, text and binary of either byte order.

trimesh is not used, because it triangulates all polygons as if they were convex. Memory is bounded by the
size of the file, not by numbers in it.
"""

from __future__ import annotations

import codecs
import re
from array import array
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tactile_toolkit.array_types import AnyArray, Int64
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.mesh import Surface
from tactile_toolkit.mesh.polygons import cut_polygons
from tactile_toolkit.mesh.text import ANY_ENCODING, numbers_of

_PLY_TYPES = {
    **{"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2"},
    **{"ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4"},
    **{"int64": "i8", "uint64": "u8", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8"},
}
_PLY_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
_PLY_HEAD = re.compile(rb"ply[ \t]*(\r\n|\n|\r)(.*?[\r\n])?end_header[ \t]*\1", re.DOTALL)
_CORNERS = ("vertex_indices", "vertex_index")


@dataclass(frozen=True, slots=True)
class _Property:
    """A property of an element: its type, and the type of its length if it is a list."""

    name: str
    kind: np.dtype[np.generic]
    count: np.dtype[np.generic] | None = None


@dataclass(frozen=True, slots=True)
class _Element:
    name: str
    rows: int
    properties: list[_Property]


def read_ply(data: bytes) -> Surface:
    """Read vertices and faces of PLY, text or binary of either order."""
    data = data.removeprefix(codecs.BOM_UTF8)
    head = _PLY_HEAD.match(data)
    if head is None:
        raise InputError("the file has no header from 'ply' to 'end_header'")
    lines = [line.split() for line in (head[2] or b"").decode(ANY_ENCODING).splitlines()]
    form = next((line[1] for line in lines if line[:1] == ["format"] and len(line) > 1), "")
    if form not in _PLY_ORDERS:
        raise InputError(f"the format is {form[:40]!r}; expected one of {', '.join(_PLY_ORDERS)}")
    elements, body = _ply_elements(lines, _PLY_ORDERS[form], form == "ascii"), data[head.end() :]
    if form == "ascii":
        # Text becomes eight-byte numbers and is then read as a binary file.
        body = array("d", numbers_of(body.decode(ANY_ENCODING).split(), float)).tobytes()
    found: dict[str, dict[str, tuple[Int64, AnyArray]]] = {}
    at = 0
    for element in elements:
        found[element.name], at = _ply_rows(element, body, at)
    if left := len(body) - at:
        raise InputError(f"{left:,} bytes follow the elements that the header states")
    if "tristrips" in found:
        raise InputError("the file holds strips of triangles ('tristrips'); expected faces")
    try:
        columns = [found["vertex"][axis][1] for axis in "xyz"]
        sizes, corners = next(found["face"][name] for name in _CORNERS if name in found["face"])
    except (KeyError, StopIteration):
        raise InputError("the file has no vertices with x, y, z, or faces with 'vertex_indices'") from None
    vertices = np.stack(columns, axis=1).astype(np.float64)
    numbers = corners.astype(np.int64)
    if (numbers != corners).any():
        raise InputError("a face names a vertex by a fraction; expected integers")
    return vertices, cut_polygons(vertices, sizes, numbers)


def _ply_elements(lines: Sequence[Sequence[str]], order: str, is_text: bool) -> list[_Element]:
    """Return the elements that a header declares; in text files all types are eight-byte numbers."""
    elements: list[_Element] = []

    def kind(word: str) -> np.dtype[np.generic]:
        stored = _PLY_TYPES[word]
        return np.dtype("<f8" if is_text else order + stored)

    for line in lines:
        try:
            match line:
                case ["element", name, rows]:
                    elements.append(_Element(name, int(rows), []))
                case ["property", "list", count, word, name]:
                    elements[-1].properties.append(_Property(name, kind(word), kind(count)))
                case ["property", word, name]:
                    elements[-1].properties.append(_Property(name, kind(word)))
                case ["format" | "comment" | "obj_info", *_] | []:
                    continue
                case _:
                    raise ValueError
        except (ValueError, KeyError, IndexError):
            raise InputError(f"the header has the line {' '.join(line)[:80]!r}") from None
        if elements[-1].rows < 0:
            raise InputError(f"the header states {elements[-1].rows} rows of {elements[-1].name[:40]!r}")
    return elements


def _ply_rows(element: _Element, body: bytes, at: int) -> tuple[dict[str, tuple[Int64, AnyArray]], int]:
    """Return for each property of an element the length of each row, all values, and the end position."""
    if not element.rows or not element.properties:
        return {}, at
    # First try whether all lists are as long as those of the first row, which is nearly always true.
    fields: list[tuple[str, np.dtype[np.generic]] | tuple[str, np.dtype[np.generic], tuple[int]]] = []
    end = at
    for number, each in enumerate(element.properties):
        length = 1
        if each.count is not None:
            length = _length(element, each.name, each.count, body, end)
            fields.append((f"count{number}", each.count))
            end += each.count.itemsize
        fields.append((f"values{number}", each.kind, (length,)))
        end += length * each.kind.itemsize
    row = np.dtype(fields)
    if at + row.itemsize * element.rows <= len(body):
        table = np.frombuffer(body, row, element.rows, at)
        counts = [name for name in row.names or () if name.startswith("count")]
        if all((table[name] == table[name][0]).all() for name in counts):
            found = {
                each.name: (
                    np.full(element.rows, row[f"values{number}"].shape[0], np.int64),
                    table[f"values{number}"].reshape(-1),
                )
                for number, each in enumerate(element.properties)
            }
            return found, at + row.itemsize * element.rows
    return _ply_uneven_rows(element, body, at)


def _ply_uneven_rows(
    element: _Element, body: bytes, at: int
) -> tuple[dict[str, tuple[Int64, AnyArray]], int]:
    sizes: list[array[int]] = [array("q") for _ in element.properties]
    parts: list[list[bytes]] = [[] for _ in element.properties]
    for _ in range(element.rows):
        for number, each in enumerate(element.properties):
            length = 1
            if each.count is not None:
                length = _length(element, each.name, each.count, body, at)
                at += each.count.itemsize
            end = at + length * each.kind.itemsize
            if end > len(body):
                raise _cut_short(element)
            sizes[number].append(length)
            parts[number].append(body[at:end])
            at = end
    found = {
        each.name: (np.array(sizes[number], np.int64), np.frombuffer(b"".join(parts[number]), each.kind))
        for number, each in enumerate(element.properties)
    }
    return found, at


def _length(element: _Element, name: str, kind: np.dtype[np.generic], body: bytes, at: int) -> int:
    """Return the length of the list at a position."""
    stored = np.frombuffer(body[at : at + kind.itemsize].ljust(kind.itemsize, b"\xff"), kind)[0]
    if at + kind.itemsize > len(body):
        raise _cut_short(element)
    if not 0 <= stored <= len(body) or stored != int(stored):
        raise InputError(f"a list {name[:40]!r} has {stored} values; the file is not as long")
    return int(stored)


def _cut_short(element: _Element) -> InputError:
    return InputError(f"the file is cut short; its header states {element.rows:,} of {element.name[:40]!r}")
