"""3MF, the file that slicers prefer: a zip archive with one XML model (3MF core specification 1.3).

Read here and not by trimesh: that skips an object that is missing, takes a number up to the first letter that
is none, and knows no bounds, so that a damaged file becomes another solid without a word.
"""

from __future__ import annotations

import io
import zipfile
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import IO
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.arithmetic import moved
from tactile_toolkit.bounds import require_plain_archive, require_unpackable
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh, Surface, joined

_MM_PER_UNIT = {
    "micron": 1e-3,
    "millimeter": 1.0,
    "centimeter": 10.0,
    "inch": 25.4,
    "foot": 304.8,
    "meter": 1e3,
}
_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_PATH = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06 path"
_MODEL_PATH = "3D/3dmodel.model"

# A file of a few bytes can name itself as its own part, or unpack to any size.
_DEEPEST = 32
_MOST_PARTS = 20_000
# Memory that reading takes, at most: for each byte of XML and of what is built, and for each element.
_PER_BYTE, _PER_ELEMENT = 4, 160
_PIECE_BYTES = 1 << 20
_UNMOVED = "1 0 0 0 1 0 0 0 1 0 0 0"


@dataclass(frozen=True, slots=True, eq=False)
class BuildItem:
    """One thing to build, by the name that slicers list.

    ``offset_mm`` is where the origin of its vertices lies on the plate: x right, y back, z up.
    """

    name: str
    mesh: Mesh
    offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(slots=True, eq=False)
class _Object:
    """An object of a model, or what is to be built: its surface in mm, or the parts that it is made of.

    A part is what it names, a path and an id, and how that is moved, in mm.
    """

    name: str = ""
    surface: Surface | None = None
    parts: list[tuple[tuple[str, str], NDArray[np.float64]]] = field(default_factory=list)


class _Package:
    """The objects of all models of an archive, by path and id; what a model says to build has no id.

    Read tag by tag: as elements of a tree, a million vertices would take a gigabyte. Slicers keep the objects
    of a plate in models of their own, named by paths inside the archive (3MF production extension).
    """

    def __init__(self, archive: zipfile.ZipFile, file_bytes: int) -> None:
        self._file_bytes = file_bytes
        self._objects: dict[tuple[str, str], _Object] = {}
        self._tags = self._placed_parts = self._built_bytes = 0
        self._mm_per_unit = 1.0
        models = {
            _plain(each.filename): each
            for each in archive.infolist()
            if _plain(each.filename).endswith(".model")
        }
        if not models:
            raise ValueError("the archive holds no .model file")
        self._root = _MODEL_PATH.lower() if _MODEL_PATH.lower() in models else next(iter(models))
        size = sum(entry.file_size for entry in models.values())
        require_unpackable(_PER_BYTE * size, f"3MF file: XML of {size:,} bytes", file_bytes)
        for self._path, entry in models.items():
            with archive.open(entry) as stream:
                self._read(stream)

    def _read(self, stream: IO[bytes]) -> None:
        self._last = self._objects[self._path, ""] = _Object()
        self._points, self._corners = array("d"), array("i")
        parser = expat.ParserCreate(namespace_separator=" ")
        parser.StartElementHandler, parser.EndElementHandler = self._begin, self._end
        parser.StartDoctypeDeclHandler = self._refuse_names_for_text
        while piece := stream.read(_PIECE_BYTES):
            before = self._tags
            parser.Parse(piece)
            if len(piece) == _PIECE_BYTES and self._tags == before:
                # Attributes take 30 times as much memory, and are looked through again with each piece.
                raise ValueError(f"XML of {_PIECE_BYTES:,} bytes in which no element ends")
        parser.Parse(b"", True)

    def _begin(self, tag: str, given: Mapping[str, str]) -> None:
        match tag.removeprefix(f"{_CORE} "):
            case "vertex":
                self._points.extend([float(given[axis]) for axis in "xyz"])
            case "triangle":
                self._corners.extend([int(given[corner]) for corner in ("v1", "v2", "v3")])
            case "object":
                self._last = self._objects[self._path, given["id"]] = _Object(given.get("name", ""))
            case "build":
                self._last = self._objects[self._path, ""]
            case "component" | "item":
                numbers = [float(number) for number in given.get("transform", _UNMOVED).split()]
                # Each model has a unit of its own.
                matrix = np.array(numbers).reshape(4, 3) * np.array([[1], [1], [1], [self._mm_per_unit]])
                self._last.parts.append(((_plain(given.get(_PATH, self._path)), given["objectid"]), matrix))
            case "model":
                self._mm_per_unit = _MM_PER_UNIT[given.get("unit", "millimeter")]
            case "mesh" | "vertices" | "triangles" | "resources" | "components":
                pass
            case _:
                # The parser keeps all names that it has met, of which those that it need not know are many.
                self._tags += 2
        self._tags += 1
        if self._tags % 1024 < 3:
            what = f"3MF file: XML of more than {self._tags:,} elements"
            require_unpackable(_PER_ELEMENT * self._tags, what, self._file_bytes)

    def _end(self, tag: str) -> None:
        if tag == f"{_CORE} mesh":
            vertices = np.array(self._points, np.float64).reshape(-1, 3) * self._mm_per_unit
            self._last.surface = (vertices, np.array(self._corners, np.int32).reshape(-1, 3))
            self._points, self._corners = array("d"), array("i")

    def _refuse_names_for_text(self, *_: object) -> None:
        """Refuse what 3MF does not have: a few bytes repeat them to any size."""
        raise ValueError("the model has a document type; expected plain XML")

    def built(self) -> Iterator[BuildItem]:
        """Yield each thing to build where it will be built, all its parts as one."""
        for named, matrix in self._objects[self._root, ""].parts:
            vertices_mm, faces = joined(list(self._placed(named, matrix)))
            yield BuildItem(self._objects[named].name, Mesh(vertices_mm / MM_PER_M, faces))

    def _placed(
        self, named: tuple[str, str], matrix: NDArray[np.float64], depth: int = 0
    ) -> Iterator[Surface]:
        """Yield the surfaces of an object, moved."""
        if named not in self._objects:
            raise ValueError(f"the archive holds no object {named[1]!r} of /{named[0]}")
        thing = self._objects[named]
        # A few bytes can name the same object again and again.
        self._placed_parts += 1
        self._built_bytes += sum(each.nbytes for each in thing.surface or ())
        if depth > _DEEPEST or self._placed_parts > _MOST_PARTS:
            raise ValueError(f"object {named[1]!r} holds itself, or more than {_MOST_PARTS:,} parts")
        require_unpackable(_PER_BYTE * self._built_bytes, "3MF file: what it builds", self._file_bytes)
        mirrored = np.linalg.det(matrix[:3]) < 0
        below = (surface for part in thing.parts for surface in self._placed(*part, depth + 1))
        for vertices_mm, faces in below if thing.surface is None else [thing.surface]:
            yield moved(vertices_mm, matrix[:3]) + matrix[3], faces[:, ::-1] if mirrored else faces


def _plain(path: str) -> str:
    return path.lower().lstrip("/")


def read_build(data: bytes) -> list[BuildItem]:
    """Read what a file says to build, in its order and where it will be built: each ``offset_mm`` is zero.

    Raises ValueError, KeyError, zipfile.BadZipFile or xml.parsers.expat.ExpatError where the archive, the
    model or a number in it is damaged; InputError where it unpacks to more than the limit.
    """
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        require_plain_archive(archive)
        return list(_Package(archive, len(data)).built())


_CONTENT_TYPES = (
    '<?xml version="1.0" encoding="UTF-8"?>'
    '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>'
    "</Types>"
)
_RELATIONS = (
    '<?xml version="1.0" encoding="UTF-8"?>'
    '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    '<Relationship Target="/3D/3dmodel.model" Id="model" '
    'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>'
)
# The first date that a zip archive can hold: with the time of writing, no two files would be the same.
_EPOCH = (1980, 1, 1, 0, 0, 0)


def write_build(items: Sequence[BuildItem]) -> bytes:
    """Pack things, in the order in which slicers list them; the same things always give the same bytes."""
    build = ""
    for number, item in enumerate(items, 1):
        x, y, z = (f"{value:.9g}" for value in item.offset_mm)
        moved = f' transform="1 0 0 0 1 0 0 0 1 {x} {y} {z}"' if any(item.offset_mm) else ""
        build += f'<item objectid="{number}"{moved}/>'
    resources = "".join(_object(item, number) for number, item in enumerate(items, 1))
    model = (
        f'<?xml version="1.0" encoding="UTF-8"?><model unit="millimeter" xml:lang="en-US" xmlns="{_CORE}">'
        f"<resources>{resources}</resources><build>{build}</build></model>"
    )
    files = {"[Content_Types].xml": _CONTENT_TYPES, "_rels/.rels": _RELATIONS, _MODEL_PATH: model}
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(zipfile.ZipInfo(name, _EPOCH), text, zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def _object(item: BuildItem, number: int) -> str:
    # Nine digits give every float32 back exactly, and stored meshes are float32; -0 becomes 0.
    places = (item.mesh.vertices_mm + 0.0).tolist()
    corners = "".join(f'<vertex x="{x:.9g}" y="{y:.9g}" z="{z:.9g}"/>' for x, y, z in places)
    faces = item.mesh.faces.tolist()
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in faces)
    name = f" name={quoteattr(item.name)}" if item.name else ""
    return (
        f'<object id="{number}" type="model"{name}><mesh><vertices>{corners}</vertices>'
        f"<triangles>{triangles}</triangles></mesh></object>"
    )
