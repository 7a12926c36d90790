"""STL, PLY and OBJ: formats that state no unit.

trimesh is not used: it ignores unexpected content in STL, so that a damaged file may become another surface
without a warning, and triangulates all polygons as if they were convex. Memory is bounded by the size of the
file, not by numbers in it.
"""

from __future__ import annotations

import codecs
import re
from array import array
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeVar

import manifold3d
import numpy as np

from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.mesh import Surface
from tactile_toolkit.value_types import AnyArray, Bool, Float64, Int32, Int64

_MARKS = {codecs.BOM_UTF8: "utf-8", codecs.BOM_UTF16_LE: "utf-16-le", codecs.BOM_UTF16_BE: "utf-16-be"}

ANY_ENCODING = "latin-1"
"""Names and comments may have any encoding; all else is ASCII."""

# Padding that old systems write after the end of a text.
_PADDING = "\0\x1a"
_Number = TypeVar("_Number", float, int)

# The time for a polygon that crosses itself grows with the square of its number of corners.
_MAX_CORNERS = 10_000
_MAX_SQUARES = 10 * _MAX_CORNERS**2  # in all polygons together
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEADER_BYTES = 84
_VERTEX = r"vertex\s+(\S+)\s+(\S+)\s+(\S+)\s+"
_FACET_TEXT = re.compile(
    r"facet\s+normal\s+\S+\s+\S+\s+\S+\s+outer\s+loop\s+" + _VERTEX * 3 + r"end\s*loop\s+end\s*facet\b",
    re.IGNORECASE,
)
_SOLID, _SOLID_END = re.compile(r"(end\s*)?solid\b", re.IGNORECASE), re.compile(r"end\s*solid\b", re.I)
_VERTEX_LINE = re.compile(r"^[ \t]*v(?!\S)([^\n]*)", re.MULTILINE)
_FACE_LINE = re.compile(r"^[ \t]*f(?!\S)([^\n]*)", re.MULTILINE)
_FREE_FORM = re.compile(r"^[ \t]*(curv2?|surf)\b", re.MULTILINE)
_MAX_VERTICES = 2**31 - 1
_COMMENT, _TEXTURE_AND_NORMAL = re.compile(r"#[^\n]*"), re.compile(r"/\S*")
_PLY_TYPES = {
    **{"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2"},
    **{"ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4"},
    **{"int64": "i8", "uint64": "u8", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8"},
}
_PLY_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
_PLY_HEAD = re.compile(rb"ply[ \t]*(\r\n|\n|\r)(.*?[\r\n])?end_header[ \t]*\1", re.DOTALL)
_CORNERS = ("vertex_indices", "vertex_index")


def plain_text(data: bytes) -> str:
    """Return text without byte order mark and padding; lines end with newlines."""
    encoding = ANY_ENCODING
    for mark, stated in _MARKS.items():
        if data.startswith(mark):
            data = data[len(mark) :]
            encoding = stated
    text = data.decode(encoding, "replace").rstrip(_PADDING)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def numbers_of(words: Sequence[str], kind: Callable[[str], _Number]) -> list[_Number]:
    """Convert words to numbers; InputError names the first that is not a number.

    Python also accepts ``1_000`` and digits of other scripts, which mesh formats do not.
    """
    try:
        numbers = list(map(kind, words))
        joined = "".join(words)
        if "_" in joined or not joined.isascii():
            raise ValueError
    except ValueError:
        wrong = next(word for word in words if not _is_number(word, kind))
        expected = "one such as -1.5 or 2e-3" if kind is float else "an integer"
        raise InputError(f"{wrong[:40]!r} is not a number; expected {expected}") from None
    return numbers


def _is_number(word: str, kind: Callable[[str], _Number]) -> bool:
    with suppress(ValueError):
        kind(word)
        return word.isascii() and "_" not in word
    return False


def cut_polygons(vertices: Float64, sizes: Int64, corners: Int64) -> Int32:
    """Triangulate polygons, convex or not.

    Parameters
    ----------
    vertices : ndarray of float64, shape (V, 3)
        In any unit.
    sizes : ndarray of int64, shape (P,)
        Number of corners of each polygon.
    corners : ndarray of int64, shape (sum of sizes,)
        Rows of ``vertices``, polygon after polygon.

    Returns
    -------
    ndarray of int32, shape (F, 3)
        Oriented as their polygons.

    Raises
    ------
    InputError
        A polygon has fewer than 3 or more than 10,000 corners, or names a vertex that is not there; or many
        large polygons are not convex.
    """
    beyond = corners[(corners < 0) | (corners >= len(vertices))]
    if len(beyond):
        raise InputError(f"a face names vertex {beyond[0]}, counted from 0; there are {len(vertices):,}")
    if not len(sizes) or (sizes == 3).all():
        return corners.reshape(-1, 3).astype(np.int32)
    wrong = sizes[(sizes < 3) | (sizes > _MAX_CORNERS)]
    if len(wrong):
        raise InputError(f"a face has {wrong[0]:,} corners; expected 3 to {_MAX_CORNERS:,}")
    starts = np.cumsum(sizes) - sizes
    triangles = []
    squares = 0
    for size in np.unique(sizes).tolist():
        polygons = corners[starts[sizes == size][:, None] + np.arange(size)]
        if size == 3:
            triangles.append(polygons)
            continue
        flat, is_convex = _flattened(vertices, polygons)
        squares += size**2 * int((~is_convex).sum())
        if squares > _MAX_SQUARES:
            raise InputError(
                f"too many faces of up to {size:,} corners that are not convex",
                next="triangulate them, with the program that made the file",
            )
        middle = np.arange(1, size - 1)
        fan = np.stack([np.zeros_like(middle), middle, middle + 1], axis=1)
        triangles.append(polygons[is_convex][:, fan].reshape(-1, 3))
        cut: Callable[..., AnyArray] = manifold3d.triangulate
        triangles += [
            polygons[row][np.asarray(cut([flat[row]]))] for row in np.flatnonzero(~is_convex).tolist()
        ]
    return np.concatenate(triangles).astype(np.int32)


def _flattened(vertices: Float64, polygons: Int64) -> tuple[Float64, Bool]:
    """Return polygons of equal numbers of corners, shape (P, corners), in the plane, and which are convex."""
    points = vertices[polygons]
    points -= points[:, :1]
    following = np.roll(points, -1, axis=1)
    normal = np.cross(points, following).sum(axis=1)
    # Projected along the axis closest to the normal; mirrored where the normal points against it.
    axis = np.abs(normal).argmax(axis=1)
    rows = np.arange(len(polygons))
    upwards = np.where(normal[rows, axis] < 0, -1.0, 1.0)
    x = np.take_along_axis(points, ((axis + 1) % 3)[:, None, None], axis=2)[..., 0]
    y = np.take_along_axis(points, ((axis + 2) % 3)[:, None, None], axis=2)[..., 0] * upwards[:, None]
    flat = np.stack([x, y], axis=2)
    along = np.roll(flat, -1, axis=1) - flat
    onward = np.roll(along, -1, axis=1)
    turns = along[..., 0] * onward[..., 1] - along[..., 1] * onward[..., 0]
    return flat, np.asarray((turns > 0).all(axis=1))


def pack_stl(corners: Float64) -> bytes:
    """Return the content of a binary STL file with triangles, shape (N, 3, 3)."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 1])
    lengths = np.sqrt((normals * normals).sum(axis=1, keepdims=True))
    facets = np.zeros(len(corners), _FACET)
    facets["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    facets["corners"] = corners
    return bytes(_HEADER_BYTES - 4) + len(facets).to_bytes(4, "little") + facets.tobytes()


def read_stl(data: bytes) -> Surface:
    """Read STL: binary where the size of the file matches its stated number of triangles, otherwise text."""
    stated = int.from_bytes(data[_HEADER_BYTES - 4 : _HEADER_BYTES], "little")
    size = _HEADER_BYTES + stated * _FACET.itemsize
    # Decided by the size, because many programs begin binary files with "solid" too.
    if len(data) == size:
        corners = np.frombuffer(data, _FACET, stated, _HEADER_BYTES)["corners"]
        return _apart(corners.reshape(-1, 3).astype(np.float64))
    text = plain_text(data)
    if "\0" not in text[:_HEADER_BYTES]:
        return _read_stl_text(text)
    if stated > len(data):
        raise InputError(f"neither text nor binary STL: its {len(data):,} bytes do not begin as one of them")
    raise InputError(
        f"the file has {len(data):,} bytes, a binary STL file of {stated:,} triangles has {size:,}",
        next="export or copy it again",
    )


def _read_stl_text(text: str) -> Surface:
    words = list[str]()
    others = []
    end = 0
    for facet in _FACET_TEXT.finditer(text):
        others.append(text[end : facet.start()])
        words.extend(facet.groups())
        end = facet.end()
    lines = [line.strip() for part in (*others, text[end:]) if part.strip() for line in part.split("\n")]
    lines = [line for line in lines if line]
    if not lines or not _SOLID.match(lines[0]):
        beginning = repr(lines[0][:40]) if lines else "nothing"
        raise InputError(f"the file begins with {beginning}; expected 'solid' or a binary STL file")
    if not _SOLID_END.match(lines[-1]):
        raise InputError("the text is cut short; expected one that ends with 'endsolid'")
    if unknown := [line for line in lines if not _SOLID.match(line)]:
        raise InputError(f"{unknown[0][:40]!r} is not a facet; expected 'facet normal ... endfacet'")
    return _apart(np.array(numbers_of(words, float)).reshape(-1, 3))


def _apart(vertices: Float64) -> Surface:
    """Return a surface whose triangles share no vertices."""
    return vertices, np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)


def read_obj(data: bytes) -> Surface:
    """Read the faces of OBJ; lines, points, textures and names are ignored."""
    text = _COMMENT.sub("", plain_text(data).replace("\\\n", " "))
    if free_form := _FREE_FORM.search(text):
        raise InputError(f"{free_form[1]!r} is a free-form surface; expected faces ('f')")
    coordinates = list[str]()
    for line in _VERTEX_LINE.findall(text):
        words = line.split(None, 3)[:3]
        if len(words) < 3:
            raise InputError(f"{f'v {line}'[:40]!r} has fewer than three coordinates")
        coordinates += words
    vertices = np.array(numbers_of(coordinates, float)).reshape(-1, 3)
    faces = [_TEXTURE_AND_NORMAL.sub("", line) if "/" in line else line for line in _FACE_LINE.findall(text)]
    sizes = np.array([len(line.split()) for line in faces], np.int64)
    numbers = numbers_of(" ".join(faces).split(), int)
    if numbers and not -_MAX_VERTICES <= min(numbers) <= max(numbers) <= _MAX_VERTICES:
        raise InputError(f"faces name vertices {min(numbers)} to {max(numbers)} of {len(vertices):,}")
    corners = np.array(numbers, np.int64)
    if (corners < 1).any():
        corners = _from_first(corners, sizes, text)
    return vertices, cut_polygons(vertices, sizes, corners - 1)


def _from_first(corners: Int64, sizes: Int64, text: str) -> Int64:
    """Convert vertex numbers that count back from the last vertex so far to numbers from the first."""
    vertex_starts, face_starts = (
        [line.start() for line in kind.finditer(text)] for kind in (_VERTEX_LINE, _FACE_LINE)
    )
    so_far = np.repeat(np.searchsorted(vertex_starts, face_starts), sizes)
    if (wrong := (corners == 0) | (corners < -so_far)).any():
        number, count = corners[wrong][0], so_far[wrong][0]
        raise InputError(f"a face names vertex {number} of {count:,} so far; expected 1, or -1 for the last")
    return np.where(corners < 0, so_far + 1 + corners, corners)


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
    elements = _ply_elements(lines, _PLY_ORDERS[form], form == "ascii")
    body = data[head.end() :]
    if form == "ascii":
        # Text becomes eight-byte numbers and is then read as a binary file.
        body = array("d", numbers_of(body.decode(ANY_ENCODING).split(), float)).tobytes()
    columns_of: dict[str, dict[str, tuple[Int64, AnyArray]]] = {}
    at = 0
    for element in elements:
        columns_of[element.name], at = _ply_rows(element, body, at)
    if left := len(body) - at:
        raise InputError(f"{left:,} bytes follow the elements that the header states")
    if "tristrips" in columns_of:
        raise InputError("the file holds strips of triangles ('tristrips'); expected faces")
    try:
        columns = [columns_of["vertex"][axis][1] for axis in "xyz"]
        sizes, corners = next(columns_of["face"][name] for name in _CORNERS if name in columns_of["face"])
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
    for number, column in enumerate(element.properties):
        length = 1
        if column.count is not None:
            length = _length(element, column.name, column.count, body, end)
            fields.append((f"count{number}", column.count))
            end += column.count.itemsize
        fields.append((f"values{number}", column.kind, (length,)))
        end += length * column.kind.itemsize
    row = np.dtype(fields)
    if at + row.itemsize * element.rows <= len(body):
        table = np.frombuffer(body, row, element.rows, at)
        counts = [name for name in row.names or () if name.startswith("count")]
        if all((table[name] == table[name][0]).all() for name in counts):
            columns = {
                column.name: (
                    np.full(element.rows, row[f"values{number}"].shape[0], np.int64),
                    table[f"values{number}"].reshape(-1),
                )
                for number, column in enumerate(element.properties)
            }
            return columns, at + row.itemsize * element.rows
    return _ply_uneven_rows(element, body, at)


def _ply_uneven_rows(
    element: _Element, body: bytes, at: int
) -> tuple[dict[str, tuple[Int64, AnyArray]], int]:
    sizes: list[array[int]] = [array("q") for _ in element.properties]
    parts: list[list[bytes]] = [[] for _ in element.properties]
    for _ in range(element.rows):
        for number, column in enumerate(element.properties):
            length = 1
            if column.count is not None:
                length = _length(element, column.name, column.count, body, at)
                at += column.count.itemsize
            end = at + length * column.kind.itemsize
            if end > len(body):
                raise _cut_short(element)
            sizes[number].append(length)
            parts[number].append(body[at:end])
            at = end
    columns = {
        column.name: (np.array(sizes[number], np.int64), np.frombuffer(b"".join(parts[number]), column.kind))
        for number, column in enumerate(element.properties)
    }
    return columns, at


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
